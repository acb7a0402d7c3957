"""Exports of lobes with a grain: exact to Mitsuba, refitted or refused elsewhere, and said so."""

import math
from pathlib import Path

import pytest
import torch
from helpers.directions import hemisphere

from torchbrdf.errors import DataError
from torchbrdf.export import Exported, export
from torchbrdf.export.mitsuba import mitsuba_dict
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


@pytest.mark.parametrize("to", ["merl", "rgl"])
def test_isotropic_tables_have_its_mean_over_azimuths(to: str, tmp_path: Path) -> None:
    done = export(metal(), to, tmp_path, name="brushed")
    assert not done.exact and not done.shown.is_anisotropic
    assert done.notes[0] == "the grain is left out: an isotropic table, of the mean over 12 azimuths of the surface"


@pytest.mark.parametrize("to", ["brdf", "pbrt"])
def test_tables_have_no_room_for_it(to: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=rf"^brushed: expected an isotropic material for {to}, found one with a grain$"):
        export(metal(), to, tmp_path, name="brushed")
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("to", ["gltf", pytest.param("mtlx", marks=pytest.mark.slow)])
def test_others_are_refitted_without_it(to: str, tmp_path: Path) -> None:
    done = export(metal(0.3), to, tmp_path)
    assert not done.exact and "; without its grain" in done.notes[0]
