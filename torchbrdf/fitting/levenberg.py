"""Levenberg-Marquardt with bounds, for many problems at once."""

from collections.abc import Callable

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.fitting.lbfgs import RESOLUTION, Solution, Status
from torchbrdf.fitting.quadratic import minimize_quadratic

# Values (m,), gradients (m, P) and positive semi-definite matrices (m, P, P) at points (m, P) of these problems (m,).
Quadratic = Callable[[Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]

SMALLEST, LARGEST = 1e-9, 1e9
FLATTEST = 0.02


def minimize_squares(
    objective: Quadratic,
    start: Tensor,
    lower: Tensor,
    upper: Tensor,
    *,
    max_iterations: int = 100,
    tolerance: float = 1e-8,
    negligible: float = 1e-12,
    damping: float = 1e-3,
) -> Solution:
    """Minimise M independent functions of P variables within bounds, each near enough to its own parabola.

    start, lower, upper: `(M, P)`, float64; bounds may be `(P,)`. Each step goes to the least of the damped parabola
    within the bounds; each problem has its own damping and end, and those that have ended leave the batch. Where a
    parabola promises less than comes about, as one does that lies above the function, it is made flatter. A problem
    has converged when the undamped parabola promises no more than `tolerance` of its value plus `negligible`, or when
    no step is better and it promises no more than 1e-6 of it; else it has stalled.

    Source: K. Madsen, H. Nielsen, O. Tingleff, Methods for Non-linear Least Squares Problems, 2004, for the damping.
    """
    lower, upper = lower.expand_as(start), upper.expand_as(start)
    if not bool((lower <= upper).all()):
        raise ShapeError("minimize_squares: a lower bound is above its upper bound")
    problems = len(start)
    x = start.clamp(lower, upper)
    everyone = torch.arange(problems)
    value, gradient, matrix = objective(x, everyone)
    status = [Status.MAX_ITERATIONS] * problems
    iterations = torch.zeros(problems, dtype=torch.long)
    lam = torch.full_like(value, damping)
    growth = torch.full_like(value, 2.0)
    trust = torch.ones_like(value)

    def finish(rows: Tensor, ended: Tensor, why: Status) -> Tensor:
        for row in rows[ended].tolist():
            status[row] = why
        return rows[~ended]

    def finite(f: Tensor, g: Tensor, h: Tensor) -> Tensor:
        return f.isfinite() & g.isfinite().all(-1) & h.isfinite().all(-1).all(-1)

    rows = finish(everyone, ~finite(value, gradient, matrix), Status.NOT_FINITE)
    for _ in range(max_iterations):
        f, g, h, at = value[rows], gradient[rows], matrix[rows], x[rows]
        low, high = lower[rows] - at, upper[rows] - at
        promise, _ = _step(g, h, low, high, torch.full_like(f, SMALLEST))
        size = f.abs() + negligible
        done = promise <= tolerance * size
        stuck = ~done & (lam[rows] >= LARGEST)
        finish(rows, done | (stuck & (promise <= RESOLUTION * size)), Status.CONVERGED)
        finish(rows, stuck & (promise > RESOLUTION * size), Status.STALLED)
        left = ~(done | stuck)
        rows, f, g, h, at, low, high = (kept[left] for kept in (rows, f, g, h, at, low, high))
        if not len(rows):
            break
        h = h * trust[rows, None, None]
        expected, step = _step(g, h, low, high, lam[rows])
        iterations[rows] += 1
        tried = torch.minimum(torch.maximum(at + step, lower[rows]), upper[rows])
        f1, g1, h1 = objective(tried, rows)
        good = finite(f1, g1, h1) & (f1 <= f - 1e-4 * expected) & (expected > 0)
        ratio = torch.where(good, (f - f1) / expected, 0)
        moved = rows[good]
        x[moved], value[moved], gradient[moved], matrix[moved] = tried[good], f1[good], g1[good], h1[good]
        shrink = (1 - (2 * ratio - 1) ** 3).clamp(0.1, 2)
        lam[rows] = torch.where(good, (lam[rows] * shrink).clamp_min(SMALLEST), lam[rows] * growth[rows])
        growth[rows] = torch.where(good, 2.0, growth[rows] * 2)
        flatter = torch.where(ratio > 1.1, trust[rows] / 2, trust[rows])
        trust[rows] = torch.where(good, flatter, trust[rows] * 3).clamp(FLATTEST, 1)
    return Solution(x, value, status, iterations, iterations + 1)


def _step(g: Tensor, h: Tensor, low: Tensor, high: Tensor, damping: Tensor) -> tuple[Tensor, Tensor]:
    """What the damped parabola promises to gain, not counting the damping, and the step to its least."""
    diagonal = torch.diagonal(h, dim1=-2, dim2=-1)
    floor = diagonal.amax(-1, keepdim=True).clamp_min(1e-300) * 1e-9
    damped = h + torch.diag_embed(diagonal.clamp_min(floor) * damping[:, None] + floor * 1e-3)
    step = minimize_quadratic(damped, g, low, high)
    return -(g * step).sum(-1) - 0.5 * (step * (h @ step[..., None])[..., 0]).sum(-1), step
