"""What solvers are given and what they say: objectives, points and how each problem ended."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from torch import Tensor

# A search that fails ends at a minimum if no more than this is to be gained, relative to the value: in float32, or at
# the kinks of an objective that has them, less cannot be had.
RESOLUTION = 1e-6


class FirstOrder(Protocol):
    """M independent functions of P variables, as L-BFGS sees them."""

    def value_and_gradient(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Values `(m,)` and gradients `(m, P)`, float64, at points `(m, P)` of the problems `rows`, `(m,)`, long."""


class SecondOrder(Protocol):
    """The same with curvature, as Levenberg-Marquardt sees them."""

    def quadratic_model(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, gradients, and positive semi-definite matrices `(m, P, P)` in the place of second derivatives."""


class Objective(FirstOrder, SecondOrder, Protocol):
    """What has both."""


class Status(StrEnum):
    """How a problem ended. Only CONVERGED is a minimum.

    Example:
        >>> str(Status.CONVERGED)
        'converged'
    """

    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    STALLED = "stalled"
    NOT_FINITE = "not_finite"
    NO_DATA = "no_data"
    TOO_FEW_SAMPLES = "too_few_samples"
    BAD_START = "bad_start"
    LOST = "lost"


@dataclass
class Solution:
    """The best point found for each of M problems.

    Args:
        x: the points, `(M, P)`.
        value: the objective there, `(M,)`.
        status: how each problem ended.
        iterations: spent on each, `(M,)`, on the CPU.
    """

    x: Tensor
    value: Tensor
    status: list[Status]
    iterations: Tensor
