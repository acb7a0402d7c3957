"""The squared error without a graph: against autograd, for every lobe, loss, weight and kind of variable."""

import pytest
import torch
from helpers.directions import hemisphere

from torchbrdf.fitting.columns import applies
from torchbrdf.fitting.data import Data
from torchbrdf.fitting.normal import SquaredError
from torchbrdf.fitting.variables import Variable, decode, encode, evaluate, values_of
from torchbrdf.lobes import LOBES, Lambert, Lobe, Sum
from torchbrdf.losses import LOSSES, CubeRootLoss, GroupedLoss, Loss, Problem
from torchbrdf.pairs import Pairs

COLORED = [name for name, lobe in LOBES.items() if lobe.albedo_spec() is not None and lobe is not Lambert]
ANALYTIC = [name for name, loss in LOSSES.items() if loss.error is Loss.error or issubclass(loss, GroupedLoss)]


def problem(materials, shared, weighted, count=300):
    """Random targets on pairs near the mirror direction."""
    lead = (1 if shared else materials, count)
    wi = hemisphere(*lead, seed=1)
    near = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64) + 0.3 * hemisphere(*lead, seed=2)
    pairs = Pairs.from_directions(wi, near / near.norm(dim=-1, keepdim=True))
    generator = torch.Generator().manual_seed(3)
    target = 10 ** (3 * torch.rand(materials, count, 3, generator=generator, dtype=torch.float64) - 2)
    weight = (torch.rand(materials, count, 1, generator=generator) > 0.3).double() if weighted else None
    return Problem(pairs, target, weight)


def model_of(name, materials):
    """Lambert and two lobes, different for each material, well inside the bounds."""
    generator = torch.Generator().manual_seed(4)
    model = Sum(Lambert(), LOBES[name](), LOBES[name]()).batched(materials).double()
    for part in model.components():
        for key, bounded in part.parameter_specs.items():
            u = 0.3 + 0.4 * torch.rand(materials, bounded.size, generator=generator, dtype=torch.float64)
            low, high = torch.tensor([bounded.lower, bounded.upper]).double()
            value = (low.log() + u * (high / low).log()).exp() if bounded.log else low + u * (high - low)
            getattr(part, key).data = value
    return model


def kinds(model):
    """All parameters; a scalar albedo for one lobe alone; colours with the shapes held."""
    parts = model.components()
    everything = [Variable(k, b, b.size) for k in range(3) for b in parts[k].parameter_specs.values()]
    scalar = [Variable(1, b, 1) for b in parts[1].parameter_specs.values()]
    colors = [Variable(k, b, b.size) for k in (1, 2) for b in parts[k].parameter_specs.values() if b.linear]
    return {"all": (everything, [0, 1, 2]), "scalar": (scalar, [0, 1]), "colors": (colors, [0, 1, 2])}


@pytest.mark.parametrize("kind", ["all", "scalar", "colors"])
@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("weighted", [True, False])
@pytest.mark.parametrize("loss_name", ANALYTIC)
@pytest.mark.parametrize("name", COLORED)
def test_value_and_gradient_are_autograds(name, loss_name, weighted, shared, kind):
    given, loss, model = problem(3, shared, weighted), LOSSES[loss_name](), model_of(name, 3)
    values = values_of(model)
    variables, parts = kinds(model)[kind]
    data = Data(given, loss)
    rows = torch.tensor([2, 0])  # some of the problems, in another order; problem 2 is material 0
    materials = torch.tensor([1, 2, 0])
    own = {key: value[materials] for key, value in values.items()}
    scale = torch.tensor([2.0, 3.0, 5.0], dtype=torch.float64)
    error = SquaredError(model, data, materials, own, variables, parts, scale)
    x = encode(variables, own)[rows]
    value, gradient, matrix = error(x, rows)

    point = x.clone().requires_grad_()
    chosen = materials[rows]
    here = {key: v[chosen] for key, v in values.items()} | decode(variables, point, torch.float64)
    pairs = given.pairs.select(chosen)
    weight = None if given.weight is None else given.weight[chosen]
    expected = (
        loss.error(evaluate(model, here, pairs, parts), given.target[chosen], pairs, weight).square() / scale[rows]
    )
    (slope,) = torch.autograd.grad(expected.sum(), point)
    torch.testing.assert_close(value, expected.detach(), rtol=1e-7, atol=0)
    torch.testing.assert_close(gradient, slope, rtol=1e-6, atol=1e-9 * slope.abs().max().item())
    assert (torch.linalg.eigvalsh(matrix) > -1e-9 * matrix.abs().amax()).all()
    assert torch.equal(error(x, rows, curvature=False)[1], gradient)


@pytest.mark.parametrize("loss_name", ["compressed", "learned"])
@pytest.mark.parametrize("name", COLORED)
def test_the_matrix_is_the_hessian_of_a_least_squares_loss_at_an_exact_fit(name, loss_name):
    loss, model = LOSSES[loss_name](), model_of(name, 1)
    given = problem(1, True, False)
    given = Problem(given.pairs, model(given.pairs).detach())
    values = values_of(model)
    variables, parts = kinds(model)["all"]
    one = torch.tensor([0])
    error = SquaredError(model, Data(given, loss), one, values, variables, parts, torch.ones(1, dtype=torch.float64))
    x = encode(variables, values)
    _, _, matrix = error(x, one)
    step = 1e-5
    columns = []
    for k in range(x.shape[1]):
        along = torch.zeros_like(x)
        along[0, k] = step
        columns.append((error(x + along, one)[1][0] - error(x - along, one)[1][0]) / (2 * step))
    torch.testing.assert_close(matrix[0], torch.stack(columns), rtol=1e-3, atol=1e-5 * matrix.abs().max().item())


@pytest.mark.parametrize("name", COLORED)
def test_closed_derivatives_are_forward_modes(name):
    """What a lobe says of itself, beside what `Lobe` works out for any lobe."""
    kind, pairs = LOBES[name], problem(1, True, False).pairs
    part = model_of(name, 3).components()[1]
    scalars = [getattr(part, bounded.name).detach() for bounded in kind.scalars()]
    own = kind.value_and_jacobian(pairs, *scalars)
    general = Lobe.value_and_jacobian.__func__(kind, pairs, *scalars)
    assert len(own) == len(general) == 1 + len(scalars)
    for one, other in zip(own, general, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ANALYTIC)
def test_slopes_of_a_loss(name):
    """Those of its two halves are autograd's, and the parabola is nowhere below the penalty."""
    loss, given = LOSSES[name](), problem(2, True, False)
    values = given.target.clone()
    values[:, :5] *= -0.1
    values.requires_grad_()
    encoded, rate = loss.encode_slope(values, given.pairs)
    torch.testing.assert_close(encoded, loss.encode(values, given.pairs))
    (expected,) = torch.autograd.grad(loss.encode(values, given.pairs).sum(), values)
    torch.testing.assert_close(rate.expand_as(expected), expected, rtol=1e-6, atol=1e-12)

    d = torch.linspace(-3, 3, 41, dtype=torch.float64)[None, :, None].requires_grad_()
    width = torch.tensor([[[0.01]]], dtype=torch.float64) if loss.rounding[0] is not None else None
    penalty, slope, curve = loss.penalty_slope(d, width)
    (expected,) = torch.autograd.grad(penalty.sum(), d)
    torch.testing.assert_close(slope, expected)
    other = torch.linspace(-4, 4, 81, dtype=torch.float64)[None, None, :]
    parabola = penalty + slope * (other - d) + 0.5 * curve * (other - d) ** 2
    assert (parabola >= loss.penalty_slope(other, width)[0] - 1e-12).all()


def test_the_last_rounding_hardly_changes_an_error():
    loss, given = CubeRootLoss(), problem(1, True, False, 3000)
    data = Data(given, loss)
    difference = loss.encode(1.3 * given.target, given.pairs) - loss.encode(given.target, given.pairs)
    width = (loss.rounding[-1] * data.spread)[:, None, None]
    rounded = loss.penalty_slope(difference, width)[0].mean() - width.item() ** (2 / 3)
    exact = loss.penalty(difference).mean()
    assert (rounded / exact - 1).abs() < 0.05
    assert (loss.penalty_slope(difference, width)[0].mean() / exact - 1).abs() < 2e-3  # the error's by half of that


def test_where_it_does_not_apply():
    assert applies(Sum(Lambert(), LOBES["ward"]()), LOSSES["rms"]())
    assert not applies(Sum(Lambert(), LOBES["distribution_based"]()), LOSSES["rms"]())
