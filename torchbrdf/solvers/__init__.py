"""Solvers for many small bounded problems at once. They know objectives, and nothing of what these are about."""

from torchbrdf.solvers.bounded_qp import solve_bounded_qp
from torchbrdf.solvers.lbfgs import minimize_lbfgs
from torchbrdf.solvers.levenberg_marquardt import minimize_levenberg_marquardt
from torchbrdf.solvers.projected_newton import minimize_projected_newton
from torchbrdf.solvers.status import FirstOrder, Objective, SecondOrder, Solution, Status

__all__ = [
    "FirstOrder",
    "Objective",
    "SecondOrder",
    "Solution",
    "Status",
    "minimize_lbfgs",
    "minimize_levenberg_marquardt",
    "minimize_projected_newton",
    "solve_bounded_qp",
]
