"""A loss: no more than what is compared, and what a difference costs."""

from torch import Tensor

from torchbrdf import Loss, Pairs


class MyLoss(Loss):
    """Root mean square of logarithms."""

    def encode(self, values: Tensor, pairs: Pairs | None) -> Tensor:
        """The logarithm, finite at 0."""
        return (values.clamp_min(0) + 0.01).log()

    def penalty(self, difference: Tensor) -> Tensor:
        """The square."""
        return difference.square()
