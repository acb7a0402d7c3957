"""What each pixel shows of a mesh: the triangle, and the place on it."""

from dataclasses import dataclass

import numpy as np

from torchbrdf.errors import UsageError
from torchbrdf.render.raster.backends import nearest_triangles
from torchbrdf.render.raster.camera import Camera
from torchbrdf.render.raster.mesh import Mesh

__all__ = ["Camera", "GBuffer", "rasterize"]

# Pixels at a time: what is known of them stays in a processor's cache.
_PIXELS = 1 << 14


@dataclass(frozen=True)
class GBuffer:
    """Geometry that a camera sees, each `(size, size, ...)`, top row first.

    The triangle's id (-1 for none), positions and smooth unit normals (0 where there is nothing), and the mesh's
    tangents, None if it has none.
    """

    triangle: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray | None = None

    @property
    def mask(self) -> np.ndarray:
        """Where there is something to see."""
        return self.triangle >= 0


def rasterize(mesh: Mesh, camera: Camera, size: int, backend: str = "software") -> GBuffer:
    """Rasterize a mesh: what is at the centre of each of `size` x `size` pixels. Triangles have two sides.

    backend: what finds the triangles, see `render.raster.backends`; all else is the same code in double precision.
    """
    if size < 1:
        raise UsageError(f"rasterize: expected size >= 1, found {size}")
    points = camera.project(mesh, size)
    triangle = nearest_triangles(points, mesh.faces, size, backend)
    position, normal = (np.zeros((size * size, 3)) for _ in range(2))
    tangent = None if mesh.tangents is None else np.zeros((size * size, 3))
    seen = np.flatnonzero(triangle >= 0)
    for pixels in np.array_split(seen, len(seen) // _PIXELS + 1):
        corners = mesh.faces[triangle.reshape(-1)[pixels]]
        weights = _barycentrics(points[:, corners.T], pixels % size, pixels // size)
        position[pixels] = _blend(weights, mesh.vertices, corners)
        smooth = _blend(weights, mesh.normals, corners)
        length = np.sqrt(np.einsum("pc,pc->p", smooth, smooth))
        normal[pixels] = smooth / np.maximum(length, 1e-30)[:, None]
        if tangent is not None and mesh.tangents is not None:
            tangent[pixels] = _blend(weights, mesh.tangents, corners)
    found = (None if values is None else values.reshape(size, size, 3) for values in (position, normal, tangent))
    return GBuffer(triangle, *found)  # type: ignore[arg-type]


def _barycentrics(corners: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Perspective-correct barycentrics `(3, p)` of pixels in triangles with corners on the screen `(3, 3, p)`.

    Where a pixel is a little outside of its triangle, as OpenGL's rounding of corners allows, they are those of a
    place inside.
    """
    # Seen from the pixel, each edge spans a triangle with it, whose area is exact where it is next to nothing.
    x, y, closeness = corners[0] - column, corners[1] - row, corners[2]
    following, last = [1, 2, 0], [2, 0, 1]
    areas = x[following] * y[last] - x[last] * y[following]
    areas *= np.sign(areas[0] + areas[1] + areas[2])
    weights = np.maximum(areas, 0) * closeness
    total = weights[0] + weights[1] + weights[2]
    return np.where(total > 0, weights, 1) / np.where(total > 0, total, 3)


def _blend(weights: np.ndarray, values: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Values `(V, 3)` of the corners `(p, 3)`, weighted; `(p, 3)`."""
    first, second, third = (weights[k][:, None] * values.take(corners[:, k], 0) for k in range(3))
    return first + second + third
