"""Matrices of real numbers from MAT files of level 5. Damaged ones end scipy's reader, and Python, by a segfault."""

import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError
from torchbrdf.reading import largest, read_bytes, reading

EXPECTED = "a MAT file of level 5 (MATLAB 5 to 7)"
_HEADER = 128
# Numbers of types of data, and of classes of matrices: those of real numbers, and what they are stored as.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED, _FLAGS, _DIMENSIONS, _NAME = 14, 15, 6, 5, 1
_REAL_CLASSES = range(6, 16)
_COMPLEX = 0x0800


def read_matrices(path: Path | str, names: Collection[str]) -> dict[str, np.ndarray]:
    """Read some matrices of real numbers from a MAT file; what else it holds is passed over.

    Args:
        path: The file, as MATLAB's `save` writes it up to -v7, or `scipy.io.savemat`.
        names: Of the matrices; those that are not there are left out.

    Returns:
        `(rows, columns)` float64 by name.

    Raises:
        DataError: It is no such file, or damaged.

    Source: MathWorks, MAT-File Format, the chapter on level 5.
    """
    data = read_bytes(path, EXPECTED)
    with reading(path, EXPECTED):
        order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER])
        if order is None or data[:4] == bytes(4):
            raise DataError(f"{path}: expected {EXPECTED}, found another header")
        found = {}
        for kind, part in _elements(data[_HEADER:], order):
            if kind == _COMPRESSED:
                ((kind, part),) = _elements(_unpacked(part), order)
            if kind == _MATRIX:
                name, matrix = _matrix(part, order, names)
                if matrix is not None:
                    found[name] = matrix
    return found


def _unpacked(data: bytes) -> bytes:
    unpacking = zlib.decompressobj()
    found = unpacking.decompress(data, largest())
    if not unpacking.eof:
        raise ValueError("compressed data that is cut short, or larger than TORCHBRDF_MAX_BYTES")
    return found


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """The elements of some data: what kind, and their bytes."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # a small one: its size and four bytes stand in the tag
            kind, size, start, behind = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        else:
            start = at + 8
            behind = start + size + (0 if kind == _COMPRESSED else -size % 8)
        if size > (4 if start == at + 4 else len(data) - start):
            raise ValueError(f"an element of {size} bytes with fewer behind it")
        yield kind, data[start : start + size]
        at = behind


def _matrix(data: bytes, order: str, names: Collection[str]) -> tuple[str, np.ndarray | None]:
    """A matrix and its name; None for one that is not wanted."""
    parts = _elements(data, order)
    flags = struct.unpack(f"{order}II", _expected(parts, _FLAGS))[0]
    rows_columns = np.frombuffer(_expected(parts, _DIMENSIONS), f"{order}i4")
    name = _expected(parts, _NAME).decode("latin-1")
    if name not in names:
        return name, None
    if flags & 0xFF not in _REAL_CLASSES or flags & _COMPLEX or len(rows_columns) != 2:
        raise ValueError(f"{name} that is no matrix of real numbers")
    kind, numbers = next(parts, (0, b""))
    if kind not in _TYPES:
        raise ValueError(f"{name} with numbers of type {kind}")
    values = np.frombuffer(numbers, order + _TYPES[kind]).astype(np.float64)
    rows, columns = map(int, rows_columns)
    if min(rows, columns) < 0 or rows * columns != len(values):
        raise ValueError(f"{name} of {rows} x {columns} with {len(values)} numbers")
    return name, values.reshape(columns, rows).T.copy()


def _expected(parts: Iterator[tuple[int, bytes]], kind: int) -> bytes:
    found, data = next(parts, (0, b""))
    if found != kind:
        raise ValueError(f"an element of type {found} in the place of type {kind}")
    return data
