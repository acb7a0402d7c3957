"""STL, and glTF with its scene of nodes, as trimesh reads them; each mesh of each node is a Part in its place."""

import io
import json
import struct
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.reading import check_unpacked, read_bytes
from torchbrdf.render.raster.mesh_formats.part import Part, Say, check_count, check_indices, unit

# Extensions of glTF that change no triangle, or are read (KHR_mesh_quantization); compressed geometry would be read as
# zeros, and instances left out.
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "EXT_lights_", "KHR_mesh_quantization",
             "KHR_xmp", "EXT_mesh_features", "EXT_structural_metadata", "FB_ngon_encoding")  # fmt: skip
_BYTES_OF = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
# What stands for 1 where whole numbers are normalised.
_ONE_OF = {5120: 2**7 - 1, 5121: 2**8 - 1, 5122: 2**15 - 1, 5123: 2**16 - 1, 5125: 2**32 - 1}
# Points, lines, triangles, strips: the primitives that trimesh makes a geometry of.
_MODES = (0, 1, 4, 5)
_ITEMS_OF = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Of a scene; trimesh takes some seconds for so many.
_MOST_NODES = 10_000
_GLTF = (".glb", ".gltf")


def read(path: Path, data: bytes, say: Say) -> list[Part]:
    """A Part for each mesh of each node."""
    import trimesh  # late, because it takes longer to import than the rest of this package

    kind = path.suffix.lower()
    head = _gltf_json(data) if kind in _GLTF else {}
    _check_gltf(path, head)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # numpy's, of text that is no number
        scene: Any = trimesh.load_scene(
            io.BytesIO(data), file_type=kind[1:], resolver=_Beside(path), process=False, skip_materials=True
        )
    # One geometry of each primitive that is drawn, in their order.
    drawn = [primitive for primitive in _primitives(head) if primitive.get("mode", 4) in _MODES]
    primitives = dict(zip(scene.geometry, drawn, strict=True)) if kind in _GLTF else {}
    parts, others, count = [], 0, 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            count += len(mesh.faces)
            check_count(path, count)  # of each node that shows it: a small file may say the same mesh often
            primitive = primitives.get(name, {})
            vertices = _floats(mesh.vertices, head, primitive, "POSITION")
            given = "vertex_normals" in mesh._cache
            normals = _floats(mesh.vertex_normals, head, primitive, "NORMAL") if given else None
            parts.append(_placed(path, vertices, mesh.faces, normals, transform))
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


def _check_gltf(path: Path, head: dict[str, Any]) -> None:
    """Refuse what would be read wrong, or become larger than it may, by what the JSON says."""
    _check_extensions(path, head)
    _check_nodes(path, head)
    size = 0
    for one in head.get("accessors", []):
        count, width = one.get("count", 0), _BYTES_OF.get(one.get("componentType"), 8)
        if not isinstance(count, int) or count < 0:
            raise DataError(f"{path}: expected accessors with a count, found {shown(count)}")
        size += count * width * _ITEMS_OF.get(one.get("type"), 16)
    check_unpacked(path, size)
    for primitive in _primitives(head):
        if primitive.get("mode", 4) == 6:
            raise DataError(f"{path}: expected triangles or strips, found primitives that are fans")
        attributes = primitive["attributes"]
        used = [attributes.get("POSITION"), attributes.get("NORMAL"), primitive.get("indices")]
        if any("sparse" in head["accessors"][k] for k in used if k is not None):
            raise DataError(f"{path}: expected accessors that say all their values, found sparse ones")
    if any(any(one.get("weights", [])) for key in ("meshes", "nodes") for one in head.get(key, [])):
        raise DataError(f"{path}: expected meshes as they are drawn, found morph targets with weights")


def _check_extensions(path: Path, head: dict[str, Any]) -> None:
    """Refuse extensions that are required, or sit where they may change triangles, unless they are `_HARMLESS`.

    Those of materials, textures, lights, cameras and the whole file are passed over.
    """
    places = [one for key in ("nodes", "meshes", "accessors", "bufferViews") for one in head.get(key, [])]
    found = {str(name) for one in [*places, *_primitives(head)] for name in one.get("extensions", {})}
    found |= {str(name) for name in head.get("extensionsRequired", [])}
    unknown = sorted(name for name in found if not name.startswith(_HARMLESS))
    if unknown:
        raise DataError(
            f"{path}: expected glTF without {shown(unknown)}; export it without compression, instances and the like"
        )


def _check_nodes(path: Path, head: dict[str, Any]) -> None:
    """Refuse too many nodes, and what trimesh would leave out: all but one place of a node, and meshes of cameras."""
    nodes = head.get("nodes", [])
    if len(nodes) > _MOST_NODES:
        raise DataError(f"{path}: expected at most {_MOST_NODES} nodes, found {len(nodes)}")
    try:
        TopologicalSorter({k: node.get("children", []) for k, node in enumerate(nodes)}).prepare()
    except CycleError as error:
        raise DataError(
            f"{path}: expected a tree of nodes, found nodes that contain themselves: {shown(error.args[1])}"
        ) from None
    places = Counter(child for node in nodes for child in node.get("children", []))
    places.update(head["scenes"][head.get("scene", 0)].get("nodes", []) if "scenes" in head else [])
    often = [k for k, count in places.items() if count > 1]
    if often:
        raise DataError(f"{path}: expected a tree of nodes, found nodes in several places: {shown(often)}")
    if any("camera" in node and "mesh" in node for node in nodes):
        raise DataError(f"{path}: expected cameras in nodes of their own, found one in a node with a mesh")


def _primitives(head: dict[str, Any]) -> list[dict[str, Any]]:
    return [primitive for mesh in head.get("meshes", []) for primitive in mesh["primitives"]]


def _floats(values: Any, head: dict[str, Any], primitive: dict[str, Any], attribute: str) -> Any:
    """What values stand for: trimesh gives normalised integers as they are in the file."""
    index = primitive.get("attributes", {}).get(attribute)
    accessor = {} if index is None else head["accessors"][index]
    if not accessor.get("normalized") or accessor["componentType"] not in _ONE_OF:
        return values
    return np.maximum(values / _ONE_OF[accessor["componentType"]], -1)


def _gltf_json(data: bytes) -> dict[str, Any]:
    if data[:4] == b"glTF":
        (length,) = struct.unpack("<I", data[12:16])
        data = data[20 : 20 + length]
    found = json.loads(data)
    if not isinstance(found, dict):
        raise ValueError(f"JSON that is a {type(found).__name__}")
    return found
