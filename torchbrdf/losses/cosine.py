"""Cosine-weighted root mean square error (eq. 9)."""

from typing import ClassVar

from torch import Tensor

from torchbrdf.losses.base import LOSSES, Loss, cosine
from torchbrdf.pairs import Pairs


@LOSSES.register("cosine_rms")
class CosineRMSLoss(Loss):
    """sqrt(sum((M cos_i - A cos_i)^2) / n), the paper's eq. 9. Shapes as `Loss`.

    Args:
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_cosines(cos_i=torch.full((5,), 0.5))
        >>> CosineRMSLoss()(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3), pairs)
        tensor(1.)
    """

    needs: ClassVar[tuple[str, ...]] = ("cos_i",)
    has_linear_encoding: ClassVar[bool] = True

    def encode(self, values: Tensor, pairs: Pairs | None) -> Tensor:
        """M cos_i."""
        return values * cosine(pairs)

    def encode_with_derivative(self, values: Tensor, pairs: Pairs | None) -> tuple[Tensor, Tensor]:
        """cos_i."""
        cos_i = cosine(pairs)
        return values * cos_i, cos_i
