"""Where the light of a pixel comes from: pairs of directions and how much each counts, in three parts.

The light that leaves a pixel is the integral over incident directions of BRDF, radiance and cosine. For an environment
two quadratures share it, by a smooth weight s that goes from 1 at theta_h = 5 degrees to 0 at 20:

- s times the integrand over half vectors, on nodes in a spiral that is dense at the normal, each with the environment
  averaged over its solid angle 4 cos_d d(omega_h): sharp lobes are smooth in theta_h, however detailed the environment
  is (`HalfVectorQuadrature`);
- 1 - s times it over fixed lights that stand for the whole environment: there is no sharp lobe left, and however small
  the sun is, it is one of the lights (`LightQuadrature`).

Point and directional lights have one direction for each pixel (`PunctualQuadrature`).

Each also says how its pairs fall into bins (`bin`), and which pairs stand for a bin (`representatives`): the compact
pairs that a transport works on.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import torch
from torch import Tensor

from torchbrdf.pairs import Pairs
from torchbrdf.render.light.environment import Environment, EnvironmentSamples
from torchbrdf.render.light.punctual import PunctualLight
from torchbrdf.render.raster.pixels import Pixels

if TYPE_CHECKING:
    from torchbrdf.render.transport.shadows import Occluder

# The two quadratures share the half vectors between these angles from the normal, in degrees.
NEAR, FAR = 5.0, 20.0
# Nodes around the mirror direction lie at theta_h = FAR t^_SHARPENING for t evenly in (0, 1).
_SHARPENING = 1.5
_GOLDEN = math.pi * (3 - math.sqrt(5))
# The share of a node's solid angle that the environment is averaged over before it is interpolated, which blurs as
# much again: at 1 pictures lost 2 to 6 dB, at 1/4 up to 2. Toward grazing the solid angle falls as cos_d, but the
# nodes stay as far apart in the plane of incidence, so that a small sun would slip through; hence the least cos_d.
_BLUR, _LEAST = 0.5, 0.5
# Bins of theta_o in which a node's pairs are taken for one: at 1 degree pictures were 7 dB farther from those without
# bins than at half a degree.
_STEPS = 180


class Quadrature(Protocol):
    """Protocol of quadratures over light.

    length: pairs of a pixel at most. bins: of the compact pairs at most, with so many `dimensions`.
    """

    length: int
    bins: int
    dimensions: int

    def samples(self, rows: Tensor) -> tuple[Pairs, Tensor]:
        """Of some pixels: Pairs `(1, p L)` and weights `(p, L, 3)`, radiance times cosine times solid angle."""

    def bin(self, rows: Tensor, pairs: Pairs) -> tuple[Tensor, Tensor]:
        """The bin of each of the pairs that `samples` gave, `(p L,)`, and where in it each is, `(d, p L)`."""

    def representatives(self, bins: Tensor, mean: Tensor) -> Pairs:
        """The pairs `(1, n)` that stand for some bins `(n,)`, by the mean place in them, `(d, n)`, float64."""


class HalfVectorQuadrature:
    """Quadrature over half vectors around the mirror direction. All follows from the node and from theta_o."""

    dimensions = 1

    def __init__(self, pixels: Pixels, environment: Environment, nodes: int, occluder: "Occluder | None") -> None:
        self.pixels, self.environment, self.length, self.occluder = pixels, environment, nodes, occluder
        self.bins = nodes * _STEPS

    @cached_property
    def nodes(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Half vectors `(3, n)` of the spiral; of each, `(n,)`: tan^2 theta_h, 4 d(omega_h), and the weight s."""
        edge = torch.linspace(0, 1, self.length + 1, dtype=torch.float64, device="cpu")
        edge = edge**_SHARPENING * math.radians(FAR)
        order = torch.arange(self.length, dtype=torch.float64, device="cpu")
        theta = ((order + 0.5) / self.length) ** _SHARPENING * math.radians(FAR)
        azimuth = order * _GOLDEN
        half = torch.stack([theta.sin() * azimuth.cos(), theta.sin() * azimuth.sin(), theta.cos()])
        # cos a - cos b = 2 sin((b + a) / 2) sin((b - a) / 2), without the cancellation
        solid = 4 * math.pi * ((edge[1:] + edge[:-1]) / 2).sin() * ((edge[1:] - edge[:-1]) / 2).sin()
        parts = (half, theta.tan().square(), 4 * solid, half_vector_weight(theta.cos()))
        return tuple(part.to(torch.float32) for part in parts)  # type: ignore[return-value]

    def samples(self, rows: Tensor) -> tuple[Pairs, Tensor]:
        """Pairs and weights of some pixels over the nodes."""
        frame, outgoing = self.pixels.frame[rows], self.pixels.outgoing[:, rows, None]
        half, tan2_h, solid, share = self.nodes
        incident, cos_d = _reflected(half, outgoing)
        directions = (frame.transpose(1, 2) @ incident.transpose(0, 1)).transpose(1, 2)
        radiance = self.environment.lookup(directions, _BLUR * solid * cos_d.clamp_min(_LEAST))
        counted = incident[2].clamp_min(0) * cos_d * (solid * share)
        if self.occluder is not None:
            counted = counted * self.occluder.visible(self.pixels.position[rows], directions, wanted=counted > 0)
        return _pairs(incident, outgoing, cos_d, half[2], tan2_h, outgoing[0] * half[1]), radiance * counted[..., None]

    def bin(self, rows: Tensor, pairs: Pairs) -> tuple[Tensor, Tensor]:
        """Bins by node and theta_o."""
        theta_o = torch.atan2(*self.pixels.outgoing[[0, 2]][:, rows])
        step = (theta_o * (_STEPS / (math.pi / 2))).long().clamp(0, _STEPS - 1)
        bins = step[:, None] * self.length + torch.arange(self.length, dtype=torch.int64, device="cpu")
        return bins.flatten(), theta_o[:, None].expand(bins.shape).reshape(1, -1)

    def representatives(self, bins: Tensor, mean: Tensor) -> Pairs:
        """Pairs of the node seen from the mean theta_o of its bin."""
        half, tan2_h, _, _ = (part[..., bins % self.length].double() for part in self.nodes)
        outgoing = torch.stack([mean[0].sin(), torch.zeros_like(mean[0]), mean[0].cos()])
        incident, cos_d = _reflected(half, outgoing)
        return _pairs(incident, outgoing, cos_d, half[2], tan2_h, outgoing[0] * half[1])


class LightQuadrature:
    """Quadrature over the same lights for every pixel.

    Bins are those of a MERL table, or coarser: theta_h^(1/2), theta_d, phi_d.
    """

    dimensions = 3

    def __init__(
        self, pixels: Pixels, lights: EnvironmentSamples, resolution: tuple[int, int, int], occluder: "Occluder | None"
    ) -> None:
        self.pixels, self.lights, self.occluder = pixels, lights, occluder
        self.length = (len(lights.flux) + 1) // 2
        self.resolution = resolution
        self.bins = math.prod(resolution)

    def samples(self, rows: Tensor) -> tuple[Pairs, Tensor]:
        """Pairs and weights of some pixels; lights below the horizon of all these pixels are left out."""
        frame, outgoing = self.pixels.frame[rows], self.pixels.outgoing[:, rows, None]
        used = (frame[:, 2] @ self.lights.direction.T > 0).any(0)
        direction = self.lights.direction[used]
        incident = (frame @ direction.T).transpose(0, 1).contiguous()  # (3, p, l)
        pairs, cos_h = _between(incident, outgoing)
        counted = incident[2].clamp_min(0) * (1 - half_vector_weight(cos_h))
        if self.occluder is not None:
            everywhere = direction.expand(len(rows), -1, 3)
            counted = counted * self.occluder.visible(self.pixels.position[rows], everywhere, wanted=counted > 0)
        return pairs, self.lights.flux[used] * counted[..., None]

    def bin(self, rows: Tensor, pairs: Pairs) -> tuple[Tensor, Tensor]:
        """Bins by half and difference angles."""
        place = torch.stack([pairs.theta_h[0], pairs.theta_d[0], pairs.phi_d[0]])
        share = (place[0] / (math.pi / 2)).sqrt(), place[1] / (math.pi / 2), place[2] / math.pi
        bins = torch.zeros(place.shape[1], dtype=torch.int64, device="cpu")
        for one, count in zip(share, self.resolution, strict=True):
            bins = bins * count + (one * count).long().clamp(0, count - 1)
        return bins, place

    def representatives(self, bins: Tensor, mean: Tensor) -> Pairs:
        """Pairs of the mean of the angles in each bin."""
        return Pairs.from_half_diff(*mean[:, None])


class PunctualQuadrature:
    """Quadrature over point and directional lights; their pairs are not binned, since there are few."""

    dimensions = 3

    def __init__(self, pixels: Pixels, punctual_lights: Sequence[PunctualLight], occluder: "Occluder | None") -> None:
        self.pixels, self.punctual_lights, self.occluder = pixels, punctual_lights, occluder
        self.length = len(punctual_lights)
        self.bins = len(pixels) * len(punctual_lights)

    def samples(self, rows: Tensor) -> tuple[Pairs, Tensor]:
        """Pairs of some pixels, and weights: irradiance times the cosine."""
        frame, outgoing, position = self.pixels.frame[rows], self.pixels.outgoing[:, rows, None], self.pixels.position
        found = [light.at(position[rows]) for light in self.punctual_lights]
        direction, irradiance = (torch.stack([one[k] for one in found], 1) for k in (0, 1))
        incident = (frame @ direction.transpose(1, 2)).transpose(0, 1).contiguous()
        pairs, _ = _between(incident, outgoing)
        counted = incident[2].clamp_min(0)
        if self.occluder is not None:
            limit = torch.stack([one[2] for one in found], 1)
            counted = counted * self.occluder.visible(position[rows], direction, wanted=counted > 0, limit=limit)
        return pairs, irradiance * counted[..., None]

    def bin(self, rows: Tensor, pairs: Pairs) -> tuple[Tensor, Tensor]:
        """Bins of one pair each."""
        bins = rows[:, None] * self.length + torch.arange(self.length, dtype=torch.int64, device="cpu")
        return bins.flatten(), torch.stack([pairs.theta_h[0], pairs.theta_d[0], pairs.phi_d[0]])

    def representatives(self, bins: Tensor, mean: Tensor) -> Pairs:
        """The one pair of each bin."""
        return Pairs.from_half_diff(*mean[:, None])


def half_vector_weight(cos_h: Tensor) -> Tensor:
    """Weight s of the half-vector quadrature: 1 near the normal, 0 far from it, smooth (3 t^2 - 2 t^3) in between."""
    inner, outer = math.cos(math.radians(NEAR)), math.cos(math.radians(FAR))
    t = ((cos_h - outer) / (inner - outer)).clamp(0, 1)
    return t.square() * (3 - 2 * t)


def _reflected(half: Tensor, outgoing: Tensor) -> tuple[Tensor, Tensor]:
    """Incident directions `(3, ...)` for half vectors `(3, n)`, and cos_d."""
    # Below 0 it is only where the light is below the horizon.
    cos_d = (outgoing[0] * half[0] + outgoing[2] * half[2]).clamp_min(1e-6)
    half = half if half.dim() == outgoing.dim() else half[:, None]
    return 2 * cos_d * half - outgoing, cos_d


def _between(incident: Tensor, outgoing: Tensor) -> tuple[Pairs, Tensor]:
    """Pairs of directions `(3, p, L)` and `(3, p, 1)`, and cos_h `(p, L)`."""
    half = incident + outgoing
    horizontal, upward = half[0].square() + half[1].square(), half[2].square()
    length = (horizontal + upward).sqrt().clamp_min(1e-6)
    cos_h = half[2] / length
    tan2_h = horizontal / upward.clamp_min(1e-12)
    return _pairs(incident, outgoing, length / 2, cos_h, tan2_h, outgoing[0] * incident[1] / length), cos_h


def _pairs(incident: Tensor, outgoing: Tensor, cos_d: Tensor, cos_h: Tensor, tan2_h: Tensor, across: Tensor) -> Pairs:
    """Pairs `(1, p L)` of what is known for p pixels and L directions: incident `(3, p, L)`, outgoing `(3, p, 1)`.

    across: wi . (n x h), which is sin theta_h sin theta_d sin phi_d; cos_d cos_h - cos_i is the same with cos phi_d.
    """
    phi_d = torch.atan2(across, cos_d * cos_h - incident[2])
    phi_d = torch.where(phi_d < 0, phi_d + math.pi, phi_d)
    scalars = {
        "cos_i": incident[2],
        "cos_o": outgoing[2],
        "cos_d": cos_d,
        "cos_h": cos_h,
        "tan2_h": tan2_h,
        "phi_d": phi_d,
    }
    known = {name: value.expand_as(cos_d).reshape(1, -1) for name, value in scalars.items()}
    wi, wo = (vector.expand_as(incident).reshape(3, -1).T[None] for vector in (incident, outgoing))
    # theta_d from the cosine is exact enough, and cheaper than from the directions
    known["theta_d"] = torch.atan2((1 - known["cos_d"].square()).clamp_min(0).sqrt(), known["cos_d"])
    return Pairs(wi=wi, wo=wo, **known)
