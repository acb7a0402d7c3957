"""What the solvers share: whether bounds are bounds, what a parabola promises, and where one is finite."""

from typing import TypeVar

from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.solvers.bounded_qp import Array

Numbers = TypeVar("Numbers", Tensor, Array)


def check_bounds(solver: str, lower: Tensor, upper: Tensor) -> None:
    """Refuse lower bounds above upper ones, with a ShapeError."""
    if not bool((lower <= upper).all()):
        raise ShapeError(f"{solver}: a lower bound is above its upper bound")


def promise(step: Numbers, gradient: Numbers, matrix: Numbers) -> Numbers:
    """What the parabolas of m problems promise to gain by steps `(m, P)`, `(m,)`."""
    return -(gradient * step).sum(-1) - 0.5 * (step * (matrix @ step[..., None])[..., 0]).sum(-1)


def is_finite(value: Tensor, gradient: Tensor, matrix: Tensor) -> Tensor:
    """Which of m parabolas have numbers alone, `(m,)`."""
    return value.isfinite() & gradient.isfinite().all(-1) & matrix.isfinite().all(-1).all(-1)
