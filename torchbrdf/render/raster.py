"""Which triangle each pixel shows: a z-buffer in numpy."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from torchbrdf.errors import UsageError
from torchbrdf.render.mesh import Mesh

# How much of the frame's width the bounding sphere takes, whatever the rotation.
_FILL = 0.92
# Pixels in faces that are looked at in one go; bounds the memory.
_CHUNK = 2_000_000
# A pixel centre this near to an edge, in pixels, is in both faces, so that none is lost between them.
_SLACK = 1e-7


@dataclass(frozen=True)
class View:
    """A perspective camera that looks at the middle of an object from as far as the field of view asks.

    rotation: degrees about the vertical axis through the object; 0 looks from +z, 90 from +x.
    field_of_view: of the whole frame, in degrees.
    """

    rotation: float = 0.0
    field_of_view: float = 30.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.rotation):
            raise UsageError(f"View.rotation: expected degrees, found {self.rotation}")
        if not 1 <= self.field_of_view <= 120:
            raise UsageError(f"View.field_of_view: expected 1 to 120 degrees, found {self.field_of_view}")

    def camera(self, mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
        """The eye `(3,)`, and the camera's axes as rows `(3, 3)`: right, up, and back from the object to the eye."""
        center, radius = mesh.bounding_sphere
        angle = math.radians(self.rotation)
        right = np.array([math.cos(angle), 0.0, -math.sin(angle)])
        back = np.array([math.sin(angle), 0.0, math.cos(angle)])
        distance = radius / math.sin(math.atan(_FILL * math.tan(math.radians(self.field_of_view) / 2)))
        return center + distance * back, np.stack([right, [0.0, 1.0, 0.0], back])


@dataclass(frozen=True)
class GBuffer:
    """What a view shows, each `(size, size, ...)`, top row first: the triangle's id (-1 for none), barycentrics,
    positions and smooth unit normals (0 where there is nothing)."""

    triangle: np.ndarray
    barycentric: np.ndarray
    position: np.ndarray
    normal: np.ndarray

    @property
    def mask(self) -> np.ndarray:
        """Where there is something to see."""
        return self.triangle >= 0


def rasterize(mesh: Mesh, view: View, size: int) -> GBuffer:
    """The nearest triangle at the centre of each of `size` x `size` pixels. Triangles have two sides."""
    eye, axes = view.camera(mesh)
    local = (mesh.vertices - eye) @ axes.T
    depth = -local[:, 2]
    scale = size / (2 * math.tan(math.radians(view.field_of_view) / 2))
    # Pixel (row, column) has its centre at x = column, y = row.
    screen = np.stack([local[:, 0], -local[:, 1]], -1) * (scale / depth)[:, None] + (size - 1) / 2
    planes = _planes(screen[mesh.faces])
    # 1 / depth is linear on the screen, barycentrics times 1 / depth are, too.
    planes = planes / depth[mesh.faces][..., None]
    closeness = planes.sum(1)
    nearest = np.zeros(size * size)
    triangle = np.full(size * size, -1, np.int64)
    for face, row, column in _covered(screen[mesh.faces], size):
        near = closeness[face, 0] * column + closeness[face, 1] * row + closeness[face, 2]
        pixel = row * size + column
        np.maximum.at(nearest, pixel, near)
        # Not faces edge on, whose planes are 0; of equals the first id is written last.
        shown = np.flatnonzero((near == nearest[pixel]) & (near > 0))[::-1]
        triangle[pixel[shown]] = face[shown]
    seen = np.flatnonzero(triangle >= 0)
    face = triangle[seen]
    point = np.stack([seen % size, seen // size, np.ones_like(seen)], -1)
    weights = np.einsum("pkc,pc->pk", planes[face], point)
    weights /= weights.sum(1, keepdims=True)
    normal = np.einsum("pk,pkc->pc", weights, mesh.normals[mesh.faces[face]])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    position = np.einsum("pk,pkc->pc", weights, mesh.vertices[mesh.faces[face]])

    def spread(values: np.ndarray) -> np.ndarray:
        whole = np.zeros((size * size, 3))
        whole[seen] = values
        return whole.reshape(size, size, 3)

    return GBuffer(triangle.reshape(size, size), spread(weights), spread(position), spread(normal))


def _planes(corners: np.ndarray) -> np.ndarray:
    """Barycentric k of a face at (x, y) as planes[face, k] . (x, y, 1); corners `(F, 3, 2)`. 0 for a face edge on."""
    x, y = corners[..., 0], corners[..., 1]
    following, last = [1, 2, 0], [2, 0, 1]
    edges = np.stack(
        [
            y[:, following] - y[:, last],
            x[:, last] - x[:, following],
            x[:, following] * y[:, last] - x[:, last] * y[:, following],
        ],
        -1,
    )
    doubled = edges[..., 2].sum(1)[:, None, None]
    return np.where(doubled != 0, edges / np.where(doubled != 0, doubled, 1), 0)


def _covered(corners: np.ndarray, size: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Face, row and column of every pixel centre in every face, in parts; corners `(F, 3, 2)`."""
    top = np.clip(np.ceil(corners[..., 1].min(1)), 0, size).astype(np.int64)
    bottom = np.clip(np.floor(corners[..., 1].max(1)) + 1, 0, size).astype(np.int64)
    rows = np.maximum(bottom - top, 0)
    for faces in _parts(rows):
        face = np.repeat(faces, rows[faces])
        row = top[face] + _steps(rows[faces])
        left, right = _span(corners[face], row)
        left = np.clip(np.ceil(left - _SLACK), 0, size).astype(np.int64)
        right = np.clip(np.floor(right + _SLACK) + 1, 0, size).astype(np.int64)
        columns = np.maximum(right - left, 0)
        for spans in _parts(columns):
            count = columns[spans]
            yield (
                np.repeat(face[spans], count),
                np.repeat(row[spans], count),
                np.repeat(left[spans], count) + _steps(count),
            )


def _span(corners: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a row enters and leaves each triangle: the extremes of its crossings with the edges."""
    start, end = corners, corners[:, [1, 2, 0]]
    rise = end[..., 1] - start[..., 1]
    level = rise == 0
    share = (row[:, None] - start[..., 1]) / np.where(level, 1, rise)
    crossing = start[..., 0] + share * (end[..., 0] - start[..., 0])
    outside = level | (share < 0) | (share > 1)
    return np.where(outside, np.inf, crossing).min(1), np.where(outside, -np.inf, crossing).max(1)


def _steps(counts: np.ndarray) -> np.ndarray:
    """0, 1, ... count - 1 for every count, one behind the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)


def _parts(counts: np.ndarray) -> Iterator[np.ndarray]:
    """Indices of the counts above 0, in parts that add up to about _CHUNK."""
    used = np.flatnonzero(counts)
    total = np.cumsum(counts[used])
    for part in range(int(total[-1]) // _CHUNK + 1 if len(total) else 0):
        yield used[(total > part * _CHUNK) & (total <= (part + 1) * _CHUNK)]
