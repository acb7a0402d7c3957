"""Exports of lobes with a grain: exact to Mitsuba, refitted or refused elsewhere, and said so."""

import ast
import json
import math
import re
import struct
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.directions import hemisphere
from helpers.gltf_validator import obstacle, report, said_of
from helpers.pbrt_files import materials_of

from torchbrdf.errors import DataError
from torchbrdf.export import EXPORTERS, Exported, export
from torchbrdf.export.mitsuba import mitsuba_dict
from torchbrdf.export.pbrt import reflected
from torchbrdf.export.shading import visible
from torchbrdf.export.tables import TableExporter
from torchbrdf.lobes import GGX, LOBES, GGXAnisotropic, Lambert, Lobe, RoughConductorAnisotropic, Sum
from torchbrdf.measured import load
from torchbrdf.pairs import Pairs
from torchbrdf.render import sphere

COLOUR = [0.9, 0.6, 0.3]


def metal(rotation: float = 0.0, **values: float) -> RoughConductorAnisotropic:
    return RoughConductorAnisotropic(
        **{"specular": COLOUR, "roughness_x": 0.1, "roughness_y": 0.4, "eta": 0.2, "k": 3.0, **values},
        rotation=rotation,
    )


def check_shown(done: Exported) -> None:
    """What Mitsuba evaluates of the file is the BRDF that is said to be seen."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_file(str(done.files[0]))
    interaction = mi.SurfaceInteraction3f()
    wi, wo = hemisphere(20, seed=3), hemisphere(20, seed=4)
    with torch.no_grad():
        pairs = Pairs.from_directions(wi, wo)
        assert isinstance(done.shown, Lobe)
        expected = done.shown.double()(pairs) * pairs.cos_i[..., None]
    for light, viewer, value in zip(wi, wo, expected, strict=True):
        interaction.wi = viewer.tolist()
        found = list(bsdf.eval(mi.BSDFContext(), interaction, light.tolist()))
        assert found == pytest.approx(value.tolist(), rel=2e-4, abs=1e-8)


@pytest.mark.parametrize(
    "model",
    [
        metal(),
        metal(math.pi / 2),
        metal(-math.pi),
        Sum(Lambert(albedo=0.1), metal(), GGX(specular=0.0)),
        Sum(metal(), metal(math.pi / 2, roughness_x=0.3)),
    ],
    ids=["along", "across", "half a turn", "plastic", "two"],
)
def test_mitsuba_has_it(model: Lobe, tmp_path: Path) -> None:
    done = export(model, "mitsuba", tmp_path)
    assert done.exact and done.shown is not None
    assert "roughconductor" in done.notes[0]
    check_shown(done)


def test_mitsuba_has_no_rotation(tmp_path: Path) -> None:
    """It is left to the texture coordinates, and said."""
    done = export(Sum(Lambert(albedo=0.1), metal(0.3), metal(0.3 - math.pi / 2)), "mitsuba", tmp_path)
    assert not done.exact
    note = "without the rotation of the grain: turn the texture coordinates by 17.19 degrees counterclockwise"
    assert note in done.notes
    straight = Sum(Lambert(albedo=0.1), metal(), metal(math.pi / 2))
    pairs = Pairs.from_directions(hemisphere(1, 20, seed=3), hemisphere(1, 20, seed=4)).to(dtype=torch.float32)
    assert isinstance(done.shown, Lobe)
    torch.testing.assert_close(done.shown(pairs), straight(pairs), rtol=1e-4, atol=1e-6)
    check_shown(done)
    with pytest.raises(
        DataError, match=r"^material: expected one direction of the grain for mitsuba, found rotations 0."
    ):
        export(Sum(metal(0.1), metal(0.4)), "mitsuba", tmp_path)


def test_another_lobe_is_refitted_with_its_grain(tmp_path: Path) -> None:
    lobe = GGXAnisotropic(specular=COLOUR, roughness_x=0.3, roughness_y=0.1, f0=0.9)
    done = export(lobe, "mitsuba", tmp_path)
    assert not done.exact
    assert done.notes[0].startswith("refitted as lambert+roughconductor_anisotropic under compressed: error 0.0")
    assert not any("rotation" in note for note in done.notes)  # its grain lies across the tangent
    assert isinstance(done.shown, Lobe)
    (found,) = (part for part in done.shown.components() if part.is_anisotropic)
    assert found.roughness_x.item() == pytest.approx(0.1, rel=0.1)
    check_shown(done)
    plugin = mitsuba_dict(lobe)
    assert plugin.get("bsdf_1", plugin)["alpha_u"] == pytest.approx(0.3, rel=0.1)


class Unknown(GGXAnisotropic):
    """A lobe with a grain that no program has, nor anybody has GLSL for."""


@pytest.mark.parametrize("to", ["merl", "rgl"])
def test_isotropic_tables_have_its_mean_over_azimuths(to: str, tmp_path: Path) -> None:
    done = export(metal(), to, tmp_path, name="brushed")
    assert not done.exact and not done.shown.is_anisotropic
    assert done.notes[0] == "the grain is left out: an isotropic table, of the mean over 12 azimuths of the surface"


def test_a_lobe_without_glsl_has_no_room_for_it(tmp_path: Path) -> None:
    lacks = "not all of its lobes have GLSL, and a MERL table has no room for it"
    with pytest.raises(
        DataError, match=rf"^brushed: expected an isotropic material for brdf, found one with a grain: {lacks}$"
    ):
        export(Unknown(), "brdf", tmp_path, name="brushed")
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("rotation", [0.0, math.pi / 2], ids=["along", "across"])
def test_pbrts_conductor_has_two_roughnesses(rotation: float, tmp_path: Path) -> None:
    lobe = GGXAnisotropic(specular=COLOUR, roughness_x=0.1, roughness_y=0.4, f0=0.9, rotation=rotation)
    done = export(lobe, "pbrt", tmp_path)
    (name, found), *rest = materials_of(done.files[0])
    assert not rest and name == "material" and not done.exact
    u, v = (found[f"float {key}roughness"] for key in "uv")
    assert ([u, v] if not rotation else [v, u]) == [[0.1], [0.4]] and found["bool remaproughness"] == [False]
    assert [note[:45] for note in done.notes] == ["refitted: pbrt's conductor, with the same dis"]
    wi, wo = hemisphere(200, seed=3), hemisphere(200, seed=4)
    pairs = Pairs.from_directions(wi, wo)
    assert isinstance(done.shown, Lobe) and done.shown.is_anisotropic
    with torch.no_grad():
        shown, own = done.shown.double()(pairs), lobe.double()(pairs)
        colour = torch.tensor(COLOUR, dtype=torch.float64)
        metallic = reflected(0.9 * colour, pairs.cos_d[:, None])
        schlick = colour * (0.9 + 0.1 * (1 - pairs.cos_d[:, None]) ** 5)
    torch.testing.assert_close(shown / metallic, own / schlick, rtol=1e-5, atol=0)  # but for Fresnel's terms the same


def test_pbrt_mixes_it_with_what_is_diffuse(tmp_path: Path) -> None:
    grain = GGXAnisotropic(specular=[0.8, 0.7, 0.6], roughness_x=0.1, roughness_y=0.4, f0=0.95, rotation=0.3)
    done = export(Sum(Lambert(albedo=[0.1, 0.05, 0.02]), grain), "pbrt", tmp_path, name="x")
    diffuse, conductor, (name, mix) = materials_of(done.files[0])
    assert name == "x" and mix["string type"] == ["mix"] and mix["string materials"] == [diffuse[0], conductor[0]]
    share = 1 - mix["float amount"][0]
    assert [share * one for one in diffuse[1]["rgb reflectance"]] == pytest.approx([0.1, 0.05, 0.02])
    at_normal = [(1 - share) * one for one in conductor[1]["rgb reflectance"]]
    assert at_normal == pytest.approx([0.76, 0.665, 0.57], rel=1e-5)
    assert (
        "without the rotation of the grain: turn the texture coordinates by 17.19 degrees counterclockwise"
        in done.notes
    )
    assert isinstance(done.shown, Lobe)
    up = torch.tensor([[0.0, 0.0, 1.0]])
    straight = Sum(Lambert(albedo=[0.1, 0.05, 0.02]), GGXAnisotropic(**parameters_of(grain) | {"rotation": 0.0}))
    here = Pairs.from_directions(up, up)
    torch.testing.assert_close(done.shown(here), straight(here), rtol=1e-4, atol=0)


def test_pbrt_refuses_what_no_conductor_is_near(tmp_path: Path) -> None:
    bright = Sum(Lambert(albedo=0.9), metal())
    with pytest.raises(DataError, match=r"^material: expected a metal for pbrt, which has a grain in its condu"):
        export(bright, "pbrt", tmp_path)
    assert not [*tmp_path.iterdir()]


def read_glb(path: Path) -> Any:
    """The JSON of a binary glTF file."""
    data = path.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + size])


def parameters_of(lobe: Lobe) -> dict[str, torch.Tensor]:
    return {name: getattr(lobe, name).detach() for name in lobe.parameter_specs}


BRUSHED = GGXAnisotropic(specular=1.0, roughness_x=0.1, roughness_y=0.4, f0=0.9, rotation=0.3, dtype=torch.float64)
TURNED = GGXAnisotropic(specular=1.0, roughness_x=0.5, roughness_y=0.06, f0=0.5, rotation=-2.0, dtype=torch.float64)
EQUAL = GGXAnisotropic(specular=1.0, roughness_x=0.2, roughness_y=0.2, f0=0.5, rotation=0.4, dtype=torch.float64)


def grain_of_gltf(path: Path) -> tuple[float, float, float]:
    """Alpha along and across the wide direction, and where that lies: KHR_materials_anisotropy."""
    (material,) = read_glb(path)["materials"]
    alpha = material["pbrMetallicRoughness"]["roughnessFactor"] ** 2
    own = material.get("extensions", {}).get("KHR_materials_anisotropy", {})
    strength = own.get("anisotropyStrength", 0.0)
    return alpha * (1 - strength**2) + strength**2, alpha, own.get("anisotropyRotation", 0.0)


def grain_of_mtlx(path: Path) -> tuple[float, float, float]:
    """OpenPBR's formula, and the nodes that turn the tangent."""
    mx = pytest.importorskip("MaterialX", reason="needs the package materialx")
    made = mx.createDocument()
    mx.readFromXmlFile(made, str(path))
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    made.setDataLibrary(library)
    assert made.validate() == (True, "")
    (surface,) = made.getNodes("open_pbr_surface")
    anisotropy = surface.getInputValue("specular_roughness_anisotropy") or 0.0
    wide = surface.getInputValue("specular_roughness") ** 2 * math.sqrt(2 / (1 + (1 - anisotropy) ** 2))
    tangent = surface.getConnectedNode("geometry_tangent")
    if tangent is None:
        return wide, wide, 0.0
    parts = [tangent.getConnectedNode(name) for name in ("in1", "in2")]
    assert [part.getConnectedNode("in1").getCategory() for part in parts] == ["tangent", "bitangent"]
    cosine, sine = (part.getInputValue("in2") for part in parts)
    return wide, (1 - anisotropy) * wide, math.atan2(sine, cosine)


def grain_of_blender(path: Path) -> tuple[float, float, float]:
    """As Cycles has it."""
    (sockets,) = (
        ast.literal_eval(one.value)
        for one in ast.parse(path.read_text()).body
        if isinstance(one, ast.Assign) and one.targets[0].id == "SOCKETS"  # type: ignore[attr-defined]
    )
    aspect = math.sqrt(1 - 0.9 * sockets.get("Anisotropic", 0.0))
    alpha = sockets["Roughness"] ** 2
    return alpha / aspect, alpha * aspect, 2 * math.pi * sockets.get("Anisotropic Rotation", 0.0)


GRAINS = {"gltf": grain_of_gltf, "mtlx": grain_of_mtlx, "blender": grain_of_blender}


@pytest.mark.parametrize("to", GRAINS)
@pytest.mark.parametrize("lobe", [BRUSHED, TURNED, EQUAL], ids=["brushed", "turned", "equal"])
def test_a_metal_with_a_grain_is_exact(lobe: GGXAnisotropic, to: str, tmp_path: Path) -> None:
    done = export(Sum(Lambert(albedo=0.0), lobe), to, tmp_path)
    assert done.exact and done.notes[0].startswith("exact: ")
    along, across, turn = GRAINS[to](done.files[0])
    same = GGXAnisotropic(**{**parameters_of(lobe), "roughness_x": along, "roughness_y": across, "rotation": turn})
    pairs = Pairs.from_directions(hemisphere(100, seed=3), hemisphere(100, seed=4))
    torch.testing.assert_close(same(pairs), lobe(pairs), rtol=1e-4, atol=1e-7)


def test_what_solvers_leave_of_a_lobe_is_black(tmp_path: Path) -> None:
    """A fit of two lobes to one."""
    rest = GGXAnisotropic(specular=[3e-12, 0.0, 2e-11], roughness_x=0.002, dtype=torch.float64)
    assert export(Sum(Lambert(albedo=0.0), BRUSHED, rest), "gltf", tmp_path).exact
    seen = GGXAnisotropic(specular=[1e-6, 0.0, 0.0], roughness_x=0.002, dtype=torch.float64)
    assert [len(visible(Sum(BRUSHED, one))) for one in (rest, seen)] == [1, 2]


@pytest.mark.slow
@pytest.mark.parametrize("to", GRAINS)
def test_others_are_refitted_with_their_grain(to: str, tmp_path: Path) -> None:
    """A fit, whose metal has something diffuse beside it; the note does not say that the grain was lost."""
    model = Sum(Lambert(albedo=[0.06, 0.05, 0.04]), metal(0.3))
    done = export(model, to, tmp_path)
    assert not done.exact and "refitted as " in done.notes[0] and "_anisotropic under" in done.notes[0]
    assert "without its grain" not in " ".join(done.notes)
    pairs = Pairs.from_directions(hemisphere(500, seed=3), hemisphere(500, seed=4)).to(dtype=torch.float32)
    assert isinstance(done.shown, Lobe)
    with torch.no_grad():
        off = (done.shown(pairs) / model(pairs)).log().abs()
        isotropic = (GGX(specular=COLOUR, roughness=0.2, f0=0.9)(pairs) / model(pairs)).log().abs()
    assert off.median() < 0.2 < 0.5 < isotropic.median()
    along, across, turn = GRAINS[to](done.files[0])
    assert along > 1.5 * across and abs(math.remainder(turn - math.pi / 2 - 0.3, math.pi)) < 0.03
    again = export(done.shown, to, tmp_path, name="again")
    assert GRAINS[to](again.files[0]) == pytest.approx((along, across, turn), rel=1e-5)


def test_a_mesh_of_gltf_has_tangents(tmp_path: Path) -> None:
    """What the extension asks for; of what has no grain files stay as they are."""
    done = export(BRUSHED, "gltf", tmp_path, mesh="sphere")
    tree = read_glb(done.files[0])
    assert tree["extensionsUsed"] == ["KHR_materials_anisotropy"]
    (primitive,) = tree["meshes"][0]["primitives"]
    assert set(primitive["attributes"]) == {"POSITION", "NORMAL", "TANGENT"}
    accessor = tree["accessors"][primitive["attributes"]["TANGENT"]]
    assert (accessor["type"], accessor["componentType"], accessor["count"]) == ("VEC4", 5126, len(sphere().vertices))
    plain = export(GGX(specular=1.0, f0=0.9), "gltf", tmp_path, name="plain", mesh="sphere")
    assert set(read_glb(plain.files[0])["meshes"][0]["primitives"][0]["attributes"]) == {"POSITION", "NORMAL"}


@pytest.mark.skipif(bool(obstacle()), reason=obstacle())
@pytest.mark.parametrize("mesh", ["sphere", "blob"])
def test_khronos_validator_finds_nothing(mesh: str, tmp_path: Path) -> None:
    assert said_of(report(export(BRUSHED, "gltf", tmp_path, mesh=mesh).files[0])) == []


@pytest.mark.parametrize("to", ["astm", "csv", "ssdd"])
def test_lists_have_room_for_it(to: str, tmp_path: Path) -> None:
    """Values at all turns of the surface, read again as those of an anisotropic measurement."""
    model = Sum(Lambert(albedo=0.1), metal(0.5, roughness_x=0.2))
    done = export(model, to, tmp_path)
    again = load(done.files[0], dtype=torch.float64)
    assert again.is_anisotropic and not done.exact
    wi, wo = (
        torch.nn.functional.normalize(hemisphere(300, seed=k) + torch.tensor([0, 0, 0.5]), dim=-1) for k in (1, 2)
    )
    with torch.no_grad():
        pairs = Pairs.from_directions(wi[None], wo[None])
        off = (again.at(pairs)[0] / model.double()(pairs)[0]).log().abs()
    assert off.median() < 0.05


WITH_GRAIN = [name for name, kind in LOBES.items() if kind.is_anisotropic]


@pytest.mark.slow
@pytest.mark.parametrize("to", EXPORTERS)
@pytest.mark.parametrize("name", WITH_GRAIN)
def test_every_lobe_with_a_grain_is_carried_or_refused(name: str, to: str, tmp_path: Path) -> None:
    """Exact, near and said so, left out and said so, or one line that says what is lacking: never without a word."""
    kind = LOBES[name]
    first, second = kind.axes  # type: ignore[attr-defined]
    wide = {second: 3 * kind.parameter_specs[first].start} if kind.rises_with_width else {}  # type: ignore[attr-defined]
    lobe = kind(**wide, **({"specular": 0.6} if "specular" in kind.parameter_specs else {}))
    try:
        done = export(lobe, to, tmp_path, name="brushed")
    except DataError as error:
        assert re.match(rf"brushed: expected .* for {to}, .*grain", str(error)) and len(str(error)) <= 300
        assert not [*tmp_path.iterdir()]
        return
    assert done.shown.is_anisotropic or done.notes[0].startswith("the grain is left out: ")
    assert all(done.notes) and done.exact == done.notes[0].startswith("exact: ")
    assert (
        done.exact
        or issubclass(EXPORTERS[to], TableExporter)
        or re.match("refitted|without the rotation|.*: as OpenPBR, whose picture", done.notes[0])
    )
