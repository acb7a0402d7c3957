"""What a program has no model for."""

import copy
from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch

from torchbrdf.errors import DataError
from torchbrdf.export import Material
from torchbrdf.export.refit import _values_of, _without_idle_layers, refit
from torchbrdf.export.shading import Limits, Target, Values, numbers_of, visible
from torchbrdf.lobes import EON, GGX, GGXF82, GLTF, LOBES, Lambert, Lobe, Sum, make_model
from torchbrdf.measured import Measured, load, standins
from torchbrdf.pairs import Pairs

ANGLE = torch.full((1,), 0.3, dtype=torch.float64)
PAIRS = Pairs.from_half_diff(ANGLE, ANGLE, ANGLE)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16])
def test_a_model_of_the_same_kind_is_found_again(dtype: torch.dtype) -> None:
    brdf = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=0.25, roughness=0.2, f0=0.5)).to(dtype)
    found = refit(Material("paint", brdf), "ggx")
    assert found.error < 2e-3 and found.note.startswith("refitted as ggx under compressed: error ")
    values = found.model.double()(PAIRS)
    assert values.shape == (1, 3)  # not batched
    torch.testing.assert_close(values, brdf.double()(PAIRS), rtol=0.02, atol=0)


def test_what_was_measured_is_fitted() -> None:
    nickel = load(standins()).batch([6])
    found = refit(Material("nickel", nickel), "ggx")
    assert 0 < found.error < 0.5
    with torch.no_grad():
        assert found.error == refit(Material("nickel", nickel), "ggx").error


def test_what_cannot_be_fitted_is_said() -> None:
    angle = torch.full((1, 3), 1.5, dtype=torch.float64)
    pairs = Pairs.from_half_diff(angle, torch.zeros_like(angle), torch.zeros_like(angle))
    measured = Measured.from_samples(pairs, torch.ones(1, 3, 3, dtype=torch.float64), names=["low"])
    with pytest.raises(DataError, match=r"^low: expected valid samples within 80 degrees, found none$"):
        refit(Material("low", measured), "ggx")


def test_a_layer_that_does_not_matter_is_left_out() -> None:
    paint = GLTF(base_color=[0.5, 0.25, 0.125], metallic=0.0, clearcoat=0.0, sheen_color=[0.0, 0.0, 1e-4])
    bins = _values_of(paint, "paint")
    error = 1e-3
    found, without = _without_idle_layers(copy.deepcopy(paint), bins, error)
    assert not found.sheen_color.any() and without < error  # type: ignore[operator, union-attr]
    coated = GLTF(base_color=[0.5, 0.25, 0.125], metallic=0.0, clearcoat=0.5, sheen_color=[0.0, 0.5, 0.0])
    found, same = _without_idle_layers(copy.deepcopy(coated), _values_of(coated, "coated"), error)
    assert same == error and found.clearcoat.item() == 0.5 and found.sheen_color[1].item() == 0.5  # type: ignore[operator, union-attr, index]


def full(lobe: GGXF82) -> Values | None:
    """What the program has of metals: those of full weight."""
    whole = lobe.weight.item() == 1
    return {"colour": numbers_of(lobe.f0), "roughness": lobe.roughness.item() ** 0.5} if whole else None


class Coat(GGX):
    """The program's own material."""

    is_material: ClassVar[bool] = True


def translated(lobe: Any) -> Values:
    return {"colour": numbers_of(lobe.specular), "roughness": lobe.roughness.item() ** 0.5}


LIMITS = {"colour": Limits(upper=0.9, size=3), "roughness": Limits()}
TARGET = Target("the program's material", LIMITS, "coat", translated, "", {"ggx_f82": full})


@pytest.fixture(autouse=True)
def coat(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lobe named coat."""
    len(LOBES)
    monkeypatch.setitem(LOBES._things, "coat", Coat)


def test_what_a_program_has_is_exact() -> None:
    brdf = Sum(EON(albedo=0.0), GGXF82(f0=[0.5, 0.25, 0.75], roughness=0.25))
    found = TARGET.shading(Material("x", brdf))
    assert found.exact and found.notes == ["exact: the program's material"] and found.shown is brdf
    assert found.values == {"colour": [0.5, 0.25, 0.75], "roughness": 0.5}


def test_the_program_s_own_model_is_written_as_it_is() -> None:
    brdf = make_model("coat")
    found = TARGET.shading(Material("x", brdf))
    assert found.exact and found.shown is brdf
    assert found.values["colour"] == [0.5] * 3 and found.values["roughness"] == pytest.approx(0.1**0.5)
    found = replace(TARGET, differs="layers are mixed").shading(Material("x", brdf))
    assert not found.exact and found.shown is brdf and found.notes == ["the program's material: layers are mixed"]
    bright = Coat(specular=1.0)
    found = TARGET.shading(Material("x", bright))
    assert not found.exact and found.notes == ["colour: moved from 1 to its limit 0.9"]
    assert found.values["colour"] == [0.9] * 3


@pytest.mark.parametrize(
    "brdf",
    [
        GGXF82(f0=[0.5, 0.25, 1.0], roughness=0.5),  # beyond the program's limits
        GGXF82(weight=0.5),
        Sum(Lambert(albedo=0.25), GGXF82()),
    ],
)
def test_the_rest_is_refitted(brdf: Lobe) -> None:
    found = TARGET.shading(Material("x", brdf))
    assert not found.exact and found.notes[0].startswith("refitted as coat under compressed: error ")
    assert [type(part) for part in found.shown.components()] == [Coat]  # type: ignore[union-attr]


def test_black_parts_are_not_seen() -> None:
    grey = Lambert(albedo=0.5)
    assert visible(Sum(grey, GGX(specular=0.0), GGXF82(weight=0.0))) == [grey]
    assert visible(Sum(EON(albedo=0.0), GGX(specular=[0.0, 0.5, 0.0])))[0].roughness.item() == pytest.approx(0.1)
