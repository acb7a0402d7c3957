"""Damped Gauss-Newton steps, projected on bounds: for hundreds of variables, of which few meet a bound."""

import torch
from torch import Tensor

from torchbrdf.solvers.parabola import check_bounds, is_finite, promise
from torchbrdf.solvers.status import RESOLUTION, SecondOrder, Solution, Status

MIN_DAMPING, MAX_DAMPING = 1e-9, 1e6
# How often variables that a step carries to a bound are put there, and others released, and all solved for again.
PASSES = 6


def minimize_projected_newton(
    objective: SecondOrder,
    start: Tensor,
    lower: Tensor,
    upper: Tensor,
    *,
    max_iterations: int = 100,
    ftol: float = 1e-8,
    fmin: float = 1e-12,
    longest: float = 2.0,
    damping: float = 1e-3,
) -> Solution:
    """Minimise M independent functions of P variables within bounds, each near enough to its own parabola.

    As `minimize_levenberg_marquardt`, but a step is no more than nearly the best one within the bounds: variables that
    it carries to a bound are put there, and those that a bound no longer holds released, a few times over, where that
    solver goes on until none is left. It costs a few solutions of a linear system a step for any P, and no variable
    moves by more than `longest` at a time, as is good for logarithms.

    Args:
        objective: values, gradients and matrices.
        start: where each problem begins, `(M, P)`, float64.
        lower: bounds, `(M, P)` or `(P,)`.
        upper: the same.
        max_iterations: steps of each problem at most.
        ftol: a problem has converged when a step gains no more than this share of its value, or when none is better
            and the undamped parabola promises no more than 1e-6 of it.
        fmin: a value that is as good as 0.
        longest: the largest change of a variable in a step.
        damping: at the start, in units of the matrix' diagonal.

    Returns:
        The best point of each problem.

    Raises:
        ShapeError: if a lower bound is above its upper bound.

    Source: D. Bertsekas, Projected Newton Methods for Optimization Problems with Simple Constraints, 1982,
    doi:10.1137/0320018.

    Example:
        >>> class Parabola:
        ...     def quadratic_model(self, x, rows):
        ...         return (x - 2).square().sum(1), 2 * (x - 2), 2 * torch.ones_like(x)[..., None]
        >>> zero, one = torch.zeros(3, 1, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
        >>> minimize_projected_newton(Parabola(), zero, -one, one).x.flatten().tolist()
        [1.0, 1.0, 1.0]
    """
    check_bounds("minimize_projected_newton", lower, upper)
    low, high = lower.expand_as(start), upper.expand_as(start)
    x = start.clamp(low, high)
    rows = torch.arange(len(x), dtype=torch.int64, device=x.device)
    value, gradient, matrix = objective.quadratic_model(x, rows)
    status = [Status.MAX_ITERATIONS] * len(x)
    iterations = torch.zeros(len(x), dtype=torch.int64, device=x.device)
    lam = torch.full_like(value, damping)

    def stop(which: Tensor, why: Status) -> None:
        for row in rows[which].tolist():
            status[row] = why

    good = is_finite(value, gradient, matrix)
    stop(~good, Status.NOT_FINITE)
    stop(good & (value <= fmin), Status.CONVERGED)
    rows = rows[good & (value > fmin)]
    for _ in range(max_iterations):
        if not len(rows):
            break
        room = (low[rows] - x[rows]).clamp_min(-longest), (high[rows] - x[rows]).clamp_max(longest)
        step = bounded_step(gradient[rows], matrix[rows], *room, lam[rows])
        expected = promise(step, gradient[rows], matrix[rows])
        tried = (x[rows] + step).clamp(low[rows], high[rows])
        f, g, h = objective.quadratic_model(tried, rows)
        iterations[rows] += 1
        gain = torch.where(is_finite(f, g, h), value[rows] - f, -torch.inf)
        better = gain > 0
        done = better & (gain <= ftol * f.abs() + fmin) & (expected <= 10 * ftol * f.abs() + fmin)
        stuck = ~better & (lam[rows] >= MAX_DAMPING)
        taken = rows[better]
        x[taken], value[taken], gradient[taken], matrix[taken] = tried[better], f[better], g[better], h[better]
        lam[rows] = torch.where(better, lam[rows] / 4, (lam[rows] * 10).clamp_min(1e-6)).clamp(MIN_DAMPING, MAX_DAMPING)
        done |= value[rows] <= fmin
        if bool(stuck.any()):
            undamped = bounded_step(gradient[rows], matrix[rows], *room, torch.full_like(expected, MIN_DAMPING))
            left = promise(undamped, gradient[rows], matrix[rows])
            done |= stuck & (left <= RESOLUTION * value[rows].abs() + fmin)
        stop(done, Status.CONVERGED)
        stop(stuck & ~done, Status.STALLED)
        rows = rows[~(done | stuck)]
    return Solution(x, value, status, iterations.cpu())


def bounded_step(gradient: Tensor, matrix: Tensor, low: Tensor, high: Tensor, damping: Tensor) -> Tensor:
    """Nearly the damped parabola's least between `low` and `high`, `(r, P)`, both around 0."""
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    floor = diagonal.amax(-1, keepdim=True).clamp_min(1e-300) * 1e-12
    damped = matrix + torch.diag_embed(torch.maximum(diagonal, floor) * damping[:, None] + floor)
    # At a bound, and pushed against it.
    held = ((low >= 0) & (gradient > 0)) | ((high <= 0) & (gradient < 0))
    step = torch.zeros_like(gradient)
    for _ in range(PASSES):
        fixed = torch.where(held, step, 0)
        right = -(gradient + (damped @ fixed[..., None])[..., 0])
        free = ~held
        kept = torch.where(free[:, :, None] & free[:, None, :], damped, 0) + torch.diag_embed(held.to(damped.dtype))
        found, _ = torch.linalg.solve_ex(kept, torch.where(held, fixed, right)[..., None])
        found = found[..., 0].nan_to_num(0.0)
        step = found.clamp(low, high)
        out = (found < low) | (found > high)
        pull = gradient + (damped @ step[..., None])[..., 0]
        released = held & (((step <= low) & (pull < 0)) | ((step >= high) & (pull > 0)))
        if not bool((out | released).any()):
            break
        held = (held & ~released) | out
    return step
