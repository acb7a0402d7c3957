"""The batched solver beside scipy's L-BFGS-B, on the same bounded problems."""

import numpy as np
import pytest
import torch
from helpers.objectives import FromFunction
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize as scipy_minimize

from torchbrdf.errors import ShapeError
from torchbrdf.solvers import Status, minimize_lbfgs


def rosenbrock(x, rows):
    """Sum of 100 (b - a^2)^2 + (1 - a)^2, shifted for each problem; values and gradients."""
    x = x.detach().requires_grad_()
    y = x - 0.01 * rows[:, None]
    value = (100 * (y[:, 1:] - y[:, :-1] ** 2) ** 2 + (1 - y[:, :-1]) ** 2).sum(-1)
    (gradient,) = torch.autograd.grad(value.sum(), x)
    return value.detach(), gradient


def quadratics(count, size, seed):
    """Strictly convex quadratics, so that each has one minimum within its box; some bounds are active."""
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(count, size, size, generator=generator, dtype=torch.float64)
    matrix = root @ root.transpose(1, 2) + 0.05 * torch.eye(size, dtype=torch.float64)
    vector = 3 * torch.randn(count, size, generator=generator, dtype=torch.float64)
    lower = -torch.rand(count, size, generator=generator, dtype=torch.float64)
    upper = torch.rand(count, size, generator=generator, dtype=torch.float64)

    def objective(x, rows):
        along = (matrix[rows] @ x[..., None])[..., 0]
        return 0.5 * (x * along).sum(-1) + (vector[rows] * x).sum(-1), along + vector[rows]

    return objective, lower, upper


def scipy_solution(objective, k, start, lower, upper):
    def one(x):
        value, gradient = objective(torch.from_numpy(x)[None], torch.tensor([k]))
        return value.item(), gradient[0].numpy()

    box = list(zip(lower.tolist(), upper.tolist(), strict=True))
    options = {"ftol": 1e-15, "gtol": 1e-9, "maxiter": 2000}
    return scipy_minimize(one, start.numpy(), jac=True, method="L-BFGS-B", bounds=box, options=options)


def test_two_hundred_bounded_problems_end_where_scipy_does():
    objective, lower, upper = quadratics(200, 6, seed=1)
    start = torch.zeros_like(lower)
    found = minimize_lbfgs(FromFunction(objective), start, lower, upper)
    assert set(found.status) == {Status.CONVERGED}
    expected = [scipy_solution(objective, k, start[k], lower[k], upper[k]) for k in range(200)]
    np.testing.assert_allclose(found.value.numpy(), [e.fun for e in expected], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found.x.numpy(), np.stack([e.x for e in expected]), atol=2e-3)
    assert ((found.x == lower) | (found.x == upper)).any(1).float().mean() > 0.5  # bounds did matter


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.integers(1, 8))
def test_no_problem_ends_above_scipy(seed, size):
    objective, lower, upper = quadratics(5, size, seed)
    found = minimize_lbfgs(FromFunction(objective), torch.zeros_like(lower), lower, upper)
    for k in range(5):
        expected = scipy_solution(objective, k, torch.zeros(size, dtype=torch.float64), lower[k], upper[k])
        assert found.value[k].item() <= expected.fun + 1e-6 * abs(expected.fun) + 1e-9
    assert ((found.x >= lower) & (found.x <= upper)).all()


def test_a_curved_valley():
    start = torch.tensor([[-1.2, 1.0]] * 4, dtype=torch.float64)
    lower, upper = torch.full((2,), -5.0, dtype=torch.float64), torch.full((2,), 5.0, dtype=torch.float64)
    found = minimize_lbfgs(FromFunction(rosenbrock), start, lower, upper)
    assert set(found.status) == {Status.CONVERGED}
    minimum = 1 + 0.01 * torch.arange(4.0, dtype=torch.float64)[:, None]
    torch.testing.assert_close(found.x, minimum.expand(4, 2), atol=1e-3, rtol=0)


def test_problems_do_not_disturb_each_other():
    objective, lower, upper = quadratics(9, 4, seed=3)
    together = minimize_lbfgs(FromFunction(objective), torch.zeros_like(lower), lower, upper)

    def alone(x, rows):
        return objective(x, rows + 4)

    single = minimize_lbfgs(FromFunction(alone), torch.zeros(1, 4, dtype=torch.float64), lower[4:5], upper[4:5])
    assert torch.equal(together.x[4], single.x[0])
    assert together.iterations[4] == single.iterations[0]


def test_a_bad_problem_says_so_and_the_others_converge():
    objective, lower, upper = quadratics(3, 4, seed=5)

    def broken(x, rows):
        value, gradient = objective(x, rows)
        return torch.where(rows == 1, torch.nan, value), gradient

    found = minimize_lbfgs(FromFunction(broken), torch.zeros_like(lower), lower, upper)
    assert found.status == [Status.CONVERGED, Status.NOT_FINITE, Status.CONVERGED]
    assert torch.equal(found.x[1], torch.zeros(4, dtype=torch.float64))


def test_a_problem_without_descent_is_stalled_not_converged():
    def uphill(x, rows):
        return x[:, 0] ** 2 + 1, torch.full_like(x, -1.0)  # a gradient that is wrong at the minimum

    bound = torch.ones(1, dtype=torch.float64)
    found = minimize_lbfgs(FromFunction(uphill), torch.zeros(1, 1, dtype=torch.float64), -bound, bound)
    assert found.status == [Status.STALLED]


def test_an_unfinished_problem_says_so():
    bound = torch.full((2,), 5.0, dtype=torch.float64)
    start = torch.tensor([[-1.2, 1.0]], dtype=torch.float64)
    assert minimize_lbfgs(FromFunction(rosenbrock), start, -bound, bound, max_iterations=3).status == [
        Status.MAX_ITERATIONS
    ]


def test_crossed_bounds_are_refused():
    one = torch.ones(1, 2, dtype=torch.float64)
    with pytest.raises(ShapeError, match="lower bound is above"):
        minimize_lbfgs(FromFunction(rosenbrock), one, one, -one)
