"""Materials as glTF."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.gltf_validator import obstacle, report, said_of

from torchbrdf.errors import DataError, UsageError
from torchbrdf.export import export
from torchbrdf.export.gltf import GLTF, glb, gltf_material
from torchbrdf.export.shading import within
from torchbrdf.lobes import GGX, Lambert, Sum
from torchbrdf.lobes import GLTF as GLTF_LOBE
from torchbrdf.names import file_stem
from torchbrdf.pairs import Pairs
from torchbrdf.render import Mesh, blob, sphere

METAL = Sum(Lambert(albedo=0.0), GGX(specular=1.0, roughness=0.09, f0=0.6))
# Every factor away from its default.
EVERYTHING = {
    name: [0.25, 0.5, 0.75] if limits.size == 3 else max(0.5, limits.lower * 1.25)
    for name, limits in GLTF.limits.items()
}


def chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the buffer of a binary glTF file, by the specification's section 4.4."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and size % 4 == 0
    length, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0" and 28 + size + length == len(data)
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def read(tree: dict[str, Any], buffer: bytes, accessor: int, width: int) -> np.ndarray:
    """The numbers of an accessor."""
    entry = tree["accessors"][accessor]
    start = tree["bufferViews"][entry["bufferView"]].get("byteOffset", 0)
    dtype = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[entry["componentType"]]
    return np.frombuffer(buffer, dtype, entry["count"] * width, start).reshape(-1, width)


def test_a_file_holds_the_mesh_and_one_material(tmp_path: Path) -> None:
    done = export(METAL, "gltf", tmp_path, name="a <metal>", mesh="sphere")
    assert done.exact and done.notes == ["exact: glTF's metallic-roughness material"]
    assert [path.name for path in done.files] == [f"{file_stem('a <metal>')}.glb"]
    tree, buffer = chunks(done.files[0].read_bytes())
    assert [one["name"] for one in tree["materials"]] == ["a <metal>"]
    core = tree["materials"][0]["pbrMetallicRoughness"]
    assert core["baseColorFactor"] == pytest.approx([0.6, 0.6, 0.6, 1.0])
    assert core["metallicFactor"] == 1 and core["roughnessFactor"] == pytest.approx(0.3)  # alpha is its square
    ((part,),) = [mesh["primitives"] for mesh in tree["meshes"]]
    assert part["material"] == 0 and set(part["attributes"]) == {"POSITION", "NORMAL"}
    ball = sphere()
    for name, expected in (("POSITION", ball.vertices), ("NORMAL", ball.normals)):
        np.testing.assert_allclose(read(tree, buffer, part["attributes"][name], 3), expected, atol=1e-6)
    assert (read(tree, buffer, part["indices"], 1).reshape(-1, 3) == ball.faces).all()


def test_the_blob_is_worn_without_another_mesh(tmp_path: Path) -> None:
    done = export(METAL, "gltf", tmp_path)
    again, own = Mesh.load(done.files[0]), blob()
    np.testing.assert_allclose(again.vertices, own.vertices, atol=1e-6)
    np.testing.assert_allclose(again.normals, own.normals, atol=1e-5)


def test_a_mesh_of_a_file_needs_no_uvs(tmp_path: Path) -> None:
    (tmp_path / "flag.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    done = export(METAL, "gltf", tmp_path, mesh=tmp_path / "flag.obj")
    tree, _ = chunks(done.files[0].read_bytes())
    assert tree["meshes"][0]["name"] == "flag" and tree["materials"][0]["doubleSided"]


def test_what_is_not_a_mesh_writes_nothing(tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text("no mesh\n")
    with pytest.raises(DataError, match=r"bad\.obj"):
        export(METAL, "gltf", tmp_path / "out", mesh=tmp_path / "bad.obj")
    assert not (tmp_path / "out").exists()


def test_extensions_are_those_that_do_something() -> None:
    plain = gltf_material(
        {"baseColorFactor": [0.5] * 3, "ior": 1.5, "clearcoatFactor": 0.0, "specularFactor": 1.0}, "x"
    )
    assert "extensions" not in plain
    assert "extensions" not in gltf_material({"clearcoatFactor": 0.0, "clearcoatRoughnessFactor": 0.3}, "x")
    full = gltf_material(EVERYTHING, "x")
    named = ("ior", "specular", "clearcoat", "sheen", "anisotropy")
    assert set(full["extensions"]) == {f"KHR_materials_{name}" for name in named}
    assert "extensions" not in gltf_material({"anisotropyStrength": 0.0, "anisotropyRotation": 1.0}, "x")
    assert full["extensions"]["KHR_materials_sheen"] == {
        "sheenColorFactor": [0.25, 0.5, 0.75],
        "sheenRoughnessFactor": 0.5,
    }
    tree, _ = chunks(glb(sphere(1), full))
    assert set(tree["extensionsUsed"]) == set(full["extensions"])


@pytest.mark.skipif(bool(obstacle()), reason=obstacle())
@pytest.mark.parametrize("values", [EVERYTHING, {}, {"baseColorFactor": [0.0, 0.5, 1.0], "specularFactor": 0.0}])
def test_khronos_validator_finds_nothing(values: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "x.glb"
    path.write_bytes(glb(sphere(3), gltf_material(values, 'of "all" <kinds> \u00e4')))
    found = report(path)
    assert said_of(found) == [] and found["info"]["totalTriangleCount"] == 512
    assert found["info"].get("extensionsUsed", []) == sorted(gltf_material(values, "").get("extensions", []))


@pytest.mark.skipif(bool(obstacle()), reason=obstacle())
def test_khronos_validator_finds_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "x.glb"
    path.write_bytes(glb(sphere(1), gltf_material({"metallicFactor": 2.0}, "x")))
    assert [one["code"] for one in report(path)["issues"]["messages"]] == ["VALUE_NOT_IN_RANGE"]


@pytest.mark.parametrize(
    ("brdf", "core", "specular"),
    [
        (Lambert(albedo=[0.5, 0.25, 0.125]), ([0.5, 0.25, 0.125, 1.0], 0, 1), {"specularFactor": 0.0}),
        (
            GGX(specular=0.5, roughness=0.25, f0=0.2),
            ([0.0, 0.0, 0.0, 1.0], 0, 0.5),
            {"specularFactor": 0.5, "specularColorFactor": [5.0] * 3},
        ),
        (GGX(specular=1.0, roughness=0.25, f0=0.2), ([0.2, 0.2, 0.2, 1.0], 1, 0.5), None),
        (GGX(specular=0.0), ([0.0, 0.0, 0.0, 1.0], 0, 1), {"specularFactor": 0.0}),
    ],
)
def test_what_is_exact(brdf: Any, core: tuple[Any, ...], specular: Any, tmp_path: Path) -> None:
    done = export(brdf, "gltf", tmp_path)
    (material,) = chunks(done.files[0].read_bytes())[0]["materials"]
    assert done.exact and isinstance(done.shown, type(brdf))
    found = material["pbrMetallicRoughness"]
    assert found["baseColorFactor"] == pytest.approx(core[0])
    assert (found["metallicFactor"], found["roughnessFactor"]) == pytest.approx(core[1:])
    if specular is None:
        assert "extensions" not in material
    else:
        found = material["extensions"]["KHR_materials_specular"]
        assert set(found) == set(specular)
        assert all(found[name] == pytest.approx(value) for name, value in specular.items())


def gltf_brdf(material: dict[str, Any], cos_i: Any, cos_o: Any, cos_h: Any, cos_d: Any) -> Any:
    """The BRDF of a material without coat and sheen, by the equations of the specification's appendix B."""
    core = material["pbrMetallicRoughness"]
    specular = material.get("extensions", {}).get("KHR_materials_specular", {})
    base, metallic = torch.tensor(core["baseColorFactor"][:3]).double(), core["metallicFactor"]
    a2 = core["roughnessFactor"] ** 4
    distribution = a2 / (torch.pi * (cos_h**2 * (a2 - 1) + 1) ** 2)
    smith = [one * (a2 + (1 - a2) * other**2).sqrt() for one, other in ((cos_i, cos_o), (cos_o, cos_i))]
    facets = distribution * 0.5 / (smith[0] + smith[1])
    weight = specular.get("specularFactor", 1.0)
    colour = torch.tensor(specular.get("specularColorFactor", [1.0] * 3)).double()
    f0 = (0.04 * colour).clamp_max(1) * weight
    schlick = (1 - cos_d) ** 5
    fresnel = f0 + (weight - f0) * schlick
    dielectric = base / torch.pi * (1 - fresnel.max()) + fresnel * facets
    return metallic * (base + (1 - base) * schlick) * facets + (1 - metallic) * dielectric


@pytest.mark.parametrize(
    "brdf",
    [
        Lambert(albedo=[0.5, 0.25, 0.125], dtype=torch.float64),
        GGX(specular=0.5, roughness=0.25, f0=0.2, dtype=torch.float64),
        GGX(specular=1.0, roughness=0.1, f0=0.7, dtype=torch.float64),
    ],
)
def test_what_is_exact_is_the_specification_s(brdf: Any, tmp_path: Path) -> None:
    (material,) = chunks(export(brdf, "gltf", tmp_path).files[0].read_bytes())[0]["materials"]
    angles = [torch.tensor([[angle]], dtype=torch.float64) for angle in (0.3, 0.6, 0.9)]
    pairs = Pairs.from_half_diff(*angles)
    expected = gltf_brdf(material, *(getattr(pairs, name)[0] for name in ("cos_i", "cos_o", "cos_h", "cos_d")))
    torch.testing.assert_close(brdf(pairs)[0, 0], expected.reshape(3), rtol=1e-6, atol=0)


def test_values_beyond_limits_are_moved_and_said() -> None:
    found, notes = within({"baseColorFactor": [1.25, 0.5, -0.5], "ior": 0.5}, GLTF.limits, "gold")
    assert found == {"baseColorFactor": [1.0, 0.5, 0.0], "ior": 1.0}
    assert notes == [
        "baseColorFactor: moved from 1.25 to its limit 1",
        "baseColorFactor: moved from -0.5 to its limit 0",
        "ior: moved from 0.5 to its limit 1",
    ]
    assert within({"metallicFactor": 1 + 1e-7}, GLTF.limits, "gold") == ({"metallicFactor": 1.0}, [])


@pytest.mark.parametrize(
    ("values", "kind", "message"),
    [
        ({"shininess": 1.0}, UsageError, r"^gold: expected one of baseColorFactor, .*, found 'shininess'$"),
        ({"metallicFactor": [1.0, 1.0]}, DataError, r"^gold: metallicFactor: expected a number, found \[1.0, 1.0\]$"),
        ({"baseColorFactor": 0.5}, DataError, r"^gold: baseColorFactor: expected 3 numbers, found 0.5$"),
        ({"metallicFactor": float("nan")}, DataError, r"^gold: metallicFactor: expected a number, found nan$"),
        ({"metallicFactor": "1"}, DataError, r"^gold: metallicFactor: expected a number, found '1'$"),
        ({"metallicFactor": True}, DataError, r"^gold: metallicFactor: expected a number, found True$"),
    ],
)
def test_values_that_are_none_are_said(values: Any, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        within(values, GLTF.limits, "gold")


def test_the_lobe_s_parameters_are_written_as_they_are(tmp_path: Path) -> None:
    lobe = GLTF_LOBE(
        base_color=[0.75, 0.5, 0.25], metallic=0.25, roughness=0.5, specular=0.75, specular_color=[0.5, 0.75, 0.25],
        ior=1.75, clearcoat=0.5, clearcoat_roughness=0.25, sheen_color=[0.25, 0.5, 0.125], sheen_roughness=0.75,
    )  # fmt: skip
    done = export(Sum(lobe), "gltf", tmp_path)
    assert done.exact and done.notes == ["exact: glTF's metallic-roughness material"]
    (material,) = chunks(done.files[0].read_bytes())[0]["materials"]
    assert material["pbrMetallicRoughness"] == {
        "baseColorFactor": [0.75, 0.5, 0.25, 1.0],
        "metallicFactor": 0.25,
        "roughnessFactor": 0.5,
    }
    assert material["extensions"] == {
        "KHR_materials_ior": {"ior": 1.75},
        "KHR_materials_specular": {"specularFactor": 0.75, "specularColorFactor": [0.5, 0.75, 0.25]},
        "KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.25},
        "KHR_materials_sheen": {"sheenColorFactor": [0.25, 0.5, 0.125], "sheenRoughnessFactor": 0.75},
    }


@pytest.mark.slow
def test_what_gltf_has_not_is_refitted(tmp_path: Path) -> None:
    brdf = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=[0.5, 0.4, 0.3], roughness=0.1, f0=0.2))
    done = export(brdf, "gltf", tmp_path)
    assert not done.exact and done.notes[0].startswith("refitted as gltf under compressed: error 0.0")
    assert "MEASUREMENT" not in done.notes[0]  # there is none to match
    again = export(done.shown, "gltf", tmp_path, name="again")
    assert again.exact
    first, second = (chunks(one.files[0].read_bytes())[0]["materials"][0] for one in (done, again))
    assert first == second | {"name": "material"}
