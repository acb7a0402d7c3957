"""Root mean square error (eq. 8)."""

from typing import ClassVar

from torch import Tensor

from torchbrdf.losses.base import LOSSES, Loss
from torchbrdf.pairs import Pairs


@LOSSES.register("rms")
class RMSLoss(Loss):
    """sqrt(sum((M - A)^2) / n), the paper's eq. 8; needs no pairs. Shapes as `Loss`.

    Args:
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.

    Example:
        >>> import torch
        >>> RMSLoss()(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3))
        tensor(2.)
    """

    has_linear_encoding: ClassVar[bool] = True

    def encode(self, values: Tensor, pairs: Pairs | None) -> Tensor:
        """The values as they are."""
        return values

    def encode_with_derivative(self, values: Tensor, pairs: Pairs | None) -> tuple[Tensor, Tensor]:
        """1."""
        return values, values.new_ones(1, 1)
