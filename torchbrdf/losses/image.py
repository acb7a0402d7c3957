"""Losses of what is observed of a BRDF's values: a linear function of them, such as a picture."""

from typing import TYPE_CHECKING

from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.losses.base import Loss
from torchbrdf.losses.problem import Problem
from torchbrdf.pairs import Pairs
from torchbrdf.precision import without_autocast

if TYPE_CHECKING:
    from scipy import sparse

# Values (m,), gradients (m, P, 3), and positive semi-definite matrices (m, P, 3, 3) that make up a parabola.
QuadraticModel = tuple[Tensor, Tensor, Tensor]


class ImageLoss(Loss):
    """Compares P observations of three channels that follow linearly from the values on the problem's own pairs.

    A subclass gives its `pairs`, `observe` and `observe_basis`, the linear function, `compare`, what a fit minimises,
    and `quadratic_majorizer` if it can. Fits use that a model is a sum of colours times scalar functions: they observe
    those once in a step, and everything else happens in the observations.

    Args:
        reduction: as of `Loss`.

    Example:
        >>> from torchbrdf.render import RenderedLoss
        >>> issubclass(RenderedLoss, ImageLoss)
        True
    """

    objective = "image"
    supports_subsampling = False
    needs_rgb = True
    default_diffuse = "fit"
    pairs: Pairs
    """Those of the values that it observes."""

    def observe(self, values: Tensor) -> Tensor:
        """What is observed of values `(M, N, 3)`, `(M, P, 3)`; differentiable."""
        raise NotImplementedError(f"{type(self).__name__}: expected a method observe, found none")

    def observe_basis(self, responses: Tensor) -> Tensor:
        """What each channel observes of scalar functions `(K, N)`, `(K, 3, P)`."""
        raise NotImplementedError(f"{type(self).__name__}: expected a method observe_basis, found none")

    def observation_matrices(self) -> "list[sparse.csr_matrix] | None":
        """The linear function as a sparse matrix for each channel, `(P, N)`; None where it is not kept as that."""
        return None

    def compare(self, observed: Tensor, target: Tensor) -> Tensor:
        """What a fit minimises, `(M,)`, at least 0, 0 for equal observations; differentiable. float64."""
        raise NotImplementedError(f"{type(self).__name__}: expected a method compare, found none")

    def quadratic_majorizer(self, observed: Tensor, target: Tensor, width: Tensor | None = None) -> QuadraticModel:
        """`compare`, its gradient, and the curvature of a parabola that stands in for it nearby.

        width `(M,)`: a value with a cusp is rounded over differences of this size.
        """
        raise NotImplementedError(f"{type(self).__name__}: has no quadratic majorizer")

    @property
    def has_closed_derivatives(self) -> bool:
        """What is observed is linear; what is left for autograd is small."""
        return True

    @property
    def has_majorizer(self) -> bool:
        """Whether there is a parabola."""
        return type(self).quadratic_majorizer is not ImageLoss.quadratic_majorizer

    def surrogate(self) -> "ImageLoss":
        """A loss with a majorizer that leads to nearly the same fits; itself, if it has one."""
        return self

    def subsample(self, problem: Problem) -> tuple["ImageLoss", Problem]:
        """A share of the observations, enough to compare starts by: a loss with a majorizer, and its problem."""
        raise NotImplementedError(f"{type(self).__name__}: expected a method subsample, found none")

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The error of each material, `(M,)`, float64."""
        self._check(prediction, target, pairs, weight)
        if weight is not None:
            raise ShapeError(f"{type(self).__name__}: expected no weights, found {(*weight.shape,)}")
        prediction, target, _ = self._widened(prediction, target, None)
        with without_autocast(prediction.device.type):
            observed_target = self._kept_target.find(target)
            if observed_target is None:
                observed_target = self.observe(target)
                self._kept_target.keep(observed_target, target, own=observed_target)
            return self.finalize(self.compare(self.observe(prediction), observed_target))
