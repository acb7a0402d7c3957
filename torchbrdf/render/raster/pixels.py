"""What each pixel of a picture shows: a point of the surface, its frame, and the way to the viewer."""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.render.light.octahedral import to_square
from torchbrdf.render.raster.camera import Camera
from torchbrdf.render.raster.mesh import Mesh, level_tangents
from torchbrdf.render.raster.raster import rasterize

# Pixels are looked at in a raster this much finer, so that the outline is smooth.
_FINER = 3
# Of the finer pixels in a pixel the first that shows something speaks for it: the middle one, if it can.
_PRIORITY = [4, 1, 3, 5, 7, 0, 2, 6, 8]
# A smooth normal may face away at the outline, where its flat triangle does not; it is bent to have this cosine.
_LOWEST = 0.02
# Of a tangent the share of its square that has to lie in the surface.
_NO_TANGENT = 1e-8


@dataclass(frozen=True)
class Pixels:
    """The P pixels of a square picture that show something, those with like normals beside each other.

    coverage: `(size, size)`, the share of each pixel that the object covers; index: `(P,)`, row by row; position:
    `(P, 3)`; frame: `(P, 3, 3)`, rows tangent, bitangent, normal; outgoing: `(3, P)`, to the viewer, in that frame
    (sin, 0, cos); tangent: `(P, 3)`, the mesh's own, if it has some. float32.
    """

    coverage: Tensor
    index: Tensor
    position: Tensor
    frame: Tensor
    outgoing: Tensor
    tangent: Tensor | None = None

    def __len__(self) -> int:
        return len(self.index)

    def select(self, rows: Tensor) -> "Pixels":
        """Some of the pixels, by row."""
        tangent = None if self.tangent is None else self.tangent[rows]
        return Pixels(
            self.coverage, self.index[rows], self.position[rows], self.frame[rows], self.outgoing[:, rows], tangent
        )

    @cached_property
    def azimuth(self) -> Tensor:
        """Where the surface's own tangent lies in the frame, radians, `(P,)`: the mesh's, or the level one."""
        level = torch.from_numpy(level_tangents(self.frame[:, 2].double().numpy())).to(self.frame)
        own = level if self.tangent is None else self.tangent
        along, across = (_along(own, self.frame[:, k]) for k in (0, 1))
        # What is next to nothing, or along the normal, has no direction.
        none = along.square() + across.square() < _NO_TANGENT * own.square().sum(-1).clamp_min(1e-30)
        own = torch.where(none[:, None], level, own)
        return torch.atan2(_along(own, self.frame[:, 1]), _along(own, self.frame[:, 0]))


def rasterize_pixels(mesh: Mesh, camera: Camera, size: int, backend: str) -> Pixels:
    """Rasterize a mesh: the surface that each pixel shows. A DataError if there is nothing to see."""
    fine = rasterize(mesh, camera, size * _FINER, backend)
    eye, _ = camera.pose(mesh)

    def blocks(values: Tensor) -> Tensor:
        split = values.unflatten(0, (size, _FINER)).unflatten(2, (size, _FINER)).transpose(1, 2)
        return split.reshape(size**2, _FINER**2, *values.shape[2:])

    seen = blocks(torch.from_numpy(fine.mask))
    coverage = seen.to(torch.float32).mean(1).reshape(size, size)
    pixel = seen.any(1).nonzero()[:, 0]
    if not len(pixel):
        raise DataError(f"{mesh.name}: nothing to see; expected a mesh that covers a point of {size} x {size} pixels")
    order = torch.tensor(_PRIORITY, dtype=torch.int64, device="cpu")
    chosen = order[seen[pixel][:, _PRIORITY].to(torch.uint8).argmax(1)]
    position = blocks(torch.from_numpy(fine.position))[pixel, chosen]
    normal = blocks(torch.from_numpy(fine.normal))[pixel, chosen]
    face = blocks(torch.from_numpy(fine.triangle))[pixel, chosen]
    outgoing = F.normalize(torch.from_numpy(eye) - position, dim=-1)
    normal = _bent(_facing(mesh, normal, face, outgoing), outgoing)
    # Pixels with like normals go together, so that lights below the horizon can be left out for many at once.
    order = _along_a_curve(normal).argsort(stable=True)
    frame, outgoing = _frames(normal[order], outgoing[order])
    parts = (position[order], frame, outgoing)
    tangent = None
    if fine.tangent is not None:
        tangent = blocks(torch.from_numpy(fine.tangent))[pixel, chosen][order].to(torch.float32)
    position, frame, outgoing = (part.to(torch.float32) for part in parts)
    return Pixels(coverage, pixel[order], position, frame, outgoing, tangent)


def _facing(mesh: Mesh, normal: Tensor, face: Tensor, outgoing: Tensor) -> Tensor:
    """The normals, turned round where a face is seen from the side they do not point to."""
    corners = torch.from_numpy(mesh.vertices[mesh.faces[face.numpy()]])
    flat = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    behind = (flat * normal).sum(-1) * (flat * outgoing).sum(-1) < 0
    return torch.where(behind[:, None], -normal, normal)


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
    axes = torch.eye(3, dtype=normal.dtype, device=normal.device)
    anything = torch.linalg.cross(normal, axes[normal.abs().argmin(-1)])
    tangent = F.normalize(torch.where(sine > 1e-9, across, anything), dim=-1)
    frame = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], 1)
    return frame, torch.stack([sine, torch.zeros_like(sine), cosine])[..., 0]


def _along(vectors: Tensor, axes: Tensor) -> Tensor:
    return (vectors * axes).sum(-1)


def _along_a_curve(directions: Tensor) -> Tensor:
    """A number for each direction that is alike for directions that are: its place along a Z-shaped curve."""
    first, second = (((0.5 + 0.5 * x) * 64).to(torch.int64).clamp(0, 63) for x in to_square(directions.T))
    place = torch.zeros_like(first)
    for bit in range(6):
        place |= ((first >> bit & 1) << 2 * bit) | ((second >> bit & 1) << (2 * bit + 1))
    return place
