"""Levenberg-Marquardt with bounds, for many problems at once."""

import numpy as np
import torch
from torch import Tensor

from torchbrdf.solvers.bounded_qp import Array, solve_bounded_qp
from torchbrdf.solvers.parabola import check_bounds, promise
from torchbrdf.solvers.status import RESOLUTION, SecondOrder, Solution, Status

MIN_DAMPING, MAX_DAMPING = 1e-9, 1e9
FLATTEST = 0.02


def minimize_levenberg_marquardt(
    objective: SecondOrder,
    start: Tensor,
    lower: Tensor,
    upper: Tensor,
    *,
    max_iterations: int = 100,
    ftol: float = 1e-8,
    fmin: float = 1e-12,
    damping: float = 1e-3,
) -> Solution:
    """Minimise M independent functions of P variables within bounds, each near enough to its own parabola.

    Each step goes to the least of the damped parabola within the bounds; each problem has its own damping and end, and
    those that have ended leave the batch. Where a parabola promises less than comes about, as one does that lies above
    the function, it is made flatter. A problem has converged when the undamped parabola promises no more than `ftol` of
    its value plus `fmin`, or when no step is better and it promises no more than 1e-6 of it, or the value is at most
    `fmin`; else it has stalled.

    Args:
        objective: values, gradients and matrices.
        start: where each problem begins, `(M, P)`, float64.
        lower: bounds, `(M, P)` or `(P,)`.
        upper: the same.
        max_iterations: steps of each problem at most.
        ftol: share of the value that is not worth another step.
        fmin: a value that is as good as 0.
        damping: at the start, in units of the matrix' diagonal.

    Returns:
        The best point of each problem.

    Raises:
        ShapeError: if a lower bound is above its upper bound.

    Source: K. Madsen, H. Nielsen, O. Tingleff, Methods for Non-linear Least Squares Problems, 2004, for the damping.

    Example:
        >>> class Parabola:
        ...     def quadratic_model(self, x, rows):
        ...         return (x - 2).square().sum(1), 2 * (x - 2), 2 * torch.ones_like(x)[..., None]
        >>> zero, one = torch.zeros(3, 1, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
        >>> minimize_levenberg_marquardt(Parabola(), zero, -one, one).x.flatten().tolist()
        [1.0, 1.0, 1.0]
    """
    check_bounds("minimize_levenberg_marquardt", lower, upper)
    low, high = (bound.expand_as(start).cpu().numpy() for bound in (lower, upper))
    x = start.cpu().numpy().clip(low, high)
    problems = len(x)

    def evaluate(point: Array, rows: Array) -> tuple[Array, Array, Array, Array]:
        there = (torch.from_numpy(part).to(start.device) for part in (point, rows))
        value, gradient, matrix = (part.cpu().numpy() for part in objective.quadratic_model(*there))
        with np.errstate(invalid="ignore", over="ignore"):  # a sum with what is not finite is not finite
            finite = np.isfinite(value + gradient.sum(-1) + matrix.sum((-1, -2)))
        return value, gradient, matrix, finite

    rows = np.arange(problems)
    value, gradient, matrix, good = evaluate(x, rows)
    status = [Status.MAX_ITERATIONS] * problems
    iterations = np.zeros(problems, dtype=np.int64)
    lam, growth, trust = np.full(problems, damping), np.full(problems, 2.0), np.ones(problems)

    def stop(ended: Array, why: Status) -> None:
        for row in ended.tolist():
            status[row] = why

    stop(rows[~good], Status.NOT_FINITE)
    rows = rows[good]
    for _ in range(max_iterations):
        if not len(rows):
            break
        room = low[rows] - x[rows], high[rows] - x[rows]
        curved = matrix[rows] * trust[rows, None, None]
        expected, step = _step(gradient[rows], curved, *room, lam[rows])
        size = np.abs(value[rows]) + fmin
        stuck = lam[rows] >= MAX_DAMPING
        ending = np.flatnonzero((expected <= 100 * ftol * size) | stuck)
        if len(ending):
            at = rows[ending]
            undamped = np.full(len(at), MIN_DAMPING)
            left, _ = _step(gradient[at], matrix[at], room[0][ending], room[1][ending], undamped)
            done = left <= ftol * size[ending]
            nothing_left = (left <= RESOLUTION * size[ending]) | (np.abs(value[at]) <= fmin)
            minimum = done | (stuck[ending] & nothing_left)
            stop(at[minimum], Status.CONVERGED)
            stop(at[stuck[ending] & ~minimum], Status.STALLED)
            going = np.ones(len(rows), dtype=bool)
            going[ending[minimum | stuck[ending]]] = False
            rows, expected, step = rows[going], expected[going], step[going]
            if not len(rows):
                break
        iterations[rows] += 1
        tried = (x[rows] + step).clip(low[rows], high[rows])
        f, g, h, finite = evaluate(tried, rows)
        better = finite & (f <= value[rows] - 1e-4 * expected) & (expected > 0)
        ratio = np.where(better, (value[rows] - f) / np.where(better, expected, 1.0), 0.0)
        accepted = rows[better]
        x[accepted], value[accepted] = tried[better], f[better]
        gradient[accepted], matrix[accepted] = g[better], h[better]
        shrink = (1 - (2 * ratio - 1) ** 3).clip(0.1, 2.0)
        lam[rows] = np.where(better, (lam[rows] * shrink).clip(MIN_DAMPING), lam[rows] * growth[rows])
        growth[rows] = np.where(better, 2.0, growth[rows] * 2)
        flatter = np.where(ratio > 1.1, trust[rows] / 2, trust[rows])
        trust[rows] = np.where(better, flatter, trust[rows] * 3).clip(FLATTEST, 1.0)
    count = torch.from_numpy(iterations)
    return Solution(torch.from_numpy(x).to(start), torch.from_numpy(value).to(start), status, count)


def _step(gradient: Array, matrix: Array, low: Array, high: Array, damping: Array) -> tuple[Array, Array]:
    """What the parabola promises to gain, not counting the damping, and the step to the damped parabola's least."""
    diagonal = np.einsum("rpp->rp", matrix)
    floor = diagonal.max(-1, keepdims=True).clip(1e-300) * 1e-9
    damped = matrix.copy()
    np.einsum("rpp->rp", damped)[...] += np.maximum(diagonal, floor) * damping[:, None] + floor * 1e-3
    step = solve_bounded_qp(damped, gradient, low, high)
    return promise(step, gradient, matrix), step
