"""Losses of what is observed of a BRDF's values: a linear function of them, such as a picture."""

from typing import ClassVar

from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.losses.base import Loss, Problem
from torchbrdf.pairs import Pairs

# Values (m,), gradients (m, P, 3), and positive semi-definite matrices (m, P, 3, 3) that make up a parabola.
Parabola = tuple[Tensor, Tensor, Tensor]


class ObservedLoss(Loss):
    """Compares P observations of three channels that follow linearly from the values on the problem's own pairs.

    A subclass gives `observe` and `columns`, the linear function, `value`, what a fit minimises, and `parabola` if it
    can. Fits use that a model is a sum of colours times scalar functions: they observe those once in a step, and
    everything else happens in the observations.
    """

    subsets: ClassVar[bool] = False

    def observe(self, values: Tensor) -> Tensor:
        """What is observed of values `(M, N, 3)`, `(M, P, 3)`; differentiable."""
        raise NotImplementedError

    def columns(self, shapes: Tensor) -> Tensor:
        """What each channel observes of scalar functions `(K, N)`, `(K, 3, P)`."""
        raise NotImplementedError

    def value(self, observed: Tensor, target: Tensor) -> Tensor:
        """What a fit minimises, `(M,)`, at least 0, 0 for equal observations; differentiable. float64."""
        raise NotImplementedError

    def parabola(self, observed: Tensor, target: Tensor, width: Tensor | None = None) -> Parabola:
        """`value`, its gradient, and the curvature of a parabola that stands in for it nearby.

        width `(M,)`: a value with a cusp is rounded over differences of this size.
        """
        raise NotImplementedError

    @property
    def curved(self) -> bool:
        """Whether there is a parabola."""
        return type(self).parabola is not ObservedLoss.parabola

    def stand_in(self) -> "ObservedLoss":
        """A loss with a parabola that leads to nearly the same fits; itself, if it has one."""
        return self

    def thinned(self, problem: Problem) -> tuple["ObservedLoss", Problem]:
        """A share of the observations, enough to compare starts by: a loss with a parabola, and its problem."""
        raise NotImplementedError

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The error of each material, `(M,)`, float64."""
        self._check(prediction, target, pairs, weight)
        if weight is not None:
            raise ShapeError(f"{type(self).__name__}: expected no weights, found {(*weight.shape,)}")
        prediction, target, _ = self._widened(prediction, target, None)
        aim = self.remembered(target, None, lambda: self.observe(target))
        return self.figure(self.value(self.observe(prediction), aim))
