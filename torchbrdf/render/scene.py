"""A scene is pairs of directions for every pixel, and how much each counts; a picture is their weighted sum."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.pairs import Pairs
from torchbrdf.render.environment import Environment
from torchbrdf.render.mesh import Mesh
from torchbrdf.render.octahedral import to_square
from torchbrdf.render.raster import View, rasterize

Chunk = tuple[Tensor, Pairs, Tensor]

# Pixels are looked at in a raster this much finer, so that the outline is smooth.
_FINER = 3
# Of the finer pixels in a pixel the first that shows something speaks for it: the middle one, if it can.
_PRIORITY = [4, 1, 3, 5, 7, 0, 2, 6, 8]
# Pairs at a time: their quantities then stay in a processor's cache.
_CHUNK = 65536
# `pairs` and `transport` keep about so many bytes a pair.
_QUANTITIES = ("wi", "wo", "cos_i", "cos_o", "cos_d", "cos_h", "tan2_h", "theta_d", "phi_d")
_BYTES_PER_PAIR = 4 * (len(_QUANTITIES) + 4 + 3) + 8
_LARGEST = 2**31
# A smooth normal may face away at the outline, where its flat triangle does not; it is bent to have this cosine.
_LOWEST = 0.02
# The two quadratures share the half vectors between these angles from the normal, in degrees.
_NEAR, _FAR = 5.0, 20.0
# Nodes around the mirror direction lie at theta_h = _FAR t^_SHARPENING for t evenly in (0, 1).
_SHARPENING = 1.5
_GOLDEN = math.pi * (3 - math.sqrt(5))
# The share of a node's solid angle that the environment is averaged over before it is interpolated, which blurs as
# much again: at 1 pictures lost 2 to 6 dB, at 1/4 up to 2. Toward grazing the solid angle falls as cos_d, but the
# nodes stay as far apart in the plane of incidence, so that a small sun would slip through; hence the least cos_d.
_BLUR, _LEAST = 0.5, 0.5


@dataclass(frozen=True)
class Transport:
    """The picture as a linear function of BRDF values on a scene's pairs: `transport @ values`.

    pixel: `(N,)`, the pixel (row by row) that each pair belongs to; weight: `(N, 3)`, radiance times the cosine
    times the solid angle; size: of the square picture.
    """

    pixel: Tensor
    weight: Tensor
    size: int

    def __matmul__(self, values: Tensor) -> Tensor:
        """The linear picture `(M, size, size, 3)` of values `(M, N, 3)` in 1/sr; differentiable."""
        if values.dim() != 3 or values.shape[1:] != self.weight.shape:
            raise ShapeError(f"transport: expected values (M, {len(self.weight)}, 3), found {(*values.shape,)}")
        picture = values.new_zeros(len(values), self.size**2, 3)
        picture = picture.index_add(1, self.pixel, values * self.weight.to(values))
        return picture.unflatten(1, (self.size, self.size))


class Scene:
    """An object in an environment, seen by a camera: what a picture needs beside the BRDF.

    The light that leaves a pixel is the integral over incident directions of BRDF, radiance and cosine. Two
    quadratures share it, by a smooth weight s that goes from 1 at theta_h = 5 degrees to 0 at 20:

    - s times the integrand over half vectors, on `nodes` of them in a spiral that is dense at the normal, each with
      the environment averaged over its solid angle 4 cos_d d(omega_h): sharp lobes are smooth in theta_h, however
      detailed the environment is;
    - 1 - s times it over `lights` fixed lights that stand for the whole environment: there is no sharp lobe left, and
      however small the sun is, it is one of the lights.

    There is no shadowing of the object by itself and no interreflection.
    """

    def __init__(
        self,
        mesh: Mesh,
        view: View | None = None,
        environment: Environment | None = None,
        size: int = 400,
        nodes: int = 256,
        lights: int = 1024,
    ) -> None:
        if size < 1 or nodes < 8:
            raise UsageError(f"Scene: expected size >= 1 and nodes >= 8, found size {size}, nodes {nodes}")
        self.mesh = mesh
        self.view = view or View()
        self.environment = environment or Environment.default()
        self.size = size
        self.nodes = nodes
        self._lights = self.environment.lights(lights)
        self._see()

    def _see(self) -> None:
        """Fill in what every pixel shows: `coverage`, `mask`, and the frames of those that show something."""
        fine = rasterize(self.mesh, self.view, self.size * _FINER)
        eye, _ = self.view.camera(self.mesh)

        def blocks(values: Tensor) -> Tensor:
            split = values.unflatten(0, (self.size, _FINER)).unflatten(2, (self.size, _FINER)).transpose(1, 2)
            return split.reshape(self.size**2, _FINER**2, *values.shape[2:])

        seen = blocks(torch.from_numpy(fine.mask))
        self.coverage = seen.to(torch.float32).mean(1).reshape(self.size, self.size)
        self.mask = self.coverage > 0
        pixel = seen.any(1).nonzero()[:, 0]
        if not len(pixel):
            raise DataError(f"scene: nothing to see; the mesh covers no point of {self.size} x {self.size} pixels")
        chosen = torch.tensor(_PRIORITY)[seen[pixel][:, _PRIORITY].to(torch.uint8).argmax(1)]
        position = blocks(torch.from_numpy(fine.position))[pixel, chosen]
        normal = blocks(torch.from_numpy(fine.normal))[pixel, chosen]
        face = blocks(torch.from_numpy(fine.triangle))[pixel, chosen]
        outgoing = F.normalize(torch.from_numpy(eye) - position, dim=-1)
        normal = _bent(self._facing(normal, face, outgoing), outgoing)
        # Pixels with like normals go together, so that lights below the horizon can be left out for many at once.
        order = _along_a_curve(normal).argsort(stable=True)
        frame, outgoing = _frames(normal[order], outgoing[order])
        self._pixel = pixel[order]
        self._frame, self._outgoing = frame.to(torch.float32), outgoing.to(torch.float32)

    def _facing(self, normal: Tensor, face: Tensor, outgoing: Tensor) -> Tensor:
        """The normals, turned round where a face is seen from the side they do not point to."""
        corners = torch.from_numpy(self.mesh.vertices[self.mesh.faces])[face]
        flat = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        behind = (flat * normal).sum(-1) * (flat * outgoing).sum(-1) < 0
        return torch.where(behind[:, None], -normal, normal)

    @cached_property
    def _nodes(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Half vectors `(3, n)` of the spiral; of each, `(n,)`: tan^2 theta_h, 4 d(omega_h), and the weight s."""
        edge = torch.linspace(0, 1, self.nodes + 1, dtype=torch.float64) ** _SHARPENING * math.radians(_FAR)
        order = torch.arange(self.nodes, dtype=torch.float64)
        theta = ((order + 0.5) / self.nodes) ** _SHARPENING * math.radians(_FAR)
        azimuth = order * _GOLDEN
        half = torch.stack([theta.sin() * azimuth.cos(), theta.sin() * azimuth.sin(), theta.cos()])
        # cos a - cos b = 2 sin((b + a) / 2) sin((b - a) / 2), without the cancellation
        solid = 4 * math.pi * ((edge[1:] + edge[:-1]) / 2).sin() * ((edge[1:] - edge[:-1]) / 2).sin()
        parts = (half, theta.tan().square(), 4 * solid, _near(theta.cos()))
        return tuple(part.to(torch.float32) for part in parts)  # type: ignore[return-value]

    def chunks(self) -> Iterator[Chunk]:
        """The whole quadrature in parts: pixels `(p,)`, Pairs `(1, p L)`, weights `(p, L, 3)`.

        Pixels count row by row. Each comes up once around the mirror direction and once for the fixed lights.
        """
        return (job() for job in self.jobs())

    def jobs(self) -> list[Callable[[], Chunk]]:
        """What makes each of the chunks, so that they can be made side by side."""

        def job(make: Callable[[Tensor], tuple[Pairs, Tensor]], part: Tensor) -> Callable[[], Chunk]:
            return lambda: (self._pixel[part], *make(part))

        lengths = {self._around_the_mirror: self.nodes, self._fixed_lights: (len(self._lights.flux) + 1) // 2}
        whole = torch.arange(len(self._pixel))
        return [job(make, part) for make, length in lengths.items() for part in whole.split(max(_CHUNK // length, 1))]

    def _around_the_mirror(self, part: Tensor) -> tuple[Pairs, Tensor]:
        frame, outgoing = self._frame[part], self._outgoing[:, part, None]
        half, tan2_h, solid, share = self._nodes
        # Below 0 it is only where the light is below the horizon.
        cos_d = (outgoing[0] * half[0] + outgoing[2] * half[2]).clamp_min(1e-6)
        incident = 2 * cos_d * half[:, None] - outgoing  # (3, p, n), in each pixel's frame
        directions = (frame.transpose(1, 2) @ incident.transpose(0, 1)).transpose(1, 2)
        radiance = self.environment.lookup(directions, _BLUR * solid * cos_d.clamp_min(_LEAST))
        weight = radiance * (incident[2].clamp_min(0) * cos_d * (solid * share))[..., None]
        return _pairs(incident, outgoing, cos_d, half[2], tan2_h, outgoing[0] * half[1]), weight

    def _fixed_lights(self, part: Tensor) -> tuple[Pairs, Tensor]:
        frame, outgoing = self._frame[part], self._outgoing[:, part, None]
        used = (frame[:, 2] @ self._lights.direction.T > 0).any(0)
        incident = (frame @ self._lights.direction[used].T).transpose(0, 1).contiguous()  # (3, p, l)
        half = incident + outgoing
        horizontal, upward = half[0].square() + half[1].square(), half[2].square()
        length = (horizontal + upward).sqrt().clamp_min(1e-6)
        cos_h = half[2] / length
        weight = self._lights.flux[used] * (incident[2].clamp_min(0) * (1 - _near(cos_h)))[..., None]
        tan2_h = horizontal / upward.clamp_min(1e-12)
        return _pairs(incident, outgoing, length / 2, cos_h, tan2_h, outgoing[0] * incident[1] / length), weight

    @cached_property
    def _whole(self) -> tuple[Pairs, Transport]:
        most = len(self._pixel) * (self.nodes + len(self._lights.flux))
        if most * _BYTES_PER_PAIR > _LARGEST:
            raise UsageError(
                f"scene of {self.size} x {self.size} pixels: up to {most} pairs would take "
                f"{most * _BYTES_PER_PAIR / 2**30:.1f} GiB, expected at most {_LARGEST / 2**30:.0f}; "
                "use fewer pixels, nodes or lights, or render(), which needs no table"
            )
        pixels, weights, quantities = [], [], []
        for pixel, pairs, weight in self.chunks():
            used = (weight > 0).any(-1).flatten().nonzero()[:, 0]
            pixels.append(pixel.repeat_interleave(weight.shape[1])[used])
            weights.append(weight.reshape(-1, 3)[used])
            quantities.append([getattr(pairs, name).index_select(1, used) for name in _QUANTITIES])
        whole = (torch.cat(parts, 1) for parts in zip(*quantities, strict=True))
        transport = Transport(torch.cat(pixels), torch.cat(weights), self.size)
        return Pairs(**dict(zip(_QUANTITIES, whole, strict=True))), transport

    @property
    def pairs(self) -> Pairs:
        """All pairs that count for any pixel, `(1, N)`, if the scene is small enough, as one of 100 x 100 pixels is."""
        return self._whole[0]

    @property
    def transport(self) -> Transport:
        """What makes the picture of the values on `pairs`."""
        return self._whole[1]


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


def _near(cos_h: Tensor) -> Tensor:
    """The weight s: 1 for half vectors near the normal, 0 far from it, smooth (3 t^2 - 2 t^3) in between."""
    near, far = math.cos(math.radians(_NEAR)), math.cos(math.radians(_FAR))
    t = ((cos_h - far) / (near - far)).clamp(0, 1)
    return t.square() * (3 - 2 * t)


def _bent(normal: Tensor, outgoing: Tensor) -> Tensor:
    """Unit normals that face the viewer: those that do not are tilted toward it as little as need be."""
    cosine = (normal * outgoing).sum(-1, keepdim=True)
    flat = F.normalize(normal - cosine * outgoing, dim=-1)
    return torch.where(cosine < _LOWEST, _LOWEST * outgoing + math.sqrt(1 - _LOWEST**2) * flat, normal)


def _frames(normal: Tensor, outgoing: Tensor) -> tuple[Tensor, Tensor]:
    """Rows tangent, bitangent, normal `(p, 3, 3)`, and `outgoing` in that frame, (sin, 0, cos), `(3, p)`."""
    cosine = (normal * outgoing).sum(-1, keepdim=True)
    across = outgoing - cosine * normal
    sine = across.norm(dim=-1, keepdim=True)
    anything = torch.linalg.cross(normal, torch.eye(3).to(normal)[normal.abs().argmin(-1)])
    tangent = F.normalize(torch.where(sine > 1e-9, across, anything), dim=-1)
    frame = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], 1)
    return frame, torch.stack([sine, torch.zeros_like(sine), cosine])[..., 0]


def _along_a_curve(directions: Tensor) -> Tensor:
    """A number for each direction that is alike for directions that are: its place along a Z-shaped curve."""
    first, second = (((0.5 + 0.5 * x) * 64).to(torch.int64).clamp(0, 63) for x in to_square(directions))
    place = torch.zeros_like(first)
    for bit in range(6):
        place |= ((first >> bit & 1) << 2 * bit) | ((second >> bit & 1) << (2 * bit + 1))
    return place
