"""glTF files: what of them is read, and what is refused rather than read wrong."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.mesh_files import area, write

from torchbrdf.errors import DataError
from torchbrdf.render import Mesh
from torchbrdf.render.raster.mesh_formats import part


def gltf(**changes: object) -> bytes:
    """A triangle, in a glTF file with its buffer beside it."""
    found = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "b.bin", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    return json.dumps(found | changes).encode()


VIEW = {"buffer": 0, "byteLength": 36}
FLOATS = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
CORNERS_ONLY = {"attributes": {"POSITION": 0}}
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()


def test_a_gltf_file_has_its_buffer_beside_it(tmp_path: Path) -> None:
    (tmp_path / "b.bin").write_bytes(TRIANGLE)
    assert area(Mesh.load(write(tmp_path / "x.gltf", gltf()))) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"buffers": [{"uri": "../b.bin", "byteLength": 36}]}, "buffers in its folder"),
        ({"buffers": [{"uri": "/dev/zero", "byteLength": 36}]}, "buffers in its folder"),
        ({"buffers": [{"uri": "none.bin", "byteLength": 36}]}, "no such file"),
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "export it without compression"),
        ({"accessors": [{"componentType": 5126, "count": 10**12, "type": "VEC3"}]}, "bytes unpacked"),
        ({"accessors": [{"componentType": 5126, "count": -1, "type": "VEC3"}]}, "accessors with a count"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 6}]}]}, "fans"),
        ({"nodes": [{"mesh": 0, "scale": [1, 1, 1e400]}]}, "expected"),
        ({"accessors": [FLOATS | {"sparse": {"count": 1}}]}, "found sparse ones"),
        ({"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]}, "EXT_mesh_gpu_instancing"),
        ({"accessors": [FLOATS | {"extensions": {"EXT_other": {}}}]}, "EXT_other"),
        ({"bufferViews": [VIEW | {"extensions": {"EXT_meshopt_compression": {}}}]}, "EXT_meshopt_compression"),
        ({"meshes": [{"primitives": [CORNERS_ONLY], "extensions": {"EXT_other": {}}}]}, "EXT_other"),
        ({"meshes": [{"primitives": [CORNERS_ONLY | {"extensions": {"EXT_other": {}}}]}]}, "EXT_other"),
        ({"meshes": [{"primitives": [CORNERS_ONLY], "weights": [0, 0.5]}]}, "morph targets with weights"),
        ({"nodes": [{"mesh": 0, "children": [1]}, {"children": [0]}]}, "nodes that contain themselves"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, "nodes that contain themselves"),
        ({"nodes": [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]}, r"nodes in several places: \[2\]"),
        ({"scenes": [{"nodes": [0, 0]}]}, "nodes in several places"),
        ({"nodes": [{"mesh": 0, "camera": 0}]}, "cameras in nodes of their own"),
    ],
)
def test_gltf_that_refers_elsewhere_or_would_be_read_wrong_is_refused(
    tmp_path: Path, changes: dict[str, object], said: str
) -> None:
    (tmp_path / "b.bin").write_bytes(TRIANGLE)
    with pytest.raises(DataError, match=said):
        Mesh.load(write(tmp_path / "x.gltf", gltf(**changes)))


def test_extensions_that_change_no_triangle_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "b.bin").write_bytes(TRIANGLE)
    odd = {"extensions": {"EXT_other": {}}}
    lit = {"extensions": {"KHR_lights_punctual": {"light": 0}}}
    variants = {"extensions": {"KHR_materials_variants": {}}}
    data = gltf(
        extensionsUsed=["EXT_other", "KHR_lights_punctual", "KHR_materials_variants"],
        nodes=[{"mesh": 0} | lit],
        meshes=[{"primitives": [CORNERS_ONLY | variants]}],
        **{key: [odd] for key in ("materials", "textures", "samplers", "cameras", "animations")},
        **odd,
    )
    assert area(Mesh.load(write(tmp_path / "x.gltf", data))) == pytest.approx(0.5)


@pytest.mark.parametrize(("kind", "code"), [("i1", 5120), ("u1", 5121), ("<i2", 5122), ("<u2", 5123)])
@pytest.mark.parametrize("normalized", [True, False])
def test_positions_of_whole_numbers_are_what_they_stand_for(
    tmp_path: Path, kind: str, code: int, normalized: bool
) -> None:
    """Each primitive by its own accessor, also after some that are no triangles; the smallest number is -1 as well."""
    limits = np.iinfo(kind)
    numbers = np.zeros((3, 4), kind)  # rows padded to 4 bytes, or 8
    numbers[1:3, :2] = [[limits.max, 0], [0, limits.max]]
    numbers[:, 2] = limits.min, limits.max // 2, limits.max // 3  # unlike the other triangles
    (tmp_path / "b.bin").write_bytes(TRIANGLE + numbers.tobytes())
    whole = {"bufferView": 1, "componentType": code, "count": 3, "type": "VEC3", "normalized": normalized}
    rows = {"buffer": 0, "byteOffset": 36, "byteLength": numbers.nbytes, "byteStride": numbers.itemsize * 4}
    modes = [CORNERS_ONLY | {"mode": mode} for mode in (0, 1, 2, 3, 4)]
    data = gltf(
        buffers=[{"uri": "b.bin", "byteLength": 36 + numbers.nbytes}],
        bufferViews=[VIEW, rows],
        accessors=[FLOATS, whole],
        meshes=[{"primitives": [*modes, {"attributes": {"POSITION": 1}}]}, {"primitives": [CORNERS_ONLY]}],
        extensionsUsed=["KHR_mesh_quantization"],
        extensionsRequired=["KHR_mesh_quantization"],
        nodes=[{"mesh": 0, "children": [1]}, {"mesh": 1, "translation": [0, 5, 0]}],
    )
    mesh = Mesh.load(write(tmp_path / "x.gltf", data))
    one = limits.max if normalized else 1
    expected = np.maximum(numbers[:, :3].astype(float) / one, -1 if normalized else -np.inf)
    triangle = np.frombuffer(TRIANGLE, "<f4").reshape(3, 3)
    corners = mesh.vertices[mesh.faces]
    assert len(corners) == 3
    for wanted in (expected, triangle, triangle + np.array([0, 5, 0])):
        assert any(np.allclose(found, wanted) for found in corners)


def test_normals_of_bytes_are_what_they_stand_for(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Without a word: they are of length 1."""
    normal = np.array([0.6, 0, 0.8])
    numbers = np.zeros((3, 4), "i1")
    numbers[:, :3] = np.round(normal * 127)
    (tmp_path / "b.bin").write_bytes(TRIANGLE + numbers.tobytes())
    data = gltf(
        buffers=[{"uri": "b.bin", "byteLength": 48}],
        bufferViews=[VIEW, {"buffer": 0, "byteOffset": 36, "byteLength": 12, "byteStride": 4}],
        accessors=[FLOATS, FLOATS | {"bufferView": 1, "componentType": 5120, "normalized": True}],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}],
    )
    mesh = Mesh.load(write(tmp_path / "x.gltf", data))
    np.testing.assert_allclose(mesh.normals, np.tile(normal, (3, 1)), atol=0.01)
    assert not caplog.messages


def test_a_mesh_that_is_said_often_counts_as_often(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "b.bin").write_bytes(TRIANGLE)
    nodes = [{"mesh": 0}] * 40
    path = write(tmp_path / "x.gltf", gltf(nodes=nodes, scenes=[{"nodes": [*range(40)]}]))
    assert len(Mesh.load(path).faces) == 40
    monkeypatch.setattr(part, "MOST_FACES", 30)
    with pytest.raises(DataError, match="at most 30 triangles, found 31 or more"):
        Mesh.load(path)
    many = gltf(nodes=[{"mesh": 0}] * 10_001)
    with pytest.raises(DataError, match="at most 10000 nodes, found 10001"):
        Mesh.load(write(tmp_path / "many.gltf", many))
