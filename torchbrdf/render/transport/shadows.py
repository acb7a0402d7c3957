"""Which lights a point of the surface sees: rays against the triangles, by Embree."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.render.raster.mesh import Mesh

# Rays at a time; bounds the memory.
_CHUNK = 1 << 18
# How far from the surface rays start, in units of the largest coordinate: some 30 roundings of a float32 position.
_CLEARANCE = 4e-6
# How far around a point its own triangle is looked for, in units of the clearance.
_REACH = 16


class Occluder:
    """Occluder: a mesh that light may be kept off by.

    Rays start on the smooth surface that the normals belong to, and not on the flat triangles, where a light that is
    above the horizon of the smooth normal may be below that of the triangle: neighbours would then shade each other,
    in the pattern of the triangles, wherever the light grazes. The start is lifted off its triangle to the mean of its
    projections onto the tangent planes of the three corners, as far as these are above it, then by a small distance
    along the triangle's normal. Where something is in the way of that, only the small distance remains.

    Source: J. Hanika, Hacking the Shadow Terminator, in: Ray Tracing Gems II, 2021, ch. 4,
    doi:10.1007/978-1-4842-7185-8_4.
    """

    def __init__(self, mesh: Mesh) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError:
            raise UsageError("shadows: embreex is missing; pip install torchbrdf[shadows]") from None
        # Embree knows only float32: of coordinates about the middle, it keeps the most.
        self._center = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
        corners = (mesh.vertices - self._center)[mesh.faces]
        self._corners, self._normals = corners, mesh.normals[mesh.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # On the side that the normals point to, whichever way round the corners go.
        self._flat = _unit(across) * np.where((across * self._normals.sum(1)).sum(1) < 0, -1.0, 1.0)[:, None]
        self._clearance = _CLEARANCE * float(np.abs(mesh.vertices).max())
        # Without "robust", rays slip between triangles that meet in a corner.
        self._scene: Any = EmbreeScene(robust=True)
        TriangleMesh(self._scene, (mesh.vertices - self._center).astype(np.float32), mesh.faces.astype(np.int32))
        self._blocked(np.zeros((1, 3)), np.ones((1, 3)))  # the first ray makes the tree: not in two threads at once

    def visible(
        self, origin: Tensor, direction: Tensor, wanted: Tensor | None = None, limit: Tensor | float | None = None
    ) -> Tensor:
        """Visibility of lights from points: whether nothing of the mesh is met, bool `(p, L)`.

        origin: points of the surface, `(p, 3)`. direction: unit vectors, `(p, L, 3)`, all on the side of the surface
        that is lit. wanted: bool `(p, L)`, where there is a question; the answer is False elsewhere, at no cost. limit:
        how far away the light is, `(p, L)` or one number for all; what is behind it keeps no light off.

        Any number of threads may ask at once: Embree's queries change nothing, and run without Python's lock.
        """
        shape = direction.shape[:2]
        wanted = torch.ones(shape, dtype=torch.bool, device="cpu") if wanted is None else wanted
        start = torch.from_numpy(self._starts(origin, direction, wanted))
        reach = None if limit is None else torch.as_tensor(limit, dtype=torch.float32, device="cpu").expand(shape)
        seen = torch.zeros(shape, dtype=torch.bool, device="cpu")
        for point, light in zip(*(index.split(_CHUNK) for index in wanted.nonzero(as_tuple=True)), strict=True):
            # A light that touches the surface is not behind it.
            far = None if reach is None else (reach[point, light] * (1 - 1e-5) - 2 * self._clearance).clamp_min(0)
            hit = self._blocked(start[point].numpy(), direction[point, light].numpy(), far)
            seen[point, light] = torch.from_numpy(~hit)
        return seen

    def _blocked(self, start: np.ndarray, direction: np.ndarray, far: Tensor | None = None) -> np.ndarray:
        """Whether rays `(n, 3)` meet anything, bool `(n,)`, nearer than `far` `(n,)`."""
        rays = (np.ascontiguousarray(part, np.float32) for part in (start, direction))
        dists = None if far is None else far.clamp_max(1e37).numpy()
        return self._scene.run(*rays, dists, query="OCCLUDED") != -1

    def _starts(self, origin: Tensor, direction: Tensor, wanted: Tensor) -> np.ndarray:
        """Where rays from points `(p, 3)` start, about the middle of the mesh, float32 `(p, 3)`."""
        point = origin.numpy().astype(np.float64) - self._center
        toward = _unit(torch.where(wanted[..., None], direction, 0).sum(1).numpy().astype(np.float64))
        face, weights = self._find(point)
        weights = weights[..., None]
        smooth, flat = (self._normals[face] * weights).sum(1), self._flat[face]
        # Surfaces have two sides; the lights are on the lit one.
        side = np.where((smooth * toward).sum(1) < 0, -1.0, 1.0)[:, None]
        above = ((point[:, None] - self._corners[face]) * self._normals[face]).sum(-1, keepdims=True) * side[:, None]
        lift = side * (np.maximum(-above, 0) * self._normals[face] * weights).sum(1)
        # The outermost corners of a sheet may be found on no triangle.
        away = np.where(face[:, None] >= 0, side * flat, toward)
        near = point + self._clearance * away
        length = np.linalg.norm(lift, axis=1).astype(np.float32)
        free = (face >= 0) & ~self._blocked(near, _unit(lift), torch.from_numpy(length))
        return (near + np.where(free[:, None], lift, 0)).astype(np.float32)

    def _find(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The triangle of each point of the surface `(p, 3)`, -1 if it is on none, and its barycentrics `(p, 3)`.

        A short ray along one axis at least crosses it well.
        """
        reach = _REACH * self._clearance
        axis = np.repeat(np.eye(3), len(point), 0)
        start = (np.tile(point, (3, 1)) - reach * axis).astype(np.float32)
        far = np.full(len(start), 2 * reach, np.float32)
        found = self._scene.run(start, axis.astype(np.float32), far, output=True)
        met = found["primID"] >= 0
        away = np.where(met, np.abs(found["tfar"] - reach), np.inf).reshape(3, -1)
        best = away.argmin(0) * len(point) + np.arange(len(point))
        u, v = found["u"][best].astype(np.float64), found["v"][best].astype(np.float64)
        return np.where(met[best], found["primID"][best], -1), np.stack([1 - u - v, u, v], 1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors `(n, 3)` with length 1, or 0."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
