"""L-BFGS with projection onto bounds, for many problems at once."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError

# Values (m,) and gradients (m, P) at points (m, P) of the problems with these indices (m,).
Objective = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]

ARMIJO = 1e-4
HALVINGS = 25
# A search that fails ends at a minimum if no more than this is to be gained, relative to the value: in float32, or at
# the kinks of a loss that has them, less cannot be had.
RESOLUTION = 1e-6


class Status(StrEnum):
    """How a problem ended. Only CONVERGED is a minimum."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    STALLED = "stalled"
    NOT_FINITE = "not_finite"
    NO_DATA = "no_data"
    TOO_FEW_SAMPLES = "too_few_samples"
    BAD_START = "bad_start"


@dataclass
class Solution:
    """The best point found for each of M problems, `(M, P)`, its value, status, and iterations spent, `(M,)`."""

    x: Tensor
    value: Tensor
    status: list[Status]
    iterations: Tensor
    evaluations: Tensor


class _Memory:
    """The last steps and changes of gradient of each problem, as L-BFGS remembers them."""

    def __init__(self, size: int, problems: int, like: Tensor) -> None:
        self.steps = like.new_zeros(size, problems, like.shape[-1])
        self.changes = torch.zeros_like(self.steps)

    def push(self, rows: Tensor, step: Tensor, change: Tensor) -> None:
        """Remember a step of each problem in `rows`; a zero step counts as forgotten."""
        for history, new in ((self.steps, step), (self.changes, change)):
            history[:, rows] = torch.cat([new[None], history[:-1, rows]])

    def forget(self, rows: Tensor) -> None:
        """Start anew, along the gradient."""
        self.steps[:, rows] = 0
        self.changes[:, rows] = 0

    def direction(self, rows: Tensor, gradient: Tensor, free: Tensor) -> Tensor:
        """The quasi-Newton direction within the free variables, by the two-loop recursion."""
        steps, changes = self.steps[:, rows] * free, self.changes[:, rows] * free
        product = (steps * changes).sum(-1)
        length = (changes * changes).sum(-1)
        usable = product > 1e-12 * length
        inverse = torch.where(usable, 1 / torch.where(usable, product, 1), 0)
        d = -gradient * free
        along: list[Tensor] = []
        for s, y, r in zip(steps, changes, inverse, strict=True):
            along.append(r * (s * d).sum(-1))
            d = d - along[-1][:, None] * y
        # Scale by the newest usable pair; without one the step is short: no variable moves by more than a tenth.
        newest = usable.to(torch.int8).argmax(0)[None]
        scale = torch.where(
            usable.any(0),
            product.gather(0, newest)[0] / length.gather(0, newest)[0].clamp_min(1e-300),
            0.1 / d.abs().amax(-1).clamp_min(1e-300),
        )
        d = d * scale[:, None]
        for s, y, r, a in reversed(list(zip(steps, changes, inverse, along, strict=True))):
            d = d + (a - r * (y * d).sum(-1))[:, None] * s
        return d * free


def minimize(
    objective: Objective,
    start: Tensor,
    lower: Tensor,
    upper: Tensor,
    *,
    max_iterations: int = 300,
    memory: int = 40,
    gradient_tolerance: float = 1e-6,
    value_tolerance: float = 1e-9,
    negligible: float = 1e-12,
) -> Solution:
    """Minimise M independent functions of P variables within bounds.

    start, lower, upper: `(M, P)`, float64; bounds may be `(P,)`. Each problem has its own memory, line search and
    end; those that have ended leave the batch, so that `objective` is called for ever fewer. A problem has converged
    when no component of its projected gradient exceeds gradient_tolerance, or when neither a step nor another along the
    gradient lowers its value by value_tolerance and no more is to be expected, all relative to the value's magnitude
    plus `negligible`. A variable at a bound with the gradient pointing outward is held there during a step (Bertsekas
    1982, doi:10.1137/0320018); L-BFGS as in Nocedal and Wright, Numerical Optimization, ch. 7.
    """
    lower, upper = lower.expand_as(start), upper.expand_as(start)
    if not bool((lower <= upper).all()):
        raise ShapeError("minimize: a lower bound is above its upper bound")
    problems = start.shape[0]
    x = start.clamp(lower, upper)
    everyone = torch.arange(problems, device=start.device)
    value, gradient = objective(x, everyone)
    history = _Memory(min(memory, max(10, x.shape[1])), problems, x)
    status = [Status.MAX_ITERATIONS] * problems
    iterations = torch.zeros(problems, dtype=torch.long)
    evaluations = torch.ones(problems, dtype=torch.long)
    fresh = torch.ones(problems, dtype=torch.bool, device=x.device)  # memory empty: nothing left to forget

    def finish(rows: Tensor, ended: Tensor, why: Status) -> Tensor:
        for row in rows[ended].tolist():
            status[row] = why
        return rows[~ended]

    rows = finish(everyone, ~(value.isfinite() & gradient.isfinite().all(-1)), Status.NOT_FINITE)
    for _ in range(max_iterations):
        size = value.abs() + negligible
        projected = (x - gradient / size[:, None]).clamp(lower, upper) - x
        rows = finish(rows, projected[rows].abs().amax(-1) <= gradient_tolerance, Status.CONVERGED)
        if not len(rows):
            break
        x0, f0, g0, low, high = x[rows], value[rows], gradient[rows], lower[rows], upper[rows]
        held = ((x0 <= low) & (g0 > 0)) | ((x0 >= high) & (g0 < 0))
        direction = history.direction(rows, g0, (~held).to(x))
        uphill = (direction * g0).sum(-1) >= 0
        if bool(uphill.any()):
            history.forget(rows[uphill])
            direction[uphill] = history.direction(rows[uphill], g0[uphill], (~held[uphill]).to(x))
        x1, f1, g1, accepted, tries, promise = _line_search(objective, rows, x0, f0, g0, direction, low, high)
        evaluations[rows.cpu()] += tries.cpu()
        iterations[rows.cpu()] += 1
        done = rows[accepted]
        x[done], value[done], gradient[done] = x1[accepted], f1[accepted], g1[accepted]
        history.push(done, (x1 - x0)[accepted], (g1 - g0)[accepted])
        # A search that fails or gains nothing is tried once more along the gradient, with an empty memory.
        gained = torch.zeros_like(accepted)
        gained[accepted] = (f0 - f1)[accepted] > value_tolerance * size[rows][accepted]
        ended = ~gained & fresh[rows]
        history.forget(rows[~gained])
        fresh[rows] = ~gained
        minimum = accepted | (promise <= RESOLUTION * size[rows])
        finish(rows, ended & minimum, Status.CONVERGED)
        finish(rows, ended & ~minimum, Status.STALLED)
        rows = rows[~ended]
    return Solution(x, value, status, iterations, evaluations)


def _line_search(
    objective: Objective, rows: Tensor, x0: Tensor, f0: Tensor, g0: Tensor, direction: Tensor, low: Tensor, high: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Backtracking along the projected direction until the value falls enough; each problem on its own.

    Gives the points, values, gradients, whether they are accepted, the tries, and what a parabola through the value,
    the slope, and the nearest clearly higher value tried promises to gain.
    """
    x1, f1, g1 = x0.clone(), f0.clone(), g0.clone()
    accepted = torch.zeros(len(rows), dtype=torch.bool, device=x0.device)
    tries = torch.zeros(len(rows), dtype=torch.long, device=x0.device)
    promise = torch.zeros_like(f0)
    step = torch.ones_like(f0)
    left = torch.arange(len(rows), device=x0.device)
    for _ in range(HALVINGS):
        point = (x0[left] + step[left, None] * direction[left]).clamp(low[left], high[left])
        value, gradient = objective(point, rows[left])
        tries[left] += 1
        slope = (g0[left] * (point - x0[left])).sum(-1)
        good = value.isfinite() & gradient.isfinite().all(-1) & (value <= f0[left] + ARMIJO * slope) & (slope < 0)
        x1[left[good]], f1[left[good]], g1[left[good]] = point[good], value[good], gradient[good]
        accepted[left[good]] = True
        # The minimum of the parabola through both values and the slope, kept between a tenth and a half.
        curve = 2 * (value - f0[left] - slope)
        higher = value.isfinite() & (value - f0[left] > RESOLUTION * f0[left].abs())
        promise[left] = torch.where(higher, slope.square() / (2 * curve), promise[left])
        shrink = torch.where(value.isfinite() & (curve > 0), -slope / curve, 0.1).clamp(0.1, 0.5)
        step[left] = step[left] * shrink
        left = left[~good]
        if not len(left):
            break
    return x1, f1, g1, accepted, tries, promise
