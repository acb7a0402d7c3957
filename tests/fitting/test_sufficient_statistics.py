"""Sums in the place of pairs: equal to the pairs' own objective, for every lobe that declares factors."""

import os
import signal
from functools import partial

import pytest
import torch
from helpers.known_models import measured_from

from torchbrdf import Pairs, fitting
from torchbrdf.errors import UsageError
from torchbrdf.fitting import cross_score
from torchbrdf.fitting.gathered import Gathered
from torchbrdf.fitting.objective import PointwiseObjective, QuadraticObjective
from torchbrdf.fitting.pair_factors import Groups, factor_kinds
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.lobes import LOBES, Lambert, Sum, make_model
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.losses import LOSSES, CompressedLoss, CosineRMSLoss, Loss, Problem, RMSLoss
from torchbrdf.measured import Measured, load, standins

FACTORED = [name for name in LOBES if LOBES[name].has_pair_factors()]
QUADRATIC = [name for name in LOSSES if LOSSES[name]().is_quadratic]
every_factored = pytest.mark.parametrize("name", FACTORED)


fit = partial(fitting.fit, diffuse="fit")  # samples have no reading at 45:0


def random(shape, seed):
    return torch.rand(shape, generator=torch.Generator("cpu").manual_seed(seed), dtype=torch.float64, device="cpu")


def random_pairs(count, seed=0, theta_h=None):
    h, d, phi = random((3, 1, count), seed) * torch.tensor([0.7, 0.8, 3.1], dtype=torch.float64)[:, None, None]
    return Pairs.from_half_diff(h if theta_h is None else theta_h.expand_as(h), d, phi)


def some_values(kind, seed):
    """Parameters within the bounds, on the solver's scale."""
    found = {}
    for k, spec in enumerate(kind.parameter_specs.values()):
        place = 0.2 + 0.6 * random((1, spec.size), seed + k)
        high, low = torch.tensor([spec.upper, spec.lower], dtype=torch.float64)
        found[spec.name] = low * (high / low) ** place if spec.log else low + place * (high - low)
    return found


def test_who_declares_factors():
    assert {"lambert", "oren_nayar", "ward", "cook_torrance", "ashikhmin_shirley", "ward_duer"} <= {*FACTORED}
    assert not {"ggx", "beckmann", "eon", "shifted_gamma", "gltf"} & {*FACTORED}
    assert QUADRATIC == ["cosine_rms", "rms", "solid_angle_cosine_rms"]


@every_factored
def test_on_one_half_angle_terms_are_sums_of_the_factors(name):
    kind = LOBES[name]
    for seed, theta_h in enumerate((0.01, 0.3, 1.0)):
        pairs = random_pairs(200, seed, torch.tensor(theta_h, dtype=torch.float64))
        pairs = pairs.select(samples=pairs.above_horizon[0].nonzero()[:, 0])
        factors = torch.cat([one.expand(1, len(pairs)) for one in kind.pair_factors(pairs)])
        values = some_values(kind, seed)
        for term in kind.terms(pairs, *(values[spec.name] for spec in kind.term_scalars())):
            term = term.expand(1, len(pairs))
            found = torch.linalg.lstsq(factors.T, term.T).solution
            assert (factors.T @ found - term.T).abs().max() < 1e-10 * term.abs().max()


def problem(measured):
    return Problem(measured.pairs, measured.values, measured.weight)


def table(*, step=40, dtype=torch.float32, holes=True):
    """Two stand-ins on some of MERL's bins, of which some are not valid."""
    some = torch.arange(0, 900_000, step)
    part = load(standins(), dtype=dtype).batch([6, 5], some).within(80.0)
    weight = part.weight.clone()
    if holes:
        weight[random(weight.shape, 3) < 0.2] = 0
        weight[1, part.pairs.theta_h[0] > 1.2] = 0
    return Measured.from_samples(part.pairs, part.values, weight, names=part.names)


@pytest.mark.parametrize("loss", QUADRATIC)
@pytest.mark.parametrize("model", ["ward", "cook_torrance", "oren_nayar+charlie+blinn_phong", "ward_duer"])
def test_value_gradient_and_matrix_are_those_of_all_pairs(model, loss):
    measured, loss = table(step=90, dtype=torch.float64), LOSSES[loss]()
    model = make_model(model, None if "+" in model else 2).double().batched(2)
    free = Parametrization(model, free_parameters(model, range(len(model.components()))))
    lower, upper = free.limits()
    x = lower + (upper - lower) * (0.3 + 0.4 * random((2, len(lower)), 5))
    sums = Gathered(measured, [model], [loss]).find(model, loss)
    every = PointwiseObjective(problem(measured), loss)
    quadratic = QuadraticObjective(sums, loss)
    torch.testing.assert_close(quadratic.zero_prediction_error, every.zero_prediction_error)
    rows = torch.tensor([1, 0, 1])
    found, expected = (
        objective.bind(free, {k: v[rows] for k, v in get_parameters(model).items()}, rows).quadratic_model(
            x[rows], torch.arange(3)
        )
        for objective in (quadratic, every)
    )
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-8, atol=1e-9 * float(other.abs().max()))


@pytest.mark.parametrize("order", ["sorted", "shuffled"])
def test_pairs_in_any_order_give_the_same_errors(order):
    measured, loss = table(dtype=torch.float64), CosineRMSLoss()
    if order == "shuffled":
        place = torch.randperm(len(measured.pairs), generator=torch.Generator().manual_seed(1))
        parts = (measured.pairs.select(samples=place), measured.values[:, place], measured.weight[:, place])
        measured = Measured.from_samples(*parts, names=measured.names)
        assert Groups.of(measured.pairs, 64).order is not None
    models = [make_model(name, 1).double().batched(2) for name in ("ward", "ashikhmin_shirley")]
    found = cross_score(models, measured, [loss], Gathered(measured, models, [loss]))
    torch.testing.assert_close(found, cross_score(models, measured, [loss]), rtol=1e-9, atol=0)


def test_a_fit_by_sums_is_the_fit_to_all_pairs():
    measured, loss, model = table(step=60), RMSLoss(), make_model("cook_torrance", 2)
    by_sums = fit(model, measured, loss)
    assert by_sums.samples is None and "sums of all samples" in by_sums.history[0].name
    by_pairs = fit(model, measured, loss, samples=None, intervals="bootstrap")
    assert "samples" in by_pairs.history[0].name and "sums" not in by_pairs.history[0].name
    torch.testing.assert_close(by_sums.error, by_pairs.error, rtol=1e-4, atol=0)
    assert by_sums.status == by_pairs.status
    own = loss.error(by_sums.model(measured.pairs), measured.values, measured.pairs, measured.weight)
    torch.testing.assert_close(by_sums.error, own, rtol=1e-6, atol=0)
    assert by_sums.model.lobes[0].albedo.dtype == torch.float32


def test_several_fits_share_one_pass(monkeypatch):
    measured = table(step=100)
    losses, models = [RMSLoss(), CosineRMSLoss(), CompressedLoss()], [make_model("ward", 1), make_model("ggx", 1)]
    gathered = Gathered(measured.within(80.0), models, losses)
    shared = [fit(model, measured, loss, gathered=gathered) for model in models for loss in losses]
    alone = [fit(model, measured, loss) for model in models for loss in losses]
    for one, other in zip(shared, alone, strict=True):
        torch.testing.assert_close(one.error, other.error, rtol=1e-9, atol=0)
    assert gathered.find(models[1], losses[0]) is None and gathered.find(models[0], losses[2]) is None


def test_where_there_are_no_sums():
    loss = RMSLoss()
    scattered = measured_from(Sum(Lambert(albedo=0.3)).batched(1), random_pairs(500))
    ward = make_model("ward", 1)
    assert Gathered(scattered, [ward], [loss]).find(ward, loss) is None
    assert fit(ward, scattered, loss).status[0] in ("converged", "stalled")
    assert factor_kinds(make_model("oren_nayar+ggx+ward")) == []

    class Squeezed(RMSLoss):
        def encode(self, values, pairs):
            return values.sqrt()

    class Huber(RMSLoss):
        def penalty(self, difference):
            return difference.abs()

    class Elsewhere(RMSLoss):
        def problem(self, measured, subset=None):
            return super().problem(measured, subset)

    class Doubled(CosineRMSLoss):
        has_linear_encoding = True

        def encode(self, values, pairs):
            return 2 * super().encode(values, pairs)

        def encode_with_derivative(self, values, pairs):
            code, rate = super().encode_with_derivative(values, pairs)
            return 2 * code, 2 * rate

    assert not any(kind().is_quadratic for kind in (Squeezed, Huber, Elsewhere, Loss))
    doubled = Doubled()
    assert doubled.is_quadratic
    measured = table(step=100)
    assert fit(ward, measured, doubled).error.tolist() == pytest.approx(
        [2 * one for one in fit(ward, measured, CosineRMSLoss()).error.tolist()], rel=1e-6
    )


def test_sums_of_other_materials_are_refused():
    measured, loss, model = table(step=100), RMSLoss(), make_model("ward", 1)
    for wrong in (measured, measured.within(40.0), measured.batch([1]), table(step=100)):
        with pytest.raises(UsageError, match="gathered: expected a Gathered of these materials within 80 degrees"):
            fit(model, measured.batch([0]), loss, gathered=Gathered(wrong, [model], [loss]))
    for wrong in (measured, "x"):
        with pytest.raises(UsageError, match="gathered: expected a Gathered"):
            fit(model, measured, loss, gathered=wrong)
    right = Gathered(measured.batch([0]).within(80.0), [model], [loss])
    assert fit(model, measured.batch([0]), loss, gathered=right).samples is None


def test_factors_that_are_not_finite_are_refused():
    class Broken(Lambert):
        @classmethod
        def pair_factors(cls, pairs):
            return [pairs.cos_i * torch.nan]

    with pytest.raises(UsageError, match=r"Broken\.pair_factors: expected finite values, found some that are not"):
        fit(Sum(Broken()), table(step=100), RMSLoss())


def test_a_material_without_valid_samples_leaves_the_others_be():
    measured = table(step=100)
    weight = measured.weight.clone()
    weight[0] = 0
    measured = Measured.from_samples(measured.pairs, measured.values, weight, names=measured.names)
    found = fit(make_model("cook_torrance", 1), measured, CosineRMSLoss())
    assert found.status[0] == "no_data" and found.status[1] == "converged"
    alone = fit(make_model("cook_torrance", 1), measured.batch([1]), CosineRMSLoss())
    assert found.error[1].item() == pytest.approx(alone.error[0].item(), rel=1e-7)


@pytest.mark.slow
def test_a_worker_that_dies_in_the_pass_leaves_fits_to_the_pairs(tmp_path, monkeypatch, two_threads):
    class DeadlyLoss(RMSLoss):
        def sample_weight(self, pairs):
            if os.getpid() != owner and not (tmp_path / "2").exists():
                (tmp_path / str(len(list(tmp_path.iterdir())) + 1)).touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return

    owner = os.getpid()
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "always")
    monkeypatch.setattr("torchbrdf.fitting.batching.PROCESS_THRESHOLD", 0)
    measured, model = load(standins()).batch([4, 5]), make_model("ward", 1)
    found = fit(model, measured, DeadlyLoss(), samples=300, max_theta=30.0)
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "never")
    calm = fit(model, measured, RMSLoss(), samples=300, max_theta=30.0)
    assert found.status == calm.status
    torch.testing.assert_close(found.error, calm.error, rtol=1e-3, atol=0)
