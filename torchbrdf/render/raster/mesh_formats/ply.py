"""Stanford PLY, as text or binary of either byte order: vertices with normals, and faces of any number of corners."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.render.raster.mesh_formats.part import Part, Say, triangulate

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8",
    "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# What the list of a face's corners is called.
_CORNERS = ("vertex_indices", "vertex_index")
# What texture coordinates are called.
_COORDINATES = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))

TANGENTS = ("tx", "ty", "tz")
"""What the properties of tangents are called, as those of normals are: nx, ny, nz."""


@dataclass(frozen=True)
class _Property:
    """A property of an element: its type, and that of the count in front if it is a list."""

    name: str
    type: np.dtype[Any]
    count: np.dtype[Any] | None = None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def corners(self) -> _Property | None:
        """The list of a face's corners."""
        lists = [one for one in self.properties if one.count is not None]
        return next((one for one in lists if one.name in _CORNERS), lists[0] if len(lists) == 1 else None)


def read(path: Path, data: bytes, say: Say) -> list[Part]:
    """One Part."""
    order, elements, body = _header(path, data)
    columns: dict[str, np.ndarray] = {}
    polygons: list[np.ndarray] | np.ndarray = []
    source = _Binary(path, body) if order else _Text(path, body)
    for element in elements:
        if any(one.count is not None for one in element.properties):
            found = source.lists(element)
            polygons = found if element.name == "face" else polygons
        else:
            table = source.columns(element)
            columns = table if element.name == "vertex" else columns
    if not len(polygons):
        return []
    vertices = _stack(path, columns, ("x", "y", "z"))
    normals = _stack(path, columns, ("nx", "ny", "nz")) if "nx" in columns else None
    names = next((names for names in _COORDINATES if all(name in columns for name in names)), ())
    coordinates = _stack(path, columns, names) if names else None
    tangents = _stack(path, columns, TANGENTS) if TANGENTS[0] in columns else None
    return [Part(vertices, triangulate(path, vertices, polygons, say), normals, coordinates, tangents)]


def _stack(path: Path, columns: dict[str, np.ndarray], names: Sequence[str]) -> np.ndarray:
    if not all(name in columns for name in names):
        raise DataError(f"{path}: expected vertices with {', '.join(names)}, found {shown(', '.join(columns))}")
    return np.stack([columns[name] for name in names], 1).astype(np.float64)


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], bytes]:
    """The byte order, "" for text; the elements; and what follows the header."""
    lines, at, ended = [], 0, False
    while not ended and at < len(data):
        end = data.find(b"\n", at)
        line = data[at : end if end >= 0 else len(data)].decode("latin-1").split()
        at = end + 1 if end >= 0 else len(data)
        ended = line == ["end_header"]
        lines.append(line)
    if not ended or lines[0] != ["ply"]:
        raise DataError(f"{path}: expected a PLY header, found {shown(data[:40].decode('latin-1'))}")
    order, elements = None, list[_Element]()
    for line in lines[1:-1]:
        try:
            match line:
                case ["format", kind, _]:
                    order = _ORDERS[kind]
                case ["element", name, count]:
                    elements.append(_Element(name, int(count)))
                    if not 0 <= elements[-1].count <= len(data):
                        raise ValueError
                case ["property", "list", count, kind, name] if _TYPES[count][0] != "f":
                    elements[-1].properties.append(
                        _Property(name, np.dtype((order or "") + _TYPES[kind]), np.dtype((order or "") + _TYPES[count]))
                    )
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, np.dtype((order or "") + _TYPES[kind])))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (ValueError, KeyError, IndexError):
            found = shown(" ".join(line))
            raise DataError(f"{path}: expected PLY header lines that fit the file, found {found}") from None
    if order is None:
        raise DataError(f"{path}: expected a format line in the PLY header, found none")
    return order, elements, data[at:]


class _Binary:
    """Elements one after another in binary data."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data, self.at = path, data, 0

    def columns(self, element: _Element) -> dict[str, np.ndarray]:
        """An element without lists: its columns."""
        names = [f"{k}" for k, _ in enumerate(element.properties)]  # of their own, as the file's may repeat
        table = self._table(np.dtype(list(zip(names, (one.type for one in element.properties), strict=True))), element)
        return {one.name: table[name] for name, one in zip(names, element.properties, strict=True)}

    def _table(self, dtype: np.dtype[Any], element: _Element) -> np.ndarray:
        size = element.count * dtype.itemsize
        if len(self.data) - self.at < size:
            raise DataError(f"{self.path}: expected {element.count} of element {element.name}, found the file's end")
        table = np.frombuffer(self.data, dtype, element.count, self.at) if size else np.zeros(element.count, dtype)
        self.at += size
        return table

    def lists(self, element: _Element) -> list[np.ndarray] | np.ndarray:
        """An element with lists: the corners of each."""
        if not element.count:
            return []
        alike = self._alike(element)
        return self._each(element) if alike is None else alike

    def _alike(self, element: _Element) -> list[np.ndarray] | np.ndarray | None:
        """All at once, if every row is as long as the first."""
        start, fields, counts = self.at, [], {}
        for k, one in enumerate(element.properties):
            if one.count is not None:
                counts[f"n{k}"] = self._count(one.count, self.at)
                self.at += one.count.itemsize
                fields.append((f"n{k}", one.count, (1,)))
            size = counts.get(f"n{k}", 1)
            fields.append((str(k), one.type, (size,)))
            self.at += size * one.type.itemsize
        self.at = start
        dtype = np.dtype(fields)
        if len(self.data) - start < element.count * dtype.itemsize:
            return None
        table = self._table(dtype, element)
        if not all((table[name] == count).all() for name, count in counts.items()):
            self.at = start
            return None
        own = [str(k) for k, one in enumerate(element.properties) if one is element.corners]
        return table[own[0]] if own else []

    def _each(self, element: _Element) -> list[np.ndarray]:
        """Row by row."""
        found = []
        for _ in range(element.count):
            for one in element.properties:
                size = 1
                if one.count is not None:
                    size = self._count(one.count, self.at)
                    self.at += one.count.itemsize
                end = self.at + size * one.type.itemsize
                if end > len(self.data):
                    raise DataError(f"{self.path}: expected {element.count} of element {element.name}, found the end")
                if one is element.corners:
                    found.append(np.frombuffer(self.data, one.type, size, self.at) if size else np.zeros(0, np.int64))
                self.at = end
        return found

    def _count(self, dtype: np.dtype[Any], at: int) -> int:
        if at + dtype.itemsize > len(self.data):
            raise DataError(f"{self.path}: expected the length of a list, found the file's end")
        count = int(np.frombuffer(self.data, dtype, 1, at)[0])
        if not 0 <= count <= len(self.data):
            raise DataError(f"{self.path}: expected the length of a list, found {count}")
        return count


class _Text:
    """Elements one after another in text, a line each."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        self.lines = (words for line in data.splitlines() if (words := line.split()))

    def columns(self, element: _Element) -> dict[str, np.ndarray]:
        """An element without lists: its columns."""
        rows = [[self._number(float, word) for word in line] for line in self._lines(element)]
        if any(len(row) != len(element.properties) for row in rows):
            raise DataError(f"{self.path}: expected {len(element.properties)} numbers a {element.name}, found others")
        table = np.array(rows, np.float64).reshape(element.count, len(element.properties))
        return {one.name: table[:, k] for k, one in enumerate(element.properties)}

    def lists(self, element: _Element) -> list[np.ndarray]:
        """An element with lists: the corners of each."""
        found = []
        for line in self._lines(element):
            at = 0
            for one in element.properties:
                size = 1
                if one.count is not None:
                    size = self._number(int, line[at]) if at < len(line) else -1
                    at += 1
                if size < 0 or at + size > len(line):
                    raise DataError(f"{self.path}: expected a whole {element.name}, found a line of {len(line)} words")
                if one is element.corners:
                    corners = [self._number(int, word) for word in line[at : at + size]]
                    found.append(np.array([k if abs(k) < 2**62 else -1 for k in corners], np.int64))
                at += size
        return found

    def _lines(self, element: _Element) -> Iterator[list[bytes]]:
        for k in range(element.count):
            line = next(self.lines, None)
            if line is None:
                raise DataError(f"{self.path}: expected {element.count} of element {element.name}, found {k}")
            yield line

    def _number(self, kind: type[Any], word: bytes) -> Any:
        try:
            return kind(word)
        except ValueError:
            found = shown(word.decode("latin-1"))
            raise DataError(f"{self.path}: expected numbers below the PLY header, found {found}") from None
