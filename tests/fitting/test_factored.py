"""Objectives that evaluate lobes at probes only: equal to those that evaluate them on every pair."""

import pytest
import torch

from torchbrdf.fitting.layout import Layout
from torchbrdf.fitting.objective import make_objective
from torchbrdf.fitting.pair_factors import Groups
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.fitting.scoring import errors, errors_seen
from torchbrdf.lobes import LOBES, Lambert, Sum, make_model
from torchbrdf.lobes.parameter_dict import get_parameters, take_materials
from torchbrdf.losses import LOSSES, CubeRootLoss, Loss, Problem
from torchbrdf.pairs import Pairs

FACTORED = [name for name in LOBES if name != "lambert" and LOBES[name].has_pair_factors()]
POINTWISE = [name for name in LOSSES if LOSSES[name].objective in ("pointwise", "binned")]
ROWS = torch.tensor([1, 0, 1])


class Weber(Loss):
    """One that says no more than has to be said."""

    def encode(self, values, pairs):
        return (1 + 10 * values.clamp_min(0) * pairs.cos_i[..., None]).log()

    def penalty(self, difference):
        return (1 + difference.square()).sqrt() - 1


def random(*shape, seed=0):
    return torch.rand(shape, generator=torch.Generator("cpu").manual_seed(seed), dtype=torch.float64, device="cpu")


def problem(weights="own", *, groups=6, count=40, dtype=torch.float64, shuffled=False):
    """Two materials on pairs of a few half angles, of which one has fewer."""
    h = (0.02 + 0.9 * random(groups, seed=1)).repeat_interleave(count)[: groups * count - count // 2]
    d, phi = 0.9 * random(len(h), seed=2), 3.1 * random(len(h), seed=3)
    pairs = Pairs.from_half_diff(h[None], d[None], phi[None])
    kept = ((pairs.cos_i > 0.1) & (pairs.cos_o > 0.1))[0].nonzero()[:, 0]
    kept = kept[random(len(kept), seed=4).argsort()] if shuffled else kept
    pairs = pairs.select(samples=kept).to(dtype=dtype)
    target = 10 ** (3 * random(2, len(pairs), 3, seed=5) - 2)
    weight = {
        "none": None,
        "own": (random(2, len(pairs), 1, seed=6) > 0.3) * 1.0,
        "shared": random(1, len(pairs), 1, seed=6),
        "channels": random(1, len(pairs), 3, seed=6),
    }[weights]
    return Problem(pairs, target.to(dtype), None if weight is None else weight.to(dtype))


def model_of(kinds):
    """Different lobes for each of two materials, well inside the bounds."""
    model = Sum(*(LOBES[kind]() for kind in kinds)).batched(2).double()
    for k, part in enumerate(model.components()):
        for i, (name, spec) in enumerate(part.parameter_specs.items()):
            place = 0.3 + 0.4 * random(2, spec.size, seed=10 * k + i)
            low, high = torch.tensor([spec.lower, spec.upper]).double()
            value = low * (high / low) ** place if spec.log else low + place * (high - low)
            getattr(part, name).data = value.reshape(2, *spec.shape)
    return model


def bound(given, loss, model, free, rows=ROWS, factored=True):
    """Problems for a solver, and where they are."""
    objective = make_objective(model, given, loss)
    assert objective.factored is not None
    if not factored:
        objective.factored = None
    values = take_materials(get_parameters(model), rows)
    share = loss.smoothing_widths[0]
    width = None if share is None else share * objective.target_scale[rows]
    return objective.bind(free, values, rows, width), free.encode(values)


def assert_equal(given, loss, model, free, rtol=1e-9):
    every = torch.arange(len(ROWS))
    (one, x), (other, _) = (bound(given, loss, model, free, factored=factored) for factored in (True, False))
    for found, expected in (
        (one.quadratic_model(x, every), other.quadratic_model(x, every)),
        (one.quadratic_model(x[1:], every[1:]), other.quadratic_model(x[1:], every[1:])),
        (one.value_and_gradient(x, every), other.value_and_gradient(x, every)),
    ):
        for mine, plain in zip(found, expected, strict=True):
            torch.testing.assert_close(mine, plain, rtol=rtol, atol=rtol * float(plain.abs().max()))


@pytest.mark.parametrize("loss", POINTWISE)
@pytest.mark.parametrize("name", FACTORED)
def test_value_gradient_and_matrix_are_those_of_all_pairs(name, loss):
    kinds = [name, name] if LOBES[name].is_diffuse else ["lambert", name, name]
    model = model_of(kinds if name != "oren_nayar" else ["oren_nayar", "ward"])
    free = Parametrization(model, free_parameters(model, range(len(model.components()))))
    weights = ("own", "none", "shared", "channels")[(FACTORED.index(name) + POINTWISE.index(loss)) % 4]
    assert_equal(problem(weights), LOSSES[loss](), model, free)


@pytest.mark.parametrize("weights", ["none", "own", "shared", "channels"])
@pytest.mark.parametrize("loss", [*POINTWISE, "weber"])
def test_with_any_weights_and_in_any_order(loss, weights):
    loss = Weber() if loss == "weber" else LOSSES[loss]()
    model = model_of(["lambert", "ward", "cook_torrance"])
    free = Parametrization(model, free_parameters(model, [1, 2]))
    assert_equal(problem(weights, shuffled=True), loss, model, free)


@pytest.mark.parametrize("loss", ["cube_root", "learned"])
def test_with_some_lobes_one_number_for_a_colour_or_no_shape_free(loss):
    loss, model = LOSSES[loss](), model_of(["lambert", "cook_torrance", "cook_torrance"])
    for free in (
        Parametrization(model, free_parameters(model, [1], scalar_albedo=True), [0, 1]),
        Parametrization(model, [one for one in free_parameters(model, [0, 1, 2]) if one.spec.linear]),
        Parametrization(model, free_parameters(model, [0]), [0, 2]),
    ):
        assert_equal(problem(), loss, model, free)


@pytest.mark.parametrize("loss", [*POINTWISE, "weber"])
def test_gradients_are_differences_of_values(loss):
    loss, model = Weber() if loss == "weber" else LOSSES[loss](), model_of(["lambert", "ward", "cook_torrance"])
    free, one = Parametrization(model, free_parameters(model, [0, 1, 2])), torch.tensor([0])
    problems, x = bound(problem(), loss, model, free)
    _, gradient, _ = problems.quadratic_model(x[:1], one)
    for k in range(x.shape[1]):
        step = torch.zeros_like(x[:1])
        step[0, k] = 1e-5
        up, down = (problems.quadratic_model(x[:1] + sign * step, one)[0] for sign in (1, -1))
        torch.testing.assert_close((up - down) / 2e-5, gradient[:, k], rtol=1e-5, atol=1e-7 * gradient.abs().max())


@pytest.mark.parametrize("loss", POINTWISE)
def test_in_single_precision(loss):
    model, loss = model_of(["lambert", "cook_torrance", "cook_torrance"]), LOSSES[loss]()
    free, every = Parametrization(model, free_parameters(model, [1, 2])), torch.arange(len(ROWS))
    found, expected = (
        problems.quadratic_model(x, every)
        for dtype in (torch.float32, torch.float64)
        for problems, x in [bound(problem(dtype=dtype), loss, model, free)]
    )
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == torch.float64
        torch.testing.assert_close(one, other, rtol=1e-4, atol=2e-5 * float(other.abs().max()))


def test_a_prediction_of_0_has_no_slope_where_the_loss_has_none():
    model = model_of(["lambert", "ward"])
    for name in ("albedo", "specular"):
        for part in model.components():
            if hasattr(part, name):
                getattr(part, name).data.zero_()
    free = Parametrization(model, free_parameters(model, [0, 1]))
    for loss in ("compressed", "log", "learned"):
        assert_equal(problem(), LOSSES[loss](), model, free)


def test_a_subset_is_laid_out_anew():
    model, loss = model_of(["lambert", "ward"]), CubeRootLoss()
    free, rows = Parametrization(model, free_parameters(model, [1])), torch.arange(2)
    objective = make_objective(model, problem(count=100), loss)
    subset = objective.subsample(200, 0)
    assert subset.factored is not None and len(subset.problem.pairs) == 200
    values = get_parameters(model)
    found = subset.bind(free, values).quadratic_model(free.encode(values), rows)
    subset.factored = None
    for one, other in zip(found, subset.bind(free, values).quadratic_model(free.encode(values), rows), strict=True):
        torch.testing.assert_close(one, other)


def test_where_lobes_are_evaluated_on_the_pairs():
    scattered = Pairs.from_half_diff(*(torch.tensor([0.9, 0.9, 3.1]).double()[:, None, None] * random(3, 1, 500)))
    given = Problem(scattered, random(2, 500, 3))
    assert make_objective(make_model("ward", 1), given, CubeRootLoss()).factored is None
    own = problem()
    pairs = Pairs(**{name: value.expand(2, -1) for name, value in own.pairs.items() if name not in ("wi", "wo")})
    assert make_objective(make_model("ward", 1), Problem(pairs, own.target), CubeRootLoss()).factored is None


def test_every_pair_is_in_one_block_of_its_half_angle():
    pairs = problem(shuffled=True, groups=9).pairs
    layout = Layout(pairs, Groups.of(pairs, 8))
    real = layout.real > 0
    assert sorted(layout.sample[real].tolist()) == list(range(len(pairs)))
    angles = pairs.theta_h[0][layout.sample]
    assert torch.equal(angles, angles[:, :1].expand_as(angles))
    spread = layout.spread(pairs.theta_h)
    assert torch.equal(spread[:, 0], angles * layout.real)


def test_a_lobe_alone_that_is_held_has_no_derivatives():
    model = Sum(Lambert()).batched(2).double()
    given, free = problem(), Parametrization(model, free_parameters(model, [0]))
    assert_equal(given, CubeRootLoss(), model, free)


@pytest.mark.parametrize("weights", ["none", "own", "shared"])
@pytest.mark.parametrize("name", ["cook_torrance", "ward", "ggx"])
def test_errors_of_what_an_objective_sees_are_those_of_the_pairs(name, weights):
    some, loss = problem(weights), CubeRootLoss()
    model = model_of(["lambert", name, name])
    objective = make_objective(model, some, loss)
    free = Parametrization(model, free_parameters(model, [1, 2]))
    expected = errors([model], some, [loss])[0, 0]
    assert torch.allclose(errors_seen(model, some, loss, objective, free), expected, rtol=1e-12)
