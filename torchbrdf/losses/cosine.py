"""Cosine-weighted root mean square error (eq. 9)."""

from torch import Tensor

from torchbrdf.losses.base import LOSSES, LeastSquares, cosine
from torchbrdf.pairs import Pairs


@LOSSES.register("cosine")
class CosineRMSLoss(LeastSquares):
    """sqrt(sum((M cos_i - A cos_i)^2) / n), the paper's eq. 9. Shapes as `Loss`."""

    needs = ("cos_i",)

    def residuals(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        """(A - M) cos_i."""
        return (prediction - target) * cosine(pairs)
