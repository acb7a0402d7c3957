"""Fits that are pulled to their neighbours' parameters."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.fitting.objective import GaussNewtonObjective
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.solvers import SecondOrder, Solution, minimize_levenberg_marquardt


@dataclass(frozen=True)
class Pulled:
    """An objective with sum_p strength (x_p - mean_p)^2 / range_p^2 beside.

    Args:
        objective: of R problems.
        mean: to which each is pulled, `(R, P)`.
        strength: `(R,)`.
        extent: how far apart the bounds of each number are, `(P,)`.
    """

    objective: SecondOrder
    mean: Tensor
    strength: Tensor
    extent: Tensor

    def quadratic_model(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix."""
        value, gradient, matrix = self.objective.quadratic_model(x, rows)
        off = x - self.mean[rows]
        weight = self.strength[rows, None] / self.extent.square()
        pulled = weight * off
        return (
            value + (pulled * off).sum(-1),
            gradient + 2 * pulled,
            matrix + torch.diag_embed(2 * weight),
        )


def smoothed_fit(
    objective: GaussNewtonObjective,
    values: ParameterDict,
    free: Parametrization,
    mean: Tensor,
    strength: Tensor,
    *,
    max_iterations: int,
    ftol: float,
) -> Solution:
    """Minimise an objective with a pull to `mean`, from `values`; the solution's values are the objective's errors."""
    lower, upper = free.limits()
    share = objective.loss.smoothing_widths[-1]
    width = None if share is None else share * objective.target_scale
    bound = objective.bind(free, values, None, width)
    pulled = Pulled(bound, mean, strength, upper - lower)
    found = minimize_levenberg_marquardt(
        pulled, free.encode(values), lower, upper, max_iterations=max_iterations, ftol=ftol, fmin=objective.fmin
    )
    value, _ = bound.value_and_gradient(found.x, objective.material_indices)
    error = objective.loss.finalize(value * objective.zero_prediction_error)
    return Solution(found.x, error, found.status, found.iterations)
