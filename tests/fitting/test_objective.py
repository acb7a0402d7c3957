"""Objectives: derivatives without a graph against autograd, for every lobe and every loss."""

import itertools

import pytest
import torch
from helpers.directions import hemisphere
from helpers.known_models import COLORED

from torchbrdf.errors import UsageError
from torchbrdf.fitting.objective import GaussNewtonObjective, make_objective
from torchbrdf.fitting.objective.autograd import AutogradObjective
from torchbrdf.fitting.objective.pointwise import PointwiseObjective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.lobes import LOBES, Lambert, Lobe, Sum, make_model
from torchbrdf.lobes.parameter_dict import get_parameters, named_specs, take_materials, with_parameters
from torchbrdf.losses import LOSSES, CosineRMSLoss, CubeRootLoss, Problem, RMSLoss, derivatives
from torchbrdf.pairs import Pairs

FREE_KINDS = ("all", "scalar", "colors")
# Every lobe with two losses, every loss with several lobes: an objective knows a lobe by its values and derivatives.
# Each with everything else by turns: kinds of parameters, shared pairs, weights.
COMBINED = [
    (lobe, [*LOSSES][(i + j) % len(LOSSES)], FREE_KINDS[(i + j) % 3], bool((i + j // 3) % 2), bool((i // 2 + j) % 2))
    for (i, lobe), j in itertools.product(enumerate(COLORED), (0, 3))
]


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
        for key, spec in part.parameter_specs.items():
            u = 0.3 + 0.4 * torch.rand(materials, spec.size, generator=generator, dtype=torch.float64)
            low, high = torch.tensor([spec.lower, spec.upper]).double()
            value = (low.log() + u * (high / low).log()).exp() if spec.log else low + u * (high - low)
            getattr(part, key).data = value.reshape(materials, *spec.shape)
    return model


def parametrization(model, kind):
    """All parameters; a scalar albedo for one lobe alone; colours with the shapes held."""
    if kind == "scalar":
        return Parametrization(model, free_parameters(model, [1], scalar_albedo=True), [0, 1])
    free = free_parameters(model, [0, 1, 2] if kind == "all" else [1, 2])
    return Parametrization(model, free if kind == "all" else [one for one in free if one.spec.linear])


@pytest.mark.parametrize(("name", "loss_name", "kind", "shared", "weighted"), COMBINED)
def test_value_and_gradient_are_autograds(name, loss_name, kind, shared, weighted):
    given, loss, model = problem(3, shared, weighted), LOSSES[loss_name](), model_of(name, 3)
    free = parametrization(model, kind)
    objective = make_objective(model, given, loss)
    assert isinstance(objective, GaussNewtonObjective)
    rows = torch.tensor([2, 0])  # some of the problems, in another order; problem 2 is material 0
    materials = torch.tensor([1, 2, 0])
    own = take_materials(get_parameters(model), materials)
    bound = objective.bind(free, own, materials)
    x = free.encode(own)[rows]
    value, gradient, matrix = bound.quadratic_model(x, rows)

    point = x.clone().requires_grad_()
    chosen = materials[rows]
    here = take_materials(get_parameters(model), chosen) | free.decode(point, torch.float64)
    pairs = given.pairs.select(chosen)
    weight = None if given.weight is None else given.weight[chosen]
    error = loss.error(free.predict(here, pairs).expand(2, -1, 3), given.target[chosen], pairs, weight)
    expected = (error.square() if loss.is_root else error) / objective.zero_prediction_error[chosen]
    (slope,) = torch.autograd.grad(expected.sum(), point)
    torch.testing.assert_close(value, expected.detach(), rtol=1e-7, atol=0)
    torch.testing.assert_close(gradient, slope, rtol=1e-6, atol=1e-9 * slope.abs().max().item())
    assert (torch.linalg.eigvalsh(matrix) > -1e-9 * matrix.abs().amax()).all()
    assert torch.equal(bound.value_and_gradient(x, rows)[1], gradient)

    general = AutogradObjective(given, loss)
    torch.testing.assert_close(general.zero_prediction_error, objective.zero_prediction_error)
    for one, other in zip(
        general.bind(free, own, materials).value_and_gradient(x, rows), (expected, slope), strict=True
    ):
        torch.testing.assert_close(one, other.detach(), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("name", "loss_name"), [(one, ("compressed", "log")[k % 2]) for k, one in enumerate(COLORED)])
def test_the_matrix_is_the_hessian_of_a_least_squares_loss_at_an_exact_fit(name, loss_name):
    loss, model = LOSSES[loss_name](), model_of(name, 1)
    given = problem(1, True, False)
    given = Problem(given.pairs, model(given.pairs).detach())
    values, free, one = get_parameters(model), parametrization(model, "all"), torch.tensor([0])
    bound = make_objective(model, given, loss).bind(free, values)
    x = free.encode(values)
    _, _, matrix = bound.quadratic_model(x, one)
    step = 1e-5
    columns = []
    for k in range(x.shape[1]):
        along = torch.zeros_like(x)
        along[0, k] = step
        ends = [bound.value_and_gradient(x + sign * along, one)[1][0] for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * step))
    torch.testing.assert_close(matrix[0], torch.stack(columns), rtol=1e-3, atol=1e-5 * matrix.abs().max().item())


@pytest.mark.parametrize("name", ["ward", "cook_torrance"])
def test_the_matrix_of_the_learned_metric_is_the_hessian_of_it_rounded_at_an_exact_fit(name):
    loss, model = LOSSES["learned"](), model_of(name, 2)
    given = problem(2, True, True)
    given = Problem(given.pairs, model(given.pairs).detach(), given.weight)
    values, free, one = get_parameters(model), parametrization(model, "all"), torch.tensor([1])
    width = torch.full((2,), 0.05, dtype=torch.float64)
    bound = make_objective(model, given, loss).bind(free, values, width=width)
    x = free.encode(values)[1:]
    _, _, matrix = bound.quadratic_model(x, one)
    columns = []
    for k in range(x.shape[1]):
        along = torch.zeros_like(x)
        along[0, k] = 1e-5
        ends = [bound.quadratic_model(x + sign * along, one)[1][0] for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / 2e-5)
    torch.testing.assert_close(matrix[0], torch.stack(columns), rtol=1e-3, atol=1e-5 * matrix.abs().max().item())


@pytest.mark.parametrize("name", COLORED)
def test_closed_derivatives_are_forward_modes(name):
    """What a lobe says of itself, beside what `Lobe` works out for any lobe."""
    kind, pairs = LOBES[name], problem(1, True, False).pairs
    part = model_of(name, 3).components()[1]
    scalars = [getattr(part, spec.name).detach() for spec in kind.scalars()]
    own = kind.value_and_jacobian(pairs, *scalars)
    general = Lobe.value_and_jacobian.__func__(kind, pairs, *scalars)
    assert len(own) == len(general) == 1 + len(scalars)
    for one, other in zip(own, general, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", LOSSES)
def test_derivatives_of_a_loss(name):
    """Those of its two halves are autograd's, and the parabola is nowhere below the penalty."""
    loss, given = LOSSES[name](), problem(2, True, False)
    assert loss.has_closed_derivatives
    values = given.target.clone()
    values[:, :5] *= -0.1
    encoded, rate = loss.encode_with_derivative(values, given.pairs)
    code, expected = derivatives.derivative_of(lambda point: loss.encode(point, given.pairs), values)
    torch.testing.assert_close(encoded, code)
    torch.testing.assert_close(rate.expand_as(expected), expected, rtol=1e-6, atol=1e-12)

    d = torch.linspace(-3, 3, 41, dtype=torch.float64)[None, :, None].requires_grad_()
    width = torch.tensor([[[0.01]]], dtype=torch.float64) if loss.smoothing_widths[0] is not None else None
    penalty, slope, curve = loss.penalty_with_derivatives(d, width)
    (expected,) = torch.autograd.grad(penalty.sum(), d)
    torch.testing.assert_close(slope, expected)
    other = torch.linspace(-4, 4, 81, dtype=torch.float64)[None, None, :]
    parabola = penalty + slope * (other - d) + 0.5 * curve * (other - d) ** 2
    assert (parabola >= loss.penalty_with_derivatives(other, width)[0] - 1e-12).all()
    general = derivatives.penalty_with_derivatives(loss, d.detach(), width)
    for one, closed in zip(general, (penalty, slope, curve), strict=True):
        torch.testing.assert_close(one, closed.detach().expand_as(one), rtol=1e-6, atol=1e-9)


def test_the_last_smoothing_hardly_changes_an_error():
    loss, given = CubeRootLoss(), problem(1, True, False, 3000)
    objective = PointwiseObjective(given, loss)
    difference = loss.encode(1.3 * given.target, given.pairs) - loss.encode(given.target, given.pairs)
    width = (loss.smoothing_widths[-1] * objective.target_scale)[:, None, None]
    rounded = loss.penalty_with_derivatives(difference, width)[0].mean() - width.item() ** (2 / 3)
    exact = loss.penalty(difference).mean()
    assert (rounded / exact - 1).abs() < 0.05
    assert (
        loss.penalty_with_derivatives(difference, width)[0].mean() / exact - 1
    ).abs() < 2e-3  # the error's half that


def test_which_objective_it_is():
    """The loss's own; by autograd for a model that is no sum of colours times scalars, or where a loss changes more."""

    class Other(RMSLoss):
        def error(self, prediction, target, pairs=None, weight=None):
            return super().error(prediction, target, pairs, weight) + 1

    class Lightness(CosineRMSLoss):
        def encode(self, values, pairs):
            return super().encode(values, pairs).mean(-1, keepdim=True).expand(*values.shape)

    class Misspelt(RMSLoss):
        objective = "pointwize"

    given, ward = problem(1, True, False), make_model("ward", 1)
    assert type(make_objective(ward, given, RMSLoss())) is PointwiseObjective
    assert type(make_objective(Sum(Lambert(), LOBES["distribution_based"]()), given, RMSLoss())) is AutogradObjective
    for loss in (Other(), Lightness()):
        assert type(make_objective(ward, given, loss)) is AutogradObjective
    with pytest.raises(UsageError, match=r"^Misspelt.objective: expected one of .*, found 'pointwize'$"):
        make_objective(ward, given, Misspelt())


# --- parameters ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in LOBES if name != "lambert"])
def test_a_vector_is_the_parameters_and_back(name):
    """Of every lobe: by the model's own names, within bounds, as the module itself evaluates them."""
    model = model_of(name, 3)
    assert set(named_specs(model)) == {key for key, _ in model.named_parameters()}
    values, free = get_parameters(model), parametrization(model, "all")
    x = free.encode(values)
    low, high = free.limits()
    assert x.dtype == torch.float64 and x.shape == (3, len(low)) and ((low < x) & (x < high)).all()
    again = free.decode(x, torch.float64)
    assert set(again) == set(values)
    for key, value in values.items():
        torch.testing.assert_close(again[key], value, rtol=1e-12, atol=0)
    pairs = problem(1, True, False).pairs
    torch.testing.assert_close(free.predict(again, pairs), model(pairs), rtol=1e-9, atol=0)
    part = with_parameters(model, take_materials(values, [2]))
    torch.testing.assert_close(part(pairs), model(pairs)[2:], rtol=1e-12, atol=0)
    assert torch.equal(model.components()[1](pairs), with_parameters(model, values).components()[1](pairs))


def test_some_components_and_one_number_for_a_colour():
    model = model_of("ward", 2)
    free = parametrization(model, "scalar")
    values = get_parameters(model)
    gray_values = values | free.decode(free.encode(values), torch.float64)
    assert gray_values["lobes.1.specular"].shape == (2, 1)
    gray = with_parameters(model, gray_values)
    pairs = problem(1, True, False).pairs
    torch.testing.assert_close(
        free.predict(gray_values, pairs), gray.components()[0](pairs) + gray.components()[1](pairs)
    )


def test_a_lobe_alone_is_a_model():
    model = LOBES["ward"]().batched(2)
    free = Parametrization(model, free_parameters(model, [0]))
    assert list(named_specs(model)) == ["specular", "roughness"]
    pairs, values = problem(1, True, False).pairs.to(dtype=torch.float32), get_parameters(model)
    torch.testing.assert_close(free.predict(values, pairs), model(pairs))
