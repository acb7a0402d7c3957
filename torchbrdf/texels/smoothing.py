"""Fits that are pulled to their neighbours' parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
    starts: Sequence[Tensor],
    mean: Tensor,
    strength: Tensor,
    *,
    max_iterations: int,
    ftol: float,
) -> Solution:
    """Minimise an objective with a pull to `mean`, from one or more starts `(m, P)`; the best of them.

    values: all parameters. The solution's values are the objective's errors, without the pull.
    """
    lower, upper = (bound.to(mean.device) for bound in free.limits())
    share = objective.loss.smoothing_widths[-1]
    width = None if share is None else share * objective.target_scale
    bound = objective.bind(free, values, None, width)
    pulled = Pulled(bound, mean, strength, upper - lower)
    best: Solution | None = None
    for start in starts:
        found = minimize_levenberg_marquardt(
            pulled, start, lower, upper, max_iterations=max_iterations, ftol=ftol, fmin=objective.fmin
        )
        best = found if best is None else _better(best, found)
    assert best is not None
    value, _ = bound.value_and_gradient(best.x, objective.material_indices)
    return replace(best, value=objective.loss.finalize(value * objective.zero_prediction_error))


def _better(one: Solution, two: Solution) -> Solution:
    """Of each problem the solution with the lower value."""
    second = two.value < one.value
    return Solution(
        torch.where(second[:, None], two.x, one.x),
        torch.where(second, two.value, one.value),
        [b if pick else a for a, b, pick in zip(one.status, two.status, second.tolist(), strict=True)],
        one.iterations + two.iterations,
    )
