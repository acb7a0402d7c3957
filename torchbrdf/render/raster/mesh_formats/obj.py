"""Wavefront OBJ: vertices, normals, texture coordinates and faces; all else is not needed here."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.render.raster.mesh_formats.part import Part, Say, check_indices, triangulate

# Statements that change nothing about triangles and their normals.
_SILENT = frozenset(b"g o s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj vp".split())
# Statements that draw something that is no triangle.
_NOT_FACES = frozenset(b"p l curv curv2 surf cstype deg bmat step parm trim hole scrv sp end con ctech stech".split())


def read(path: Path, data: bytes, say: Say) -> list[Part]:
    """One Part: a vertex for each place, normal and texture coordinate that a corner names together.

    Indices may count from the end. Texture coordinates only say where the surface's tangent lies: bad ones are none.
    """
    reader = _Reader()
    for number, line in enumerate(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines(), 1):
        words = line.partition(b"#")[0].split()
        if words:
            try:
                reader.take(words, number)
            except (ValueError, OverflowError):
                raise DataError(f"{path}: line {number}: expected numbers of OBJ, found {shown(_text(line))}") from None
    return reader.parts(path, say)


def _text(line: bytes) -> str:
    return line.decode("utf-8", "replace")


class _Reader:
    """What the lines up to now have said."""

    def __init__(self) -> None:
        self.places: list[list[float]] = []
        self.directions: list[list[float]] = []
        self.coordinates: list[tuple[float, float]] = []
        self.polygons: list[list[int]] = []
        self.corners: dict[tuple[int, int, int], int] = {}
        self.known: dict[bytes, int] = {}
        self.others: Counter[str] = Counter()
        self.odd: list[int] = []

    def take(self, words: list[bytes], number: int) -> None:
        """Take the words of one line; a ValueError if they are not what its first word promises."""
        match words[0]:
            case b"v":
                self.places.append(_three(words))
            case b"vn":
                self.directions.append(_three(words))
            case b"vt":
                self.coordinates.append(_two(words))
            case b"f":
                known = self.known
                self.polygons.append([known[word] if word in known else self.corner(word) for word in words[1:]])
            case other if other in _NOT_FACES:
                self.others[_text(other)] += 1
            case other if other not in _SILENT:
                self.odd.append(number)

    def corner(self, word: bytes) -> int:
        """The number of a corner `place/texture/normal`."""
        parts = word.split(b"/")
        if len(parts) > 3:
            raise ValueError
        place = _index(parts[0], len(self.places))
        normal = _index(parts[2], len(self.directions)) if len(parts) == 3 and parts[2] else -1
        texture = _texture(parts[1], len(self.coordinates)) if len(parts) > 1 else -1
        found = self.corners.setdefault((place, normal, texture), len(self.corners))
        if b"-" not in word:  # what counts from the end means something else in another line
            self.known[word] = found
        return found

    def parts(self, path: Path, say: Say) -> list[Part]:
        """What the whole file holds."""
        odd = ""
        if self.odd:
            odd = f"{len(self.odd)} lines that are no OBJ statements, the first of them line {self.odd[0]}"
        if not self.polygons or not self.corners:
            raise DataError(f"{path}: expected a mesh of triangles, found no faces" + (f", but {odd}" if odd else ""))
        if odd:
            say(f"ignored {odd}")
        if self.others:
            say(f"left out {self.others.total()} statements that are no faces ({', '.join(sorted(self.others))})")
        place, normal, texture = np.array(list(self.corners), np.int64).T
        check_indices(path, place, len(self.places))
        check_indices(path, normal[normal >= 0], len(self.directions), "normal")
        stray = len(self.places) - len(np.unique(place))
        if stray:
            say(f"left out {stray} of {len(self.places)} vertices that no face names")
        vertices = np.array(self.places)[place]
        faces = triangulate(path, vertices, self.polygons, say)
        return [Part(vertices, faces, _named(self.directions, normal), _named(self.coordinates, texture))]


def _three(words: list[bytes]) -> list[float]:
    """The three numbers behind the first word; more of them are a weight or a colour."""
    _, x, y, z, *_ = words
    return [float(x), float(y), float(z)]


def _two(words: list[bytes]) -> tuple[float, float]:
    """The two numbers behind the first word, or of one both; NaN where they are none."""
    try:
        u, v, *_ = map(float, [*words[1:3], *words[2:3], b"0"])
    except ValueError:
        return math.nan, math.nan
    return u, v


def _texture(word: bytes, count: int) -> int:
    """As `_index`, but -1 of what names no texture coordinate."""
    try:
        found = _index(word, count)
    except ValueError:
        return -1
    return found if found < count else -1


def _named(values: Sequence[Sequence[float]], index: np.ndarray) -> np.ndarray | None:
    """The values of corners by index, NaN where that is -1; None if all are."""
    if not (index >= 0).any():
        return None
    return np.vstack([values, np.full((1, len(values[0])), np.nan)])[index]


def _index(word: bytes, count: int) -> int:
    """An index from 0, of one from 1, or of one from the end of what there is so far."""
    index = int(word)
    if index == 0 or index < -count or index > 2**62:
        raise ValueError
    return index - 1 if index > 0 else count + index
