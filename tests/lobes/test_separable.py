"""Lobes of several coloured terms, whole materials and shared parameters."""

import math
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError
from torchbrdf.fitting import fit
from torchbrdf.fitting.basis import Basis, is_separable
from torchbrdf.fitting.objective import GaussNewtonObjective, make_objective
from torchbrdf.fitting.objective.autograd import AutogradObjective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.lobes import (
    GGX,
    LOBES,
    BoundedParameter,
    FitRecord,
    Lambert,
    Lobe,
    OutsideBoundsWarning,
    Sum,
    albedo,
    from_parameters,
    make_model,
    model_name,
    parameters,
    read_fits,
    write_fits,
)
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.lobes.separable import columns, pattern
from torchbrdf.losses import Problem, make_loss
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs

N = 300


class Plastic(Lobe):
    """A whole material of two terms: a colour that fades as the gloss grows, and a white highlight."""

    is_material: ClassVar[bool] = True
    color: BoundedParameter = albedo(start=0.5, doc="of the body")
    gloss: BoundedParameter = BoundedParameter(start=0.1, lower=0.0, upper=1.0, doc="share of the highlight")
    roughness: BoundedParameter = BoundedParameter(start=0.2, lower=0.01, upper=1.0, log=True, doc="its width")
    scalars_of_terms: ClassVar[tuple[str, ...]] = ("roughness",)

    @classmethod
    def terms(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        (roughness,) = scalars
        return [torch.full_like(pairs.cos_i, 1 / math.pi), (-pairs.tan2_h / roughness.square()).exp()]

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        gloss = parameters["gloss"]
        return columns(parameters["color"] * (1 - gloss), gloss.square())


@pytest.fixture
def plastic(monkeypatch: pytest.MonkeyPatch) -> type[Lobe]:
    """Registered for one test."""
    list(LOBES)
    monkeypatch.setitem(LOBES._things, "plastic", Plastic)
    return Plastic


def pairs_of(count: int = N, seed: int = 0) -> Pairs:
    generator = torch.Generator().manual_seed(seed)
    angles = 0.78 * torch.rand(4, 1, count, generator=generator, dtype=torch.float64)  # all above the horizon
    return Pairs.from_half_diff(*angles)


@pytest.mark.parametrize("name", [name for name, lobe in LOBES.items() if lobe.is_separable()])
def test_terms_make_up_the_value(name: str) -> None:
    kind = LOBES[name]
    lobe, pairs = kind(dtype=torch.float64), pairs_of()
    own = {key: getattr(lobe, key).detach() for key in kind.parameter_specs}
    terms = kind.terms(pairs, *(own[spec.name] for spec in kind.term_scalars()))
    made = sum(a * term[..., None] for a, term in zip(kind.coefficients(**own).unbind(-1), terms, strict=True))
    assert torch.allclose(made, lobe(pairs).detach(), rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", [name for name, lobe in LOBES.items() if lobe.has_terms()])
def test_closed_derivatives_of_terms(name: str) -> None:
    kind = LOBES[name]
    scalars = [torch.full(spec.shape, spec.start, dtype=torch.float64) for spec in kind.term_scalars()]
    terms, slopes = kind.terms_and_jacobian(pairs_of(), *scalars)
    general, expected = Lobe.terms_and_jacobian.__func__(kind, pairs_of(), *scalars)
    assert all(torch.allclose(one, other, rtol=1e-12) for one, other in zip(terms, general, strict=True))
    for own, wanted in zip(slopes, expected, strict=True):
        for one, other in zip(own, wanted, strict=True):
            assert (one is None) == (other is None)
            assert one is None or torch.allclose(one, other, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("scalar_albedo", [False, True])
@pytest.mark.parametrize(
    "model",
    [
        make_model("eon+ggx", dtype=torch.float64),
        make_model("eon+ggx+beckmann:f0", dtype=torch.float64),
        make_model("shifted_gamma", 1, dtype=torch.float64),
        Sum(Plastic(dtype=torch.float64)),
        Sum(Lambert(dtype=torch.float64), Plastic(dtype=torch.float64), GGX(dtype=torch.float64)),
    ],
    ids=["eon", "shared", "a number a channel", "material", "among others"],
)
def test_the_objectives_gradient_is_autograds(model: Sum, scalar_albedo: bool) -> None:
    model, pairs = model.batched(2), pairs_of()
    target = model(pairs).detach() * (0.5 + torch.rand(2, N, 3, dtype=torch.float64))
    objective = make_objective(model, Problem(pairs, target), make_loss("compressed"))
    assert isinstance(objective, GaussNewtonObjective)
    free = free_parameters(model, range(len(model.components())), scalar_albedo=scalar_albedo)
    parametrization, values = Parametrization(model, free), get_parameters(model)
    rows, x = torch.arange(2), parametrization.encode(values)
    value, gradient = objective.bind(parametrization, values).value_and_gradient(x, rows)
    slow = AutogradObjective(objective.problem, objective.loss).bind(parametrization, values)
    expected, slope = slow.value_and_gradient(x, rows)
    assert torch.allclose(value, expected, rtol=1e-12)
    assert torch.allclose(gradient, slope, rtol=1e-9, atol=1e-12 * float(slope.abs().max()))


def test_terms_that_do_not_know_a_scalar_have_no_derivative_of_it() -> None:
    assert pattern(Plastic) == (2, ((1,),), ("color", "gloss"))
    basis = Basis(Parametrization(Sum(Plastic()), free_parameters(Sum(Plastic()), [0])))
    assert (len(basis.slopes), basis.terms, basis.used) == (1, 2, 3)


def test_a_whole_material_is_a_model(plastic: type[Lobe]) -> None:
    model = make_model("plastic")
    assert [type(one) for one in model.components()] == [plastic]
    assert is_separable(model)
    assert model_name(model) == ("plastic", 1)
    values = parameters(model)
    assert values == {"color": [0.5] * 3, "gloss": pytest.approx(0.1), "roughness": pytest.approx(0.2)}
    assert parameters(from_parameters("plastic", values)) == values
    record = FitRecord("paint", "plastic", 1, values)
    assert FitRecord.from_json(record.to_json()) == record


def test_a_whole_material_stands_alone(plastic: type[Lobe]) -> None:
    with pytest.raises(UsageError, match="expected plastic, a whole material, alone, found ggx\\+plastic"):
        make_model("ggx+plastic")
    with pytest.raises(UsageError, match="expected 1, as plastic is a whole material, found 2"):
        make_model("plastic", 2)
    with pytest.raises(DataError, match="expected color, gloss, roughness, found diffuse"):
        from_parameters("plastic", {"diffuse": [0.1] * 3})


def test_shared_parameters_by_name() -> None:
    model = make_model("oren_nayar+ggx+beckmann:f0")
    assert model.shared == ("f0",)
    name, lobes = model_name(model)
    assert (name, lobes) == ("oren_nayar+ggx+beckmann:f0", 2)
    again = from_parameters(name, parameters(model))
    assert model_name(again) == (name, lobes)
    assert model_name(make_model("ggx:f0", 3)) == ("ggx:f0", 3)
    with pytest.raises(DataError, match="f0: expected one value for all lobes"):
        from_parameters(name, parameters(model) | {"f0": [0.1, 0.2]})


@pytest.mark.parametrize("name", ["ggx:", "ggx:f1", "ggx+ward:f0", "ggx:f0,f0", "ggx:f0,", ":f0", "ward+ggx:albedo"])
def test_what_lobes_cannot_share_is_refused(name: str) -> None:
    with pytest.raises(UsageError):
        make_model(name)


def test_a_fit_keeps_shared_parameters_one() -> None:
    pairs = pairs_of(2000)
    true = make_model("ggx:f0", dtype=torch.float64)
    true.lobes[1].roughness, true.lobes[2].roughness = 0.05, 0.4
    true.lobes[1].f0 = true.lobes[2].f0 = 0.1
    measured = Measured.from_samples(pairs, true(pairs).detach(), names=["made"])
    found = fit(make_model("ggx:f0"), measured, make_loss("compressed"), diffuse="fit", samples=None)
    record = found.records()[0]
    first, second = record.parameters["f0"]
    assert first == second == pytest.approx(0.1, rel=1e-2)
    assert sorted(record.parameters["roughness"]) == pytest.approx([0.05, 0.4], rel=1e-2)


def test_no_albedo_is_measured_for_a_whole_material(plastic: type[Lobe]) -> None:
    pairs = pairs_of(50)
    made = Plastic(dtype=torch.float64, color=[0.5, 0.3, 0.1], gloss=0.7, roughness=0.03)
    measured = Measured.from_samples(pairs, made(pairs).detach(), names=["made"])
    found = fit(make_model("plastic"), measured, make_loss("compressed"))
    assert found.diffuse == "fit"
    assert found.records()[0].parameters["roughness"] == pytest.approx(0.03, rel=1e-3)
    with pytest.raises(UsageError, match="diffuse: expected fit for Plastic, found 45:0"):
        fit(make_model("plastic"), measured, make_loss("compressed"), diffuse="45:0")


def test_a_file_with_parameters_outside_their_bounds_says_so(tmp_path: Path) -> None:
    values = {"diffuse": [0.1] * 3, "specular": [[0.1] * 3], "roughness": [0.9]}
    write_fits(tmp_path / "fits.json", [FitRecord("paint", "ward", 1, values)])
    with pytest.warns(OutsideBoundsWarning, match="roughness 0.9, not 0.001 to 0.5, of paint$"):
        (record,) = read_fits(tmp_path / "fits.json")
    assert record.parameters == values
    (inside,) = [FitRecord("paint", "ward", 1, values | {"roughness": [0.001]})]
    write_fits(tmp_path / "fits.json", [inside])
    assert read_fits(tmp_path / "fits.json") == [inside]
