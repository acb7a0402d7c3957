"""Root mean square error (eq. 8)."""

from torch import Tensor

from torchbrdf.losses.base import LOSSES, LeastSquares
from torchbrdf.pairs import Pairs


@LOSSES.register("rms")
class RMSLoss(LeastSquares):
    """sqrt(sum((M - A)^2) / n), the paper's eq. 8; needs no pairs. Shapes as `Loss`."""

    def residuals(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        """A - M."""
        return prediction - target
