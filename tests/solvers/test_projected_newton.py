"""Projected Newton steps against the exact solver of small bounded problems."""

import pytest
import torch

from torchbrdf.errors import ShapeError
from torchbrdf.solvers import Status, minimize_projected_newton, solve_bounded_qp


class Parabolas:
    def __init__(self, materials=5, size=8):
        generator = torch.Generator().manual_seed(0)
        root = torch.randn(materials, size, size, generator=generator, dtype=torch.float64)
        self.matrix = root @ root.mT + 0.1 * torch.eye(size, dtype=torch.float64)
        self.slope = torch.randn(materials, size, generator=generator, dtype=torch.float64)

    def quadratic_model(self, x, rows):
        matrix, slope = self.matrix[rows], self.slope[rows]
        pull = (matrix @ x[..., None])[..., 0]
        return 5 + (slope * x).sum(1) + 0.5 * (pull * x).sum(1), slope + pull, matrix


def test_the_least_within_bounds():
    parabolas = Parabolas()
    low, high = torch.full((8,), -0.2, dtype=torch.float64), torch.full((8,), 0.3, dtype=torch.float64)
    found = minimize_projected_newton(parabolas, torch.zeros(5, 8, dtype=torch.float64), low, high, ftol=1e-14)
    exact = solve_bounded_qp(*(x.numpy() for x in (parabolas.matrix, parabolas.slope, low, high)))
    assert found.status == [Status.CONVERGED] * 5
    torch.testing.assert_close(found.x, torch.from_numpy(exact), rtol=0, atol=1e-4)


def test_what_is_not_finite_ends_alone():
    class Broken(Parabolas):
        def quadratic_model(self, x, rows):
            value, *rest = super().quadratic_model(x, rows)
            return torch.where(rows == 1, torch.nan, value), *rest

    ones = torch.ones(8, dtype=torch.float64)
    found = minimize_projected_newton(Broken(), 0 * ones.expand(5, 8), -ones, ones)
    assert found.status[1] == Status.NOT_FINITE and found.status.count(Status.CONVERGED) == 4


def test_bounds_the_wrong_way_round():
    one = torch.ones(8, dtype=torch.float64)
    with pytest.raises(ShapeError, match="a lower bound is above its upper bound"):
        minimize_projected_newton(Parabolas(), one.expand(5, 8), one, -one)
