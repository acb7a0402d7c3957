"""L-BFGS with projection onto bounds, for many problems at once."""

import torch
from torch import Tensor

from torchbrdf.solvers.parabola import check_bounds
from torchbrdf.solvers.status import RESOLUTION, FirstOrder, Solution, Status

ARMIJO = 1e-4
HALVINGS = 25


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


def minimize_lbfgs(
    objective: FirstOrder,
    start: Tensor,
    lower: Tensor,
    upper: Tensor,
    *,
    max_iterations: int = 300,
    memory: int = 40,
    gtol: float = 1e-6,
    ftol: float = 1e-9,
    fmin: float = 1e-12,
) -> Solution:
    """Minimise M independent functions of P variables within bounds, by their gradients.

    Each problem has its own memory, line search and end; those that have ended leave the batch, so that `objective` is
    called for ever fewer. A problem has converged when no component of its projected gradient exceeds gtol, or when
    neither a step nor another along the gradient lowers its value by ftol and no more is to be expected, all relative
    to the value's magnitude plus fmin.

    Args:
        objective: values and gradients.
        start: where each problem begins, `(M, P)`, float64.
        lower: bounds, `(M, P)` or `(P,)`.
        upper: the same.
        max_iterations: steps of each problem at most.
        memory: steps that each problem remembers.
        gtol: gradient that is as good as 0.
        ftol: share of the value that is not worth another step.
        fmin: a value that is as good as 0.

    Returns:
        The best point of each problem.

    Raises:
        ShapeError: if a lower bound is above its upper bound.

    Source: a variable at a bound with the gradient pointing outward is held there during a step, D. Bertsekas, 1982,
    doi:10.1137/0320018; L-BFGS as in Nocedal and Wright, Numerical Optimization, ch. 7.

    Example:
        >>> class Parabola:
        ...     def value_and_gradient(self, x, rows):
        ...         return (x - 2).square().sum(1), 2 * (x - 2)
        >>> zero, one = torch.zeros(3, 1, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
        >>> minimize_lbfgs(Parabola(), zero, -one, one).x.flatten().tolist()
        [1.0, 1.0, 1.0]
    """
    lower, upper = lower.expand_as(start), upper.expand_as(start)
    check_bounds("minimize_lbfgs", lower, upper)
    problems = start.shape[0]
    x = start.clamp(lower, upper)
    all_rows = torch.arange(problems, dtype=torch.int64, device=start.device)
    value, gradient = objective.value_and_gradient(x, all_rows)
    history = _Memory(min(memory, max(10, x.shape[1])), problems, x)
    status = [Status.MAX_ITERATIONS] * problems
    iterations = torch.zeros(problems, dtype=torch.int64, device="cpu")
    fresh = torch.ones(problems, dtype=torch.bool, device=x.device)  # memory empty: nothing left to forget

    def stop(rows: Tensor, ended: Tensor, why: Status) -> Tensor:
        for row in rows[ended].tolist():
            status[row] = why
        return rows[~ended]

    rows = stop(all_rows, ~(value.isfinite() & gradient.isfinite().all(-1)), Status.NOT_FINITE)
    for _ in range(max_iterations):
        size = value.abs() + fmin
        projected = (x - gradient / size[:, None]).clamp(lower, upper) - x
        rows = stop(rows, projected[rows].abs().amax(-1) <= gtol, Status.CONVERGED)
        if not len(rows):
            break
        x0, f0, g0, low, high = x[rows], value[rows], gradient[rows], lower[rows], upper[rows]
        held = ((x0 <= low) & (g0 > 0)) | ((x0 >= high) & (g0 < 0))
        direction = history.direction(rows, g0, (~held).to(x))
        uphill = (direction * g0).sum(-1) >= 0
        if bool(uphill.any()):
            history.forget(rows[uphill])
            direction[uphill] = history.direction(rows[uphill], g0[uphill], (~held[uphill]).to(x))
        x1, f1, g1, accepted, promise = _line_search(objective, rows, x0, f0, g0, direction, low, high)
        iterations[rows.cpu()] += 1
        done = rows[accepted]
        x[done], value[done], gradient[done] = x1[accepted], f1[accepted], g1[accepted]
        history.push(done, (x1 - x0)[accepted], (g1 - g0)[accepted])
        # A search that fails or gains nothing is tried once more along the gradient, with an empty memory.
        gained = torch.zeros_like(accepted)
        gained[accepted] = (f0 - f1)[accepted] > ftol * size[rows][accepted]
        ended = ~gained & fresh[rows]
        history.forget(rows[~gained])
        fresh[rows] = ~gained
        minimum = accepted | (promise <= RESOLUTION * size[rows]) | (value[rows].abs() <= fmin)
        stop(rows, ended & minimum, Status.CONVERGED)
        stop(rows, ended & ~minimum, Status.STALLED)
        rows = rows[~ended]
    return Solution(x, value, status, iterations)


def _line_search(
    objective: FirstOrder,
    rows: Tensor,
    x0: Tensor,
    f0: Tensor,
    g0: Tensor,
    direction: Tensor,
    low: Tensor,
    high: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Backtracking along the projected direction until the value falls enough; each problem on its own.

    Gives the points, values, gradients, whether they are accepted, and what a parabola through the value,
    the slope, and the nearest clearly higher value tried promises to gain.
    """
    x1, f1, g1 = x0.clone(), f0.clone(), g0.clone()
    accepted = torch.zeros(len(rows), dtype=torch.bool, device=x0.device)
    promise = torch.zeros_like(f0)
    step = torch.ones_like(f0)
    left = torch.arange(len(rows), dtype=torch.int64, device=x0.device)
    for _ in range(HALVINGS):
        point = (x0[left] + step[left, None] * direction[left]).clamp(low[left], high[left])
        value, gradient = objective.value_and_gradient(point, rows[left])
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
    return x1, f1, g1, accepted, promise
