"""The objective of a loss with bins: beside a mean over pairs, squares of residuals that are linear in averages."""

from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.fitting.objective.pointwise import EncodedProblem, PointwiseObjective, Sums
from torchbrdf.losses import BinAssignment, BinnedLoss


class BinnedSums(Sums):
    """Beside what every pointwise objective adds up, the averages of bins and their derivatives by the responses."""

    objective: "BinnedObjective"
    means: Tensor | float = 0.0
    mean_slopes: Tensor | float = 0.0

    def add(
        self,
        samples: slice,
        difference: Tensor,
        rate: Tensor,
        basis: Tensor,
        weight: Tensor | None,
        width: Tensor | None,
        curvature: bool,
    ) -> None:
        """Add some pairs, as `Sums.add` does, and their share in each bin."""
        super().add(samples, difference, rate, basis, weight, width, curvature)
        membership = self._own(self.objective.assignment.membership[:, samples])
        if self.objective.given_weight is not None:
            given = self._own(self.objective.given_weight[..., samples])
            difference, rate = difference * given, rate * given
        derivatives = (rate[:, :, None] * basis[:, None]).flatten(1, 2)
        self.means = self.means + (difference @ membership).double()
        self.mean_slopes = self.mean_slopes + (derivatives @ membership).double()

    def totals(self, jacobian: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix, as `Sums.totals` gives them, with those of the bins' residuals."""
        value, gradient, matrix = super().totals(jacobian)
        mass, factor = self._own(self.objective.assignment.mass), self.objective.mean_factor
        slopes = (self.mean_slopes / mass).unflatten(1, (3, -1))
        residual = (self.means / mass).flatten(1) @ factor
        mean_jacobian = torch.einsum("rcqg,rcqp->rpcg", slopes, jacobian).flatten(2) @ factor
        value = value + residual.square().sum(1)
        gradient = gradient + 2 * (mean_jacobian @ residual[..., None])[..., 0]
        return value, gradient, matrix + 2 * mean_jacobian @ mean_jacobian.mT if self.grams is not None else matrix

    def _own(self, values: Tensor) -> Tensor:
        """What belongs to these materials."""
        return values if self.materials is None or len(values) == 1 else values[self.materials]


class BinnedObjective(PointwiseObjective):
    """The square of a binned loss's error; bins divide for themselves, so that the norm is 1."""

    sums = BinnedSums
    loss: BinnedLoss

    @cached_property
    def assignment(self) -> BinAssignment:
        """Which bins the pairs are in."""
        return self.loss.assignment(self.problem.pairs, self.problem.weight, self.problem.target)

    @cached_property
    def given_weight(self) -> Tensor | None:
        """The weights of the problem, `(M|1, 1, N)`, if it has any."""
        return None if self.problem.weight is None else self.problem.weight.mT

    @cached_property
    def mean_factor(self) -> Tensor:
        """`BinnedLoss.mean_factor` of three channels."""
        return self.loss.mean_factor(3).to(self.assignment.mass)

    @cached_property
    def encoded(self) -> EncodedProblem:
        """The problem with the weights of squares of single pairs."""
        weight = self.assignment.pointwise_weight
        weight = weight if self.problem.weight is None else weight * self.problem.weight
        return EncodedProblem(self.problem, self.loss, weight.mT)

    @cached_property
    def zero_prediction_error(self) -> Tensor:
        """The squared error of a prediction that is 0 everywhere."""
        problem = self.problem
        zero = torch.zeros_like(problem.target)
        found = self.loss.error(zero, problem.target, problem.pairs, problem.weight).square()
        return torch.where(found > 0, found, 1)

    @property
    def norm(self) -> Tensor:
        """Bins divide for themselves."""
        return torch.ones_like(self.encoded.total)
