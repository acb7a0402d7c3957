"""STL, and glTF with its scene of nodes, as trimesh reads them; each mesh of each node is a Part in its place."""

import io
import json
import struct
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.reading import check_unpacked, read_bytes
from torchbrdf.render.raster.mesh_formats.part import Part, Say, check_count, check_indices, unit

# What glTF may ask of a reader that changes no triangle; compressed geometry would be read as zeros.
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization", "KHR_xmp")
_BYTES_OF = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_ITEMS_OF = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Of a scene; trimesh takes some seconds for so many.
_MOST_NODES = 10_000
_GLTF = (".glb", ".gltf")


def read(path: Path, data: bytes, say: Say) -> list[Part]:
    """A Part for each mesh of each node."""
    import trimesh  # late, because it takes longer to import than the rest of this package

    kind = path.suffix.lower()
    if kind in _GLTF:
        _check_gltf(path, data)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # numpy's, of text that is no number
        scene: Any = trimesh.load_scene(
            io.BytesIO(data), file_type=kind[1:], resolver=_Beside(path), process=False, skip_materials=True
        )
    parts, others, count = [], 0, 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            count += len(mesh.faces)
            check_count(path, count)  # of each node that shows it: a small file may say the same mesh often
            given = "vertex_normals" in mesh._cache
            parts.append(_placed(path, mesh.vertices, mesh.faces, mesh.vertex_normals if given else None, transform))
        else:
            others += 1
    if others and parts:
        say(f"left out {others} of {others + len(parts)} parts without faces")
    return parts


def _placed(path: Path, vertices: Any, faces: Any, normals: Any, transform: Any) -> Part:
    """A part in its place. Normals go by the cofactors, which mirrored and flattened parts have as well."""
    vertices, faces = np.array(vertices, np.float64), np.array(faces).astype(np.int64)
    check_indices(path, faces, len(vertices))
    transform = np.asarray(transform, np.float64)
    if not np.isfinite(transform).all() or not np.array_equal(transform[3], [0, 0, 0, 1]):
        raise DataError(f"{path}: expected nodes with affine transforms, found {shown(transform.tolist())}")
    linear = transform[:3, :3]
    cofactors = np.stack([np.cross(linear[k - 2], linear[k - 1]) for k in range(3)])
    mirrored = np.linalg.det(linear) < 0
    if normals is not None:
        normals = np.array(normals, np.float64)
        turned = unit(normals @ (-cofactors if mirrored else cofactors).T)
        normals = turned * np.linalg.norm(normals, axis=1, keepdims=True)
    return Part(vertices @ linear.T + transform[:3, 3], faces[:, ::-1] if mirrored else faces, normals)


class _Beside(Mapping[str, bytes]):
    """What a glTF file refers to: regular files in its folder, and nothing else."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0

    def __getitem__(self, name: str) -> bytes:
        if Path(name).name != name:
            raise DataError(f"{self.path}: expected buffers in its folder, found {shown(name)}")
        return read_bytes(self.path.with_name(name), "a buffer of a mesh")


def _check_gltf(path: Path, data: bytes) -> None:
    """Refuse what would be read wrong, or become larger than it may, by what the JSON says."""
    head = _gltf_json(data)
    required = head.get("extensionsRequired", [])
    unknown = [name for name in required if not str(name).startswith(_HARMLESS)]
    if unknown:
        raise DataError(f"{path}: expected glTF without {shown(unknown)}; export it without compression")
    nodes = len(head.get("nodes", []))
    if nodes > _MOST_NODES:
        raise DataError(f"{path}: expected at most {_MOST_NODES} nodes, found {nodes}")
    size = 0
    for one in head.get("accessors", []):
        count, width = one.get("count", 0), _BYTES_OF.get(one.get("componentType"), 8)
        if not isinstance(count, int) or count < 0:
            raise DataError(f"{path}: expected accessors with a count, found {shown(count)}")
        size += count * width * _ITEMS_OF.get(one.get("type"), 16)
    check_unpacked(path, size)
    modes = {p.get("mode", 4) for mesh in head.get("meshes", []) for p in mesh.get("primitives", [])}
    if 6 in modes:
        raise DataError(f"{path}: expected triangles or strips, found primitives that are fans")


def _gltf_json(data: bytes) -> dict[str, Any]:
    if data[:4] == b"glTF":
        (length,) = struct.unpack("<I", data[12:16])
        data = data[20 : 20 + length]
    found = json.loads(data)
    if not isinstance(found, dict):
        raise ValueError(f"JSON that is a {type(found).__name__}")
    return found
