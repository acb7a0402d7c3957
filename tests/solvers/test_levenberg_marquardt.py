"""Levenberg-Marquardt beside scipy's solver, on the same bounded problems."""

import numpy as np
import pytest
import torch
from helpers.objectives import FromFunction
from scipy.optimize import least_squares

from torchbrdf.errors import ShapeError
from torchbrdf.solvers import Status, minimize_levenberg_marquardt


def curves(count, seed, samples=60):
    """a exp(-t / b) + c with bounds and noise: residuals `(count, samples)` of points `(count, 3)`."""
    random = np.random.default_rng(seed)
    t = np.linspace(0, 4, samples)
    truth = np.stack([random.uniform(0.5, 3, count), random.uniform(0.2, 3, count), random.uniform(-0.5, 1, count)], 1)
    data = truth[:, :1] * np.exp(-t / truth[:, 1:2]) + truth[:, 2:] + 0.05 * random.normal(size=(count, samples))
    lower, upper = np.array([0.0, 0.1, 0.0]), np.array([2.0, 2.0, 2.0])  # many truths are outside

    def residual(x, k):
        return x[0] * np.exp(-t / x[1]) + x[2] - data[k]

    def objective(x, rows):
        x, rows = x.numpy(), rows.numpy()
        decay = np.exp(-t / x[:, 1:2])
        r = x[:, :1] * decay + x[:, 2:] - data[rows]
        jacobian = np.stack([decay, x[:, :1] * decay * t / x[:, 1:2] ** 2, np.ones_like(decay)], -1)
        parts = (
            (r**2).sum(1),
            2 * np.einsum("kn,knp->kp", r, jacobian),
            2 * np.einsum("knp,knq->kpq", jacobian, jacobian),
        )
        return tuple(torch.from_numpy(part) for part in parts)

    return objective, residual, lower, upper


def test_three_hundred_bounded_problems_end_where_scipy_does():
    objective, residual, lower, upper = curves(300, 1)
    start = torch.tensor([[1.0, 1.0, 0.5]], dtype=torch.float64).expand(300, 3)
    found = minimize_levenberg_marquardt(
        FromFunction(objective), start, torch.from_numpy(lower), torch.from_numpy(upper), ftol=1e-12
    )
    assert set(found.status) == {Status.CONVERGED}
    for k in range(300):
        expected = least_squares(residual, start[k].numpy(), bounds=(lower, upper), args=(k,), xtol=1e-12, ftol=1e-12)
        assert found.value[k].item() <= 2 * expected.cost * (1 + 1e-6)
    held = (found.x.numpy() <= lower + 1e-9) | (found.x.numpy() >= upper - 1e-9)
    assert held.any(1).mean() > 0.3  # bounds did matter


def test_a_problem_does_not_depend_on_its_batch_mates():
    objective, _, lower, upper = curves(12, 2)
    start = torch.tensor([[1.0, 1.0, 0.5]], dtype=torch.float64).expand(12, 3)
    box = torch.from_numpy(lower), torch.from_numpy(upper)
    together = minimize_levenberg_marquardt(FromFunction(objective), start, *box)
    for k in (0, 5, 11):
        alone = minimize_levenberg_marquardt(FromFunction(lambda x, rows, k=k: objective(x, rows + k)), start[:1], *box)
        torch.testing.assert_close(alone.x[0], together.x[k], rtol=0, atol=1e-12)


def test_each_problem_says_how_it_ended():
    """A parabola, one that is nowhere finite, one whose gradient lies, and one that needs more iterations."""

    def objective(x, rows):
        value, gradient = (x**2).sum(-1), 2 * x
        value[rows == 1] = torch.nan
        gradient[rows == 2] *= -1
        matrix = 2 * torch.eye(2, dtype=x.dtype).expand(len(x), 2, 2).clone()
        matrix[rows == 3] *= 1e4
        return value, gradient, matrix

    start = torch.ones(4, 2, dtype=torch.float64)
    bound = torch.full((2,), 5.0, dtype=torch.float64)
    found = minimize_levenberg_marquardt(FromFunction(objective), start, -bound, bound, max_iterations=60)
    assert found.status[:3] == [Status.CONVERGED, Status.NOT_FINITE, Status.STALLED]
    assert found.status[3] in (Status.MAX_ITERATIONS, Status.CONVERGED)
    torch.testing.assert_close(found.x[0], torch.zeros(2, dtype=torch.float64), atol=1e-4, rtol=0)
    assert torch.equal(found.x[2], start[2])
    few = minimize_levenberg_marquardt(FromFunction(objective), start, -bound, bound, max_iterations=2)
    assert few.status[3] == Status.MAX_ITERATIONS


def test_a_parabola_that_lies_above_is_made_flatter():
    """Reweighting: a majorizer of |x|^(2/3) with a small width promises far less than there is to gain."""

    def objective(x, rows):
        square = (x[:, 0] - 1) ** 2 + 1e-4
        curve = 2 / 3 * square ** (-2 / 3)
        return square ** (1 / 3), (curve * (x[:, 0] - 1))[:, None], curve[:, None, None]

    start, bound = torch.full((1, 1), 4.0, dtype=torch.float64), torch.full((1,), 9.0, dtype=torch.float64)
    found = minimize_levenberg_marquardt(FromFunction(objective), start, -bound, bound)
    assert found.status == [Status.CONVERGED] and found.iterations.item() < 30
    torch.testing.assert_close(found.x, torch.ones_like(found.x), atol=1e-3, rtol=0)


def test_bounds_the_wrong_way_round_are_refused():
    one = torch.ones(1, 1, dtype=torch.float64)
    with pytest.raises(ShapeError, match="lower bound is above"):
        minimize_levenberg_marquardt(FromFunction(lambda x, rows: (x[:, 0], x, x[..., None])), one, one, -one)


def test_a_value_that_is_as_good_as_0_is_a_minimum_even_where_no_step_is_better():
    """A gradient of rounding errors, as at an exact fit in single precision."""

    def objective(x, rows):
        value = torch.where(rows == 0, 1e-11, 1e-9).double()
        return value, torch.full_like(x, 1e-5), torch.ones_like(x)[..., None]

    zero, bound = torch.zeros(2, 1, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    found = minimize_levenberg_marquardt(FromFunction(objective), zero, -bound, bound, fmin=1e-10)
    assert found.status == [Status.CONVERGED, Status.STALLED]
