"""Where the light of a pixel comes from: pairs of directions and how much each counts, in three parts.

The light that leaves a pixel is the integral over incident directions of BRDF, radiance and cosine. For an environment
two quadratures share it, by a smooth weight s that goes from 1 at theta_h = 5 degrees to 0 at 20:

- s times the integrand over half vectors, on nodes in a spiral that is dense at the normal, each with the environment
  averaged over its solid angle 4 cos_d d(omega_h): sharp lobes are smooth in theta_h, however detailed the environment
  is (`HalfVectorQuadrature`);
- 1 - s times it over fixed lights that stand for the whole environment: there is no sharp lobe left, and however small
  the sun is, it is one of the lights (`LightQuadrature`).

Point and directional lights have one direction for each pixel (`PunctualQuadrature`).

Each also takes pairs that are nearly equal for one (`compact`): the compact pairs that a transport works on.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from torch import Tensor

from torchbrdf import half_difference
from torchbrdf.measured.grid import nearest_valid
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import thread_map
from torchbrdf.render.light.environment import Environment, EnvironmentSamples
from torchbrdf.render.light.punctual import PunctualLight
from torchbrdf.render.raster.pixels import Pixels
from torchbrdf.render.transport.blocks import Block, Entries, LightBlock, NodeBlock

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
# Pairs at a time: their quantities then stay in a processor's cache.
CHUNK = 65536
# Pixels, evenly spread, that say where in its bin the pair of a bin is.
_ASKED = 8192
# Below the length of any half vector that counts; and of sines that have no azimuth.
_SHORT, _NONE = 1e-12, 1e-20


@dataclass(frozen=True)
class Compact:
    """A quadrature on few pairs.

    pairs: `(1, n)`, float32, of angles and cosines; groups: rows of pixels, whose entries are worked out together;
    block: works them out, with columns that count the pairs.
    """

    pairs: Pairs
    groups: list[Tensor]
    block: Callable[[Tensor], Entries]


class Quadrature(Protocol):
    """Protocol of quadratures over light. length: pairs of a pixel at most, about."""

    length: int

    def samples(self, rows: Tensor) -> tuple[Pairs, Tensor]:
        """Of some pixels: Pairs `(1, p L)` and weights `(p, L, 3)`, radiance times cosine times solid angle."""

    def compact(self) -> Compact:
        """The same with pairs that are nearly equal taken for one."""


class HalfVectorQuadrature:
    """Quadrature over half vectors around the mirror direction. All follows from the node and from theta_o."""

    def __init__(self, pixels: Pixels, environment: Environment, nodes: int, occluder: "Occluder | None") -> None:
        self.pixels, self.environment, self.length, self.occluder = pixels, environment, nodes, occluder

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
        outgoing = self.pixels.outgoing[:, rows, None]
        half, tan2_h, _, _ = self.nodes
        incident, cos_d = _reflected(half, outgoing)
        weight = self._weights(rows, incident[2], cos_d)
        return _pairs(incident, outgoing, cos_d, half[2], tan2_h, outgoing[0] * half[1]), weight.permute(1, 2, 0)

    def _weights(self, rows: Tensor, cos_i: Tensor, cos_d: Tensor) -> Tensor:
        """Weights `(3, p, n)`, by cosines `(p, n)`."""
        half, _, solid, share = self.nodes
        frame, outgoing = self.pixels.frame[rows], self.pixels.outgoing[:, rows]
        viewer = frame[:, 0] * outgoing[0, :, None] + frame[:, 2] * outgoing[2, :, None]
        directions = torch.einsum("pkc,kn->cpn", frame, half).mul_(2 * cos_d).sub_(viewer.T[..., None])
        radiance = self.environment.look(directions, _BLUR * solid * cos_d.clamp_min(_LEAST))
        counted = cos_i.clamp_min(0) * cos_d * (solid * share)
        if self.occluder is not None:
            toward = directions.permute(1, 2, 0)
            counted *= self.occluder.visible(self.pixels.position[rows], toward, wanted=counted > 0)
        return radiance * counted

    def compact(self) -> Compact:
        """In bins of theta_o: a node's pairs in one are that of the mean theta_o of its pixels."""
        theta_o = torch.atan2(self.pixels.outgoing[0], self.pixels.outgoing[2]).double()
        step = (theta_o * (_STEPS / (math.pi / 2))).long().clamp(0, _STEPS - 1)
        order = step.argsort(stable=True)
        found, inverse, counts = step.unique(return_inverse=True, return_counts=True)
        mean = torch.zeros(len(found), dtype=torch.float64, device="cpu").index_add(0, inverse, theta_o) / counts
        half, tan2_h, _, _ = (part.double() for part in self.nodes)
        outgoing = torch.stack([mean.sin(), torch.zeros_like(mean), mean.cos()])[..., None]
        incident, cos_d = _reflected(half, outgoing)
        above = incident[2] > 0
        place = (above.flatten().cumsum(0) - 1).unflatten(0, above.shape)
        pairs = _pairs(incident, outgoing, cos_d, half[2], tan2_h, outgoing[0] * half[1])

        def block(rows: Tensor) -> Entries:
            used = above[inverse[rows[0]]]
            outgoing = self.pixels.outgoing[:, rows]
            cos_d = _cos_d(self.nodes[0], outgoing[..., None])
            cos_i = (2 * cos_d).mul_(self.nodes[0][2]).sub_(outgoing[2, :, None])
            weight = self._weights(rows, cos_i, cos_d)
            weight = weight.contiguous() if used.all() else weight[..., used]
            return NodeBlock(rows, place[inverse[rows[0]], used], weight)

        together = max(CHUNK // self.length, 1)
        groups = [rows for own in order.split(counts.tolist()) for rows in own.split(together)]
        return Compact(pairs.select(samples=above.flatten().nonzero()[:, 0]), groups, block)


class LightQuadrature:
    """Quadrature over the same lights for every pixel.

    Bins are about those of a MERL table, or coarser, in coordinates that need no angles: u_h = (1 - cos_h)^(1/4), which
    goes as theta_h^(1/2), u_d = (1 - cos_d)^(1/2), which goes as theta_d, and u_phi = (1 - x / (|x| + y)) / 2 of
    (x, y) along phi_d. All are from 0 to 1.
    """

    def __init__(
        self, pixels: Pixels, lights: EnvironmentSamples, resolution: tuple[int, int, int], occluder: "Occluder | None"
    ) -> None:
        self.pixels, self.lights, self.occluder = pixels, lights, occluder
        self.length = (len(lights.flux) + 1) // 2
        self.resolution = resolution

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

    def compact(self) -> Compact:
        """In bins of half and difference angles: pairs in one are that of their mean place."""
        every = torch.arange(len(self.pixels), dtype=torch.int64, device="cpu")
        groups = list(every.split(max(CHUNK // self.length, 1)))
        apart = max(len(every) // _ASKED, 1)
        asked = every[::apart].split(max(4 * CHUNK // self.length, 1))
        sums = np.zeros((4, math.prod(self.resolution)))
        for own in thread_map(self._sums, asked):
            sums += own
        filled = np.flatnonzero(sums[0])
        column = np.zeros(sums.shape[1], np.int32)
        column[filled] = np.arange(len(filled), dtype=np.int32)
        if len(filled) and apart > 1:  # what only pixels fill that were not asked is little, and near
            column = column[nearest_valid((sums[0] > 0).reshape(self.resolution))]
        columns = torch.from_numpy(column)

        def block(rows: Tensor) -> Entries:
            places, counted, used = self._places(rows)
            return LightBlock(
                rows,
                columns.index_select(0, self._bins(places).flatten()).view(counted.shape),
                counted,
                self.lights.flux[used].T.contiguous(),
            )

        pairs = _pairs_at(torch.from_numpy(sums[1:, filled] / sums[0, filled]))
        return Compact(pairs, groups if len(filled) else [], block)

    def _sums(self, rows: Tensor) -> np.ndarray:
        """What falls into each bin, and its sum of places, `(4, bins)`."""
        places, counted, used = self._places(rows)
        bins = self._bins(places).flatten().numpy()
        heavy = (counted * self.lights.flux[used].sum(-1)).flatten().double()
        parts = [heavy, *(heavy * place.flatten() for place in places)]
        return np.stack([np.bincount(bins, part.numpy(), math.prod(self.resolution)) for part in parts])

    def _places(self, rows: Tensor) -> tuple[list[Tensor], Tensor, Tensor]:
        """Coordinates of pairs `(p, l)`, what each counts but for the light's colour, and which lights are used."""
        frame, outgoing = self.pixels.frame[rows], self.pixels.outgoing[:, rows, None]
        used = (frame[:, 2] @ self.lights.direction.T > 0).any(0)
        direction = self.lights.direction[used]
        viewer = frame[:, 0] * outgoing[0] + frame[:, 2] * outgoing[2]
        across = frame[:, 1] * outgoing[0]
        cos_i, length, turn = torch.stack([frame[:, 2], viewer, across]) @ direction.T
        length = length.mul_(2).add_(2).clamp_min_(_SHORT).sqrt_()  # of the sum of both directions: 2 cos_d
        cos_i, cos_o = cos_i.clamp_min_(0), outgoing[2]
        cos_h = (cos_i + cos_o).div_(length)
        counted = half_vector_weight(cos_h).neg_().add_(1).mul_(cos_i)
        if self.occluder is not None:
            everywhere = direction.expand(len(rows), -1, 3)
            counted *= self.occluder.visible(self.pixels.position[rows], everywhere, wanted=counted > 0)
        # x / y, where cos_o - cos_i = 2 sin_h sin_d cos phi_d is 2 x, and turn / length is y.
        slope = (cos_o - cos_i).mul_(length).div_(turn.mul_(2).add_(_NONE))
        slope = slope.div_(slope.abs().add_(1))
        u_h = cos_h.neg_().add_(1).clamp_min_(0).sqrt_().sqrt_()
        u_d = length.mul_(-0.5).add_(1).clamp_min_(0).sqrt_()
        return [u_h, u_d, slope.mul_(-0.5).add_(0.5)], counted, used

    def _bins(self, places: Sequence[Tensor]) -> Tensor:
        """The bin of each, int32."""
        first, *rest = (
            (place * (count * (1 - 1e-6))).to(torch.int32) for place, count in zip(places, self.resolution, strict=True)
        )
        for one, count in zip(rest, self.resolution[1:], strict=True):
            first = first.mul_(count).add_(one)
        return first


class PunctualQuadrature:
    """Quadrature over point and directional lights; their pairs are not binned, since there are few."""

    def __init__(self, pixels: Pixels, punctual_lights: Sequence[PunctualLight], occluder: "Occluder | None") -> None:
        self.pixels, self.punctual_lights, self.occluder = pixels, punctual_lights, occluder
        self.length = len(punctual_lights)

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

    def compact(self) -> Compact:
        """All pairs that count, as they are."""
        every = torch.arange(len(self.pixels), dtype=torch.int64, device="cpu")
        pairs, weight = self.samples(every)
        used = (weight > 0).any(-1)
        place = (used.flatten().cumsum(0) - 1).to(torch.int32).unflatten(0, used.shape)

        def block(rows: Tensor) -> Entries:
            own = used[rows]
            start = torch.nn.functional.pad(own.sum(1).cumsum(0), (1, 0)).to(torch.int32)
            return Block(rows, start, place[rows][own], weight[rows][own].T.contiguous())

        groups = list(every.split(max(CHUNK // self.length, 1)))
        return Compact(pairs.select(samples=used.flatten().nonzero()[:, 0]), groups, block)


def half_vector_weight(cos_h: Tensor) -> Tensor:
    """Weight s of the half-vector quadrature: 1 near the normal, 0 far from it, smooth (3 t^2 - 2 t^3) in between."""
    inner, outer = math.cos(math.radians(NEAR)), math.cos(math.radians(FAR))
    t = ((cos_h - outer) / (inner - outer)).clamp(0, 1)
    return t.square() * (3 - 2 * t)


def _reflected(half: Tensor, outgoing: Tensor) -> tuple[Tensor, Tensor]:
    """Incident directions `(3, p, n)` for half vectors `(3, n)` and `(3, p, 1)`, and cos_d."""
    cos_d = _cos_d(half, outgoing)
    return 2 * cos_d * half[:, None] - outgoing, cos_d


def _cos_d(half: Tensor, outgoing: Tensor) -> Tensor:
    # Below 0 it is only where the light is below the horizon.
    return (outgoing[0] * half[0] + outgoing[2] * half[2]).clamp_min_(1e-6)


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
    # The directions are in the frame of the viewer, and say nothing of the surface's tangent: they come last.
    return Pairs(**known, wi=wi, wo=wo)


def turned(pairs: Pairs, azimuth: Tensor) -> Pairs:
    """Pairs `(1, p L)` of p pixels with directions in the frame of the surface's tangent, whose azimuth is given."""
    angle = -azimuth.repeat_interleave(len(pairs) // len(azimuth))[None]
    directions = {"wi": half_difference.turned(pairs.wi, angle), "wo": half_difference.turned(pairs.wo, angle)}
    return Pairs(**directions, **{name: value for name, value in pairs.items() if name not in directions})


def _pairs_at(place: Tensor) -> Pairs:
    """Pairs `(1, n)` at coordinates of `LightQuadrature`, `(3, n)`, float64."""
    u_h, u_d, u_phi = place
    along = 1 - 2 * u_phi
    theta_h, theta_d = (2 * torch.asin((u * math.sqrt(0.5)).clamp_max(math.sqrt(0.5))) for u in (u_h.square(), u_d))
    return Pairs.from_half_diff(*(x[None] for x in (theta_h, theta_d, torch.atan2(1 - along.abs(), along))))
