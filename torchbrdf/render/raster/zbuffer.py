"""Which triangle each pixel shows: a z-buffer in numpy.

Triangles are cut into spans, a row's part of a triangle, by walking down their edges; closeness (1 / depth) is taken
along from the corners to the spans' ends and from there to the pixels, so that it stays between the corners' also
where a triangle is next to edge on.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

# Faces, spans and pixels in spans that are looked at in one go: they stay in a processor's cache, and bound the memory.
_FACES, _SPANS, _PIXELS = 1 << 16, 1 << 14, 1 << 16
# A pixel centre this near to an edge, in pixels, is in both faces, so that none is lost between them.
_SLACK = 1e-7
# A span narrower than this, in pixels, has one closeness: _SLACK must not carry it beyond the corners'.
_NARROW = 1e-6


class _Halves(NamedTuple):
    """Triangles cut at the row of their middle corner: id and first row `(n,)`, rows `(n,)`, and the two edges.

    left, right: `(4, n)`; column and closeness in the first row, and how much each grows by in a row.
    """

    face: np.ndarray
    top: np.ndarray
    rows: np.ndarray
    left: np.ndarray
    right: np.ndarray


def nearest_triangles(points: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """The id of the nearest triangle at each pixel's centre, `(size, size)`, -1 where there is none.

    points: `(3, V)` as `Camera.project` gives them; faces: `(F, 3)`. Both sides of a triangle are seen, none that is
    edge on. Of equals the first is seen.
    """
    closest = np.zeros(size * size)
    triangle = np.full(size * size, -1, np.int64)
    for start in range(0, len(faces), _FACES):
        for face, pixel, near in _pixels(_halves(points, faces[start : start + _FACES], size), size):
            closer = np.flatnonzero(near > closest[pixel])
            face, pixel, near = face[closer], pixel[closer], near[closer]
            np.maximum.at(closest, pixel, near)
            shown = np.flatnonzero(near == closest[pixel])[::-1]  # of equals the first is written last
            triangle[pixel[shown]] = start + face[shown]
    return triangle.reshape(size, size)


def _halves(points: np.ndarray, faces: np.ndarray, size: int) -> _Halves:
    """The halves that may cover a pixel's centre, in the faces' order."""
    x, y, _ = corners = points[:, faces.T]  # (3, 3, F): column, row and closeness of the corners
    top, bottom = np.maximum(_least(y), 0), np.minimum(-_least(-y), size - 1)
    left, right = np.maximum(_least(x) - _SLACK, 0), np.minimum(_SLACK - _least(-x), size - 1)
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    used = np.flatnonzero((np.ceil(top) <= bottom) & (np.ceil(left) <= right) & (area != 0))
    order = np.argsort(y[:, used], axis=0, kind="stable")
    x, y, closeness = np.take_along_axis(corners[:, :, used], order[None], 1)
    first, middle, end = np.maximum(np.ceil(y[0]), 0), np.maximum(np.ceil(y[1]), 0), np.floor(y[2]) + 1
    end = np.minimum(end, size)

    def edge(start: int, stop: int, row: np.ndarray) -> np.ndarray:
        rise = y[stop] - y[start]
        rise = np.where(rise > 0, rise, 1)  # level edges end where they start, and are in no row but that
        ends = [(values[start], (values[stop] - values[start]) / rise) for values in (x, closeness)]
        return np.stack([part for value, step in ends for part in (value + (row - y[start]) * step, step)])

    halves = []
    for above, below, short in ((first, np.minimum(middle, end), (0, 1)), (middle, end, (1, 2))):
        rows = np.maximum(below - above, 0)
        long, other = edge(0, 2, above), edge(*short, above)
        beyond = ((long - other)[0] + (rows - 1) / 2 * (long - other)[1]) > 0  # in the middle of the half
        halves.append((rows, above, np.where(beyond, other, long), np.where(beyond, long, other)))
    # The two halves of a face one behind the other
    both = (np.stack(pair, -1) for pair in zip(*halves, strict=True))
    rows, above, left, right = (values.reshape(*values.shape[:-2], -1) for values in both)
    kept = np.flatnonzero(rows)
    face = np.repeat(used, 2)[kept]
    return _Halves(face, above[kept].astype(np.int64), rows[kept].astype(np.int64), left[:, kept], right[:, kept])


def _pixels(halves: _Halves, size: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Face, pixel (row by row) and closeness of every pixel centre in every half, in parts."""
    for part in _batches(halves.rows, _SPANS):
        half = np.repeat(part, halves.rows[part])
        step = _steps(halves.rows[part])
        left, left_by, near_left, near_left_by = halves.left[:, half]
        right, right_by, near_right, near_right_by = halves.right[:, half]
        left, right = left + step * left_by, right + step * right_by
        near_left, near_right = near_left + step * near_left_by, near_right + step * near_right_by
        first = np.maximum(np.ceil(left - _SLACK), 0)
        width = np.minimum(np.floor(right + _SLACK), size - 1) - first + 1
        slope = np.where(right - left > _NARROW, near_right - near_left, 0) / np.maximum(right - left, _NARROW)
        start = near_left + slope * (first - left)
        span = np.flatnonzero(width > 0)
        pixel = ((halves.top[half] + step) * size + first.astype(np.int64))[span]
        face, start, slope, width = halves.face[half[span]], start[span], slope[span], width[span].astype(np.int64)
        for some in _batches(width, _PIXELS):
            count = width[some]
            step = _steps(count)
            near = np.repeat(start[some], count) + np.repeat(slope[some], count) * step
            yield np.repeat(face[some], count), np.repeat(pixel[some], count) + step, near


def _least(values: np.ndarray) -> np.ndarray:
    """The least of three rows; min() along so short an axis is slow."""
    return np.minimum(np.minimum(values[0], values[1]), values[2])


def _steps(counts: np.ndarray) -> np.ndarray:
    """0, 1, ... count - 1 for every count, one behind the other; counts are not empty."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1]) - np.repeat(ends - counts, counts)


def _batches(counts: np.ndarray, most: int) -> Iterator[np.ndarray]:
    """Indices of the counts, which are above 0, in parts that add up to about `most`."""
    total = np.cumsum(counts)
    last = int(total[-1]) if len(total) else 0
    cuts = np.searchsorted(total, np.arange(most, last, most))
    return (part for part in np.split(np.arange(len(counts)), cuts) if len(part))
