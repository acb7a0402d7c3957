"""What readers of meshes give, and how polygons become triangles."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError

Say = Callable[[str], None]
"""Takes one line on what was left out or repaired."""

# Triangles of one mesh. Beyond that a picture of a few hundred pixels shows nothing more, and nobody waits for it.
MOST_FACES = 5_000_000
# Corners of a polygon that are tried as the one that all its triangles share.
_TRIES = 64


@dataclass(frozen=True)
class Part:
    """Triangles of a file, as they are in it.

    vertices: `(V, 3)`, float64. faces: indices of corners, `(F, 3)`, int64. normals: `(V, 3)`, float64, as they are in
    the file, NaN for a vertex that has none; None if no vertex has one. coordinates: `(V, 2)`, of textures, alike.
    tangents: `(V, 3)`, alike; they count before those that follow from coordinates.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    coordinates: np.ndarray | None = None
    tangents: np.ndarray | None = None


def check_count(path: Path, count: int) -> None:
    """A DataError if there are too many triangles."""
    if count > MOST_FACES:
        raise DataError(f"{path}: expected at most {MOST_FACES} triangles, found {count} or more; simplify the mesh")


def check_indices(path: Path, indices: np.ndarray, count: int, what: str = "vertex") -> None:
    """A DataError if an index names nothing: `count` is how many there are."""
    if len(indices) and not 0 <= indices.min() <= indices.max() < count:
        wrong = indices.min() if indices.min() < 0 else indices.max()
        raise DataError(f"{path}: expected faces that name one of {count} {what} entries, found index {wrong}")


Polygons = Sequence[Sequence[int] | np.ndarray] | np.ndarray
"""The corners of each; an array where all have as many."""


def triangulate(path: Path, vertices: np.ndarray, polygons: Polygons, say: Say) -> np.ndarray:
    """Triangles of polygons, `(F, 3)`, in their order: fans from a corner that sees the whole polygon, if there is one.

    A polygon of less than three corners draws nothing and is left out.
    """
    lengths = np.fromiter(map(len, polygons), np.int64, len(polygons))
    small, folded = int((lengths < 3).sum()), 0
    made, order = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for length in np.unique(lengths[lengths >= 3]):
        own = np.flatnonzero(lengths == length)
        chosen = polygons[own] if isinstance(polygons, np.ndarray) else [polygons[int(k)] for k in own]
        rows = np.array(chosen).astype(np.int64)
        check_indices(path, rows, len(vertices))
        if length > 3:
            rows, bad = _best_fan(vertices, rows)
            folded += bad
        fans = [np.stack([rows[:, 0], rows[:, k], rows[:, k + 1]], 1) for k in range(1, length - 1)]
        made.append(np.stack(fans, 1).reshape(-1, 3))
        order.append(own.repeat(length - 2))
    if small:
        say(f"left out {small} of {len(polygons)} faces with less than three corners")
    if folded:
        say(f"{folded} of {len(polygons)} faces are polygons that no fan of triangles fills; they overlap themselves")
    return np.concatenate(made)[np.argsort(np.concatenate(order), kind="stable")]


def _best_fan(vertices: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, int]:
    """Polygons `(n, k)`, each turned so that its fan from the first corner does not fold; and how many do fold."""
    rows, pending = rows.copy(), np.arange(len(rows))
    for turn in range(min(rows.shape[1], _TRIES)):
        turned = np.roll(rows[pending], -turn, 1)
        arms = vertices[turned[:, 1:]] - vertices[turned[:, :1]]
        with np.errstate(all="ignore"):  # of vertices that are not finite, which are refused later
            areas = np.cross(arms[:, :-1], arms[:, 1:])
            flat = ((areas * areas.sum(1, keepdims=True)).sum(-1) >= 0).all(1)
        rows[pending[flat]] = turned[flat]
        pending = pending[~flat]
        if not len(pending):
            break
    return rows, len(pending)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors `(n, 3)` with length 1; 0 for one that has no direction: 0, or not finite."""
    finite = np.where(np.isfinite(vectors).all(1, keepdims=True), vectors, 0.0)
    shrunk = finite / np.maximum(abs(finite).max(1, keepdims=True), np.finfo(float).tiny)  # squares would not fit
    return shrunk / np.maximum(np.linalg.norm(shrunk, axis=1, keepdims=True), np.finfo(float).tiny)
