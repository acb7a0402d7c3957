"""Exports of lobes with a grain: exact to Mitsuba, refitted or refused elsewhere, and said so."""

import math
from pathlib import Path

import pytest
import torch
from helpers.directions import hemisphere
from helpers.pbrt_files import materials_of

from torchbrdf.errors import DataError
from torchbrdf.export import Exported, export
from torchbrdf.export.mitsuba import mitsuba_dict
from torchbrdf.export.pbrt import reflected
from torchbrdf.lobes import GGX, GGXAnisotropic, Lambert, Lobe, RoughConductorAnisotropic, Sum
from torchbrdf.pairs import Pairs

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


@pytest.mark.parametrize(
    ("to", "model", "lacks"),
    [
        ("merl", metal(), "MERL's bins have no azimuth of the half vector"),
        ("rgl", metal(), "the table has one azimuth of the light"),
        ("brdf", Unknown(), "not all of its lobes have GLSL, and a MERL table has no room for it"),
    ],
)
def test_tables_have_no_room_for_it(to: str, model: Lobe, lacks: str, tmp_path: Path) -> None:
    with pytest.raises(
        DataError, match=rf"^brushed: expected an isotropic material for {to}, found one with a grain: {lacks}$"
    ):
        export(model, to, tmp_path, name="brushed")
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


def parameters_of(lobe: Lobe) -> dict[str, torch.Tensor]:
    return {name: getattr(lobe, name).detach() for name in lobe.parameter_specs}


@pytest.mark.parametrize("to", ["gltf", pytest.param("mtlx", marks=pytest.mark.slow)])
def test_others_are_refitted_without_it(to: str, tmp_path: Path) -> None:
    done = export(metal(0.3), to, tmp_path)
    assert not done.exact and "; without its grain" in done.notes[0]
