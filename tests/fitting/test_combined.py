"""A metric and a picture in one loss: what it adds up, what it refuses, its objective, and fits under it."""

import copy
import pickle
from dataclasses import replace

import pytest
import torch
from helpers.painted import MATERIALS, Painted
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.fitting import FitResult, Status, fit
from torchbrdf.fitting.objective import make_objective
from torchbrdf.fitting.objective.autograd import AutogradObjective
from torchbrdf.fitting.objective.combined import CombinedObjective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.lobes import make_model
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.losses import CombinedLoss, CompressedLoss, Loss, Problem, RMSLoss, make_loss
from torchbrdf.measured import load, standins
from torchbrdf.measured.measured import Measured
from torchbrdf.render import RenderedLoss, Scene, small_scene, sphere

# One of each kind: a root of squares, a cusp, absolute terms of averages; a mean length, a root, and neither.
KINDS = [("compressed", "delta_e76"), ("cube_root", "log_hdr"), ("learned", "delta_e76"), ("log", "psnr")]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(sphere(3), size=12, nodes=16, light_samples=16)


@pytest.fixture(scope="module")
def materials() -> Measured:
    """Two, on few pairs."""
    whole = load(standins())
    return whole.batch([5, 6], torch.arange(0, len(whole.pairs), 900)).within(80.0).to(dtype=torch.float64)


def combined(scene: Scene, metric: str = "compressed", difference: str = "delta_e76") -> CombinedLoss:
    return CombinedLoss(make_loss(metric), RenderedLoss(scene, difference), 0.1, reduction="none")


def with_weights(loss: Loss, measured: Measured) -> Problem:
    """A problem in which a part of the measured pairs counts."""
    problem = loss.problem(measured)
    weight = torch.ones(2, len(problem.pairs), 1, dtype=torch.float64)
    weight[1, : len(measured.pairs) : 3] = 0
    return replace(problem, weight=weight)


def predicted(problem: Problem, model: torch.nn.Module | None = None) -> Tensor:
    with torch.no_grad():
        found: Tensor = (model or make_model("ward", 2, dtype=torch.float64))(problem.pairs)
    return found.expand_as(problem.target)


@pytest.mark.parametrize(("metric", "difference"), KINDS)
def test_it_is_the_sum_of_both(scene, materials, metric, difference) -> None:
    loss = combined(scene, metric, difference)
    problem = with_weights(loss, materials)
    prediction, count = predicted(problem), len(materials.pairs)
    assert len(problem.pairs) == count + len(scene.pairs)
    one = make_loss(metric, "none").error(
        prediction[:, :count], materials.values, materials.pairs, problem.weight[:, :count]
    )
    seen = loss.rendered.problem(materials)
    other = loss.rendered.error(prediction[:, count:], seen.target)
    found = loss(prediction, problem.target, problem.pairs, problem.weight)
    torch.testing.assert_close(found, one + 0.1 * other, rtol=1e-9, atol=0)
    assert bool((found > one).all()) and bool((found > 0.1 * other).all())
    mean = CombinedLoss(loss.loss, loss.rendered, 0.1)(prediction, problem.target, problem.pairs, problem.weight)
    torch.testing.assert_close(mean, found.mean())
    same = problem.target.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(same, problem.target, problem.pairs).sum(), same)
    assert bool(gradient.isfinite().all())


def test_some_of_the_measured_pairs_and_the_whole_picture(scene, materials) -> None:
    loss, index = combined(scene), torch.tensor([7, 3, 100])
    problem, part = loss.problem(materials), loss.problem(materials, index)
    some = loss.select(problem, index)
    torch.testing.assert_close(some.target, part.target)
    for name, value in some.pairs.items():
        torch.testing.assert_close(value, getattr(part.pairs, name))
    expected = loss.problem(materials.batch(samples=index))
    torch.testing.assert_close(some.target, expected.target)


def test_copies_and_names(scene, materials) -> None:
    loss = combined(scene, "learned", "log_hdr")
    assert loss.registered_name == "learned+rendered_log_hdr" and loss.scene_summary == scene.summary
    problem = loss.problem(materials)
    prediction = predicted(problem)
    expected = loss(prediction, problem.target, problem.pairs)
    for same in (copy.deepcopy(loss), pickle.loads(pickle.dumps(loss))):
        assert torch.equal(same(prediction, problem.target, problem.pairs), expected)


def test_what_is_wrong_is_said(scene, materials) -> None:
    rendered = RenderedLoss(scene)
    for factor in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match="factor: expected a number above 0"):
            CombinedLoss(CompressedLoss(), rendered, factor)
    with pytest.raises(UsageError, match="loss: expected one of BRDF values, found rendered_delta_e76"):
        CombinedLoss(rendered, rendered)
    with pytest.raises(UsageError, match="rendered: expected a loss of pictures, found compressed"):
        CombinedLoss(CompressedLoss(), CompressedLoss())  # type: ignore[arg-type]
    loss = combined(scene)
    values = torch.ones(1, 5, 3, dtype=torch.float64)
    with pytest.raises(ShapeError, match=r"expected more than the scene's \d+ pairs, found 5; loss.problem"):
        loss(values, values, materials.pairs.select(samples=slice(5)))
    with pytest.raises(ShapeError, match="needs the pairs of its problem"):
        CombinedLoss(RMSLoss(), rendered)(values, values)


@pytest.mark.parametrize(("metric", "difference"), KINDS)
def test_derivatives_by_responses_are_those_of_the_graph(scene, materials, metric, difference) -> None:
    loss, model = combined(scene, metric, difference), make_model("ward", 2, dtype=torch.float64).batched(2)
    problem, rows = with_weights(loss, materials), torch.tensor([1, 0])
    objective = make_objective(model, problem, loss)
    assert isinstance(objective, CombinedObjective)
    held, free = get_parameters(model), Parametrization(model, free_parameters(model, [0, 1, 2]))
    x = free.encode(held)[rows]
    bound, graph = objective.bind(free, held), AutogradObjective(problem, loss).bind(free, held)
    expected = graph.value_and_gradient(x, rows)
    for one, other in zip(bound.value_and_gradient(x, rows), expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-9)
    *both, matrix = bound.quadratic_model(x, rows)
    for one, other in zip(both, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-9)
    assert torch.linalg.eigvalsh(matrix).min() > -1e-9 * matrix.abs().max()


def fitted(measured: Measured, loss: Loss, model: str = "ward", **settings: int) -> FitResult:
    return fit(make_model(model, 1), measured, loss, diffuse="fit", samples=500, **settings)


@pytest.mark.parametrize(("metric", "difference"), KINDS)
def test_a_fit_is_nearer_under_it_than_either_parts(scene, materials, metric, difference) -> None:
    measured = materials.to(dtype=torch.float32)
    loss = combined(scene, metric, difference)
    results = [fitted(measured, one) for one in (loss, loss.loss, loss.rendered)]
    problem = loss.problem(measured)
    with torch.no_grad():
        own, *others = (
            loss.error(one.model(problem.pairs), problem.target, problem.pairs, problem.weight) for one in results
        )
    torch.testing.assert_close(results[0].error, own, rtol=1e-4, atol=0)
    assert results[0].status == [Status.CONVERGED] * 2 and results[0].samples == 500
    for other in others:
        assert bool((own < other * (1 + 1e-4)).all())


def test_a_metric_without_derivatives_of_its_own_is_fitted_too(scene, materials) -> None:
    class Cubes(Loss):
        def error(self, prediction, target, pairs=None, weight=None):
            return (prediction - target).abs().pow(3).mean((-2, -1)).double()

    loss = CombinedLoss(Cubes(), RenderedLoss(scene))
    with pytest.warns(UserWarning, match="no derivatives of its own"):
        result = fitted(materials, loss, max_iterations=5)
    assert result.loss == "Cubes+rendered_delta_e76" and bool(result.error.isfinite().all())


def test_a_model_that_is_not_linear_in_colours_is_fitted_too(scene, materials) -> None:
    result = fitted(materials.batch([0]), combined(scene), "distribution_based", max_iterations=5)
    assert bool(result.error.isfinite().all())


def test_a_small_scene_shows_what_a_full_one_does() -> None:
    """In a sixth of the pairs, or fewer: the error of one material as another's picture is nearly the same."""
    measured = Measured(Painted([make_model("ward", 1), *MATERIALS.values()]))
    full, small = Scene(sphere(), size=16), small_scene(sphere(), size=16)
    assert len(small.pairs) < len(full.pairs) / 5
    errors = []
    for place in (full, small):
        loss = RenderedLoss(place, reduction="none")
        target = loss.problem(measured).target
        errors.append(loss.error(target[:1].expand(len(target) - 1, -1, -1), target[1:]))
    torch.testing.assert_close(errors[0], errors[1], rtol=0.03, atol=0)
