"""Object File Format (OFF): a head of counts, vertices, polygons. COFF adds colours, NOFF normals."""

from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.render.raster.mesh_formats.part import Part, Say, triangulate

_HEADS = (b"OFF", b"COFF", b"NOFF", b"CNOFF")


def read(path: Path, data: bytes, say: Say) -> list[Part]:
    """One Part."""
    lines = [words for line in data.splitlines() if (words := line.partition(b"#")[0].split())]
    head = lines[0][0] if lines else b""
    if head not in _HEADS:
        raise DataError(f"{path}: expected OFF, COFF or NOFF in the first line, found {shown(_text(head))}")
    body = [lines[0][1:], *lines[1:]] if len(lines[0]) > 1 else lines[1:]  # the counts may follow on the same line
    counts = _numbers(path, body[0] if body else [], int)
    if len(counts) < 2 or min(counts[:2]) < 0:
        raise DataError(f"{path}: expected how many vertices and faces there are, found {shown(counts)}")
    vertex_count, face_count = counts[:2]
    if len(body) < 1 + vertex_count + face_count:
        raise DataError(
            f"{path}: expected {vertex_count} vertices and {face_count} faces, found {len(body) - 1} lines of them"
        )
    width = 6 if b"N" in head else 3
    rows = [_numbers(path, line[:width], float) for line in body[1 : 1 + vertex_count]]
    if any(len(row) < width for row in rows):
        raise DataError(f"{path}: expected {width} numbers a vertex, found a line of less")
    table = np.array(rows, np.float64).reshape(-1, width)
    polygons = []
    for line in body[1 + vertex_count : 1 + vertex_count + face_count]:
        length = _numbers(path, line[:1], int)[0]
        corners = _numbers(path, line[1 : 1 + max(length, 0)], int)
        if len(corners) != length:
            raise DataError(f"{path}: expected a face of {length} corners, found {len(corners)} in its line")
        polygons.append(corners)
    faces = triangulate(path, table[:, :3], polygons, say)
    return [Part(table[:, :3], faces, table[:, 3:] if width == 6 else None)]


def _numbers(path: Path, words: list[bytes], kind: type[Any]) -> list[Any]:
    try:
        found = [kind(word) for word in words]
        return [one if kind is float or abs(one) < 2**62 else -1 for one in found]
    except ValueError:
        raise DataError(f"{path}: expected numbers, found {shown(_text(b' '.join(words)))}") from None


def _text(line: bytes) -> str:
    return line.decode("utf-8", "replace")
