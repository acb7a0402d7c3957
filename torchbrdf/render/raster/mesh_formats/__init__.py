"""Readers of mesh files, by suffix: what each gives is Parts, which `raster.join` makes one mesh of."""

from collections.abc import Callable
from pathlib import Path

from torchbrdf.errors import DataError, shown
from torchbrdf.reading import read_bytes, reading
from torchbrdf.render.raster.mesh_formats import obj, off, ply, scene
from torchbrdf.render.raster.mesh_formats.part import Part, Say

READERS: dict[str, Callable[[Path, bytes, Say], list[Part]]] = {
    ".glb": scene.read,
    ".gltf": scene.read,
    ".obj": obj.read,
    ".off": off.read,
    ".ply": ply.read,
    ".stl": scene.read,
}


def read_parts(path: Path, say: Say) -> list[Part]:
    """The parts of a mesh file. A DataError if it is none of `READERS`, or cannot be read."""
    kinds = ", ".join(READERS)
    if path.suffix.lower() not in READERS:
        raise DataError(f"{path}: expected a mesh ({kinds}), found a name that ends in {shown(path.suffix)}")
    data = read_bytes(path, f"a mesh ({kinds})")
    with reading(path, "a readable mesh"):
        return READERS[path.suffix.lower()](path, data, say)
