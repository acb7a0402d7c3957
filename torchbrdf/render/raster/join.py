"""The parts of a mesh file as one mesh: what nothing refers to is dropped, what lacks normals gets them."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchbrdf.errors import DataError
from torchbrdf.render.raster.mesh_formats.part import Part, Say, check_count, check_indices, unit

# How large a mesh may be, and how far from the origin in units of that, so that float32 tells its points apart.
SMALLEST, LARGEST, FARTHEST = 1e-9, 1e9, 1e4
# A normal in a file that is this much longer or shorter than 1 is said to be none of unit length.
_UNIT = 0.01
# A mean of unit normals that is no longer than this is a matter of rounding.
_CANCELLED = 1e-6
# Vertices nearer than 10^-8 of the radius are at one place.
_DIGITS = 8

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]


class Joined(NamedTuple):
    """A mesh's arrays. tangents: the file's, else where u of texture coordinates grows, 0 where neither is; or None.

    They are unit vectors in the surface, as normals are across it.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray | None


def join(path: Path, parts: Sequence[Part], say: Say) -> Joined:
    """Vertices, faces, unit normals and tangents of all parts.

    Normals of the file are kept, normalised. A vertex without one gets the mean of the triangles around its place, by
    their angles there, or that of one of its triangles where they cancel.

    Raises:
        DataError: There is no triangle with an area, or a vertex of one is not finite, or the mesh is too large, too
            far away, or has too many triangles.
    """
    vertices, faces, given = _concatenated(path, parts, say)
    center, radius = _extent(path, vertices[np.unique(faces)])
    with np.errstate(all="ignore"):  # of stray vertices
        scaled = (vertices - center) / radius
    corners = scaled[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = unit(across)
    with_area: np.ndarray = (across != 0).any(1)
    if not with_area.any():
        raise DataError(f"{path}: expected triangles, found that all {len(faces)} faces have no area")
    if not with_area.all():
        say(f"dropped {(~with_area).sum()} of {len(with_area)} triangles without area")
        faces, corners, flat = faces[with_area], corners[with_area], flat[with_area]
        across = across[with_area]
    along = along_u(corners, _coordinates(parts)[faces]) if any(one.coordinates is not None for one in parts) else None
    own = _tangents(parts) if any(one.tangents is not None for one in parts) else None
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    if len(used) < len(vertices):
        say(f"dropped {len(vertices) - len(used)} of {len(vertices)} vertices that no triangle refers to")
    vertices, scaled, given = vertices[used], scaled[used], given[used]

    first, place = _places(scaled)
    welded = place[faces]
    if _inside_out(scaled[first], welded):
        say(f"closed and inside out; turned its {len(faces)} triangles")
        faces, welded, corners = faces[:, ::-1], welded[:, ::-1], corners[:, ::-1]
        across, flat = -across, -flat
        if np.nansum(across * np.nan_to_num(given)[faces].sum(1)) < 0:
            given = -given
    lacking = np.isnan(given[:, 0])
    if lacking.any():
        from trimesh.triangles import angles  # late, because it takes longer to import than the rest of this package

        given[lacking] = _means(len(first), welded, flat, angles(corners))[place][lacking]
    of_a_face = np.zeros_like(given)
    of_a_face[faces] = flat[:, None]
    without = ~given.any(1)
    if without.any():
        say(f"{without.sum()} of {len(given)} vertices have no normal; each took that of one of its faces")
        given[without] = of_a_face[without]
    # Vertices at one place whose normals are means are one.
    one = np.where(lacking & ~without, place, len(first) + np.arange(len(given)))
    _, kept, index = np.unique(one, return_index=True, return_inverse=True)
    order = np.argsort(kept)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    kept = kept[order]
    faces, normals = np.ascontiguousarray(rank[index][faces]), given[kept]
    tangents = None if along is None or not along.any() else _in_the_surface(along, faces, normals)
    if own is not None:
        own = _at_right_angles(np.nan_to_num(own[used][kept]), normals)
        tangents = own if tangents is None else np.where(own.any(1, keepdims=True), own, tangents)
        tangents = tangents if tangents.any() else None
    return Joined(vertices[kept], faces, normals, tangents)


def along_u(corners: np.ndarray, coordinates: np.ndarray) -> np.ndarray:
    """Of each triangle where u grows along it, as long as twice its area, `(F, 3)`; 0 where no u does.

    corners: `(F, 3, 3)`; coordinates: `(F, 3, 2)`, NaN where there are none.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    with np.errstate(all="ignore"):
        (u1, v1), (u2, v2) = ((coordinates[:, k] - coordinates[:, 0]).T for k in (1, 2))
        way = np.sign(u1 * v2 - u2 * v1)[:, None] * unit(first * v2[:, None] - second * v1[:, None])
    area = np.linalg.norm(np.cross(first, second), axis=1, keepdims=True)
    return np.nan_to_num(way) * area


def _coordinates(parts: Sequence[Part]) -> np.ndarray:
    """Texture coordinates of all parts, NaN where there are none."""
    none = (np.full((len(one.vertices), 2), np.nan) for one in parts)
    return np.concatenate(
        [lack if one.coordinates is None else one.coordinates for one, lack in zip(parts, none, strict=True)]
    )


def _in_the_surface(along: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Vectors of triangles as unit ones of their vertices, at right angles to the normals; 0 where they cancel."""
    sums = [np.bincount(faces.T.ravel(), np.tile(along[:, k], 3), len(normals)) for k in range(3)]
    return _at_right_angles(np.stack(sums, 1), normals)


def _at_right_angles(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The parts of vectors that lie in the surface, of length 1; 0 where there are none."""
    return unit(vectors - (vectors * normals).sum(1, keepdims=True) * normals)


def _tangents(parts: Sequence[Part]) -> np.ndarray:
    """Tangents of all parts, 0 where there are none."""
    return np.concatenate([np.zeros_like(one.vertices) if one.tangents is None else one.tangents for one in parts])


def _concatenated(path: Path, parts: Sequence[Part], say: Say) -> Arrays:
    """All parts in one, with unit normals where the file has them, and NaN elsewhere."""
    count = sum(len(part.faces) for part in parts)
    if not count:
        raise DataError(f"{path}: expected a mesh of triangles, found no faces")
    check_count(path, count)
    faces, normals, first, odd, without, named = [], [], 0, 0, 0, 0
    for part in parts:
        check_indices(path, part.faces, len(part.vertices))
        faces.append(part.faces + first)
        first += len(part.vertices)
        if part.normals is None:
            normals.append(np.full(part.vertices.shape, np.nan))
            continue
        used = np.unique(part.faces)
        with np.errstate(over="ignore"):
            length = np.linalg.norm(part.normals, axis=1)
        own = unit(part.normals)
        own[~own.any(1)] = np.nan
        normals.append(own)
        there = ~np.isnan(own[:, 0])
        without += int((~there)[used].sum())
        odd += int((there & ~(abs(length - 1) <= _UNIT))[used].sum())
        named += len(used)
    if without:
        say(f"{without} of {named} vertices have no normal in the file; each got the mean of the triangles around it")
    if odd:
        say(f"{odd} of {named} normals in the file were not of length 1; normalised")
    return np.concatenate([part.vertices for part in parts]), np.concatenate(faces), np.concatenate(normals)


def _extent(path: Path, vertices: np.ndarray) -> tuple[np.ndarray, float]:
    """The middle of the vertices, and how far they reach from there; a DataError where that is no number to draw."""
    if not np.isfinite(vertices).all():
        wrong = int((~np.isfinite(vertices)).any(1).sum())
        raise DataError(f"{path}: expected finite vertices, found {wrong} of {len(vertices)} that are not finite")
    with np.errstate(over="ignore"):
        center = vertices.min(0) / 2 + vertices.max(0) / 2
        radius = float(abs(vertices - center).max())
    if radius == 0:
        raise DataError(f"{path}: expected triangles with an area, found all vertices in one place")
    if not SMALLEST <= radius <= LARGEST:
        raise DataError(f"{path}: expected a mesh of {SMALLEST:g} to {LARGEST:g} units, found {radius:.3g}")
    if abs(center).max() > FARTHEST * radius:
        raise DataError(
            f"{path}: expected a mesh nearer to the origin than {FARTHEST:g} times its size {radius:.3g}, "
            f"found its middle at {', '.join(f'{x:.6g}' for x in center)}; move it there"
        )
    return center, radius


def _places(scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first vertex at each place, and the place of each vertex."""
    cells = np.round(scaled * 10**_DIGITS).astype(np.int64)
    keys = cells.view(np.dtype((np.void, cells.itemsize * 3)))[:, 0]  # compared as a whole, which is quicker
    _, first, place = np.unique(keys, return_index=True, return_inverse=True)
    return first, place


def _inside_out(places: np.ndarray, faces: np.ndarray) -> bool:
    """Whether triangles close a surface and go round the wrong way."""
    a, b, c = places[faces].transpose(1, 0, 2)
    volume = (a * np.cross(b, c)).sum() / 6  # of the pyramids below each triangle
    if volume >= 0:
        return False
    import trimesh

    return bool(trimesh.Trimesh(places, faces, process=False).is_watertight)


def _means(count: int, faces: np.ndarray, flat: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """The mean of the faces around each of `count` places, weighted by their angles there, or 0 where they cancel.

    Source: G. Thuermer and C. A. Wuethrich, Computing Vertex Normals from Polygonal Facets, Journal of Graphics Tools
    3(1), 1998, doi:10.1080/10867651.1998.10487487.
    """
    corners, weights = faces.T.ravel(), angles.T.ravel()
    total = np.bincount(corners, weights, count)
    summed = [np.bincount(corners, weights * np.tile(flat[:, k], 3), count) for k in range(3)]
    mean = np.stack(summed, 1) / np.maximum(total, np.finfo(float).tiny)[:, None]
    return unit(np.where(np.linalg.norm(mean, axis=1, keepdims=True) > _CANCELLED, mean, 0))
