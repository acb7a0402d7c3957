"""Differences of powers: the compressive reading of the cube root, and the family it belongs to."""

from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.losses.base import LOSSES, LeastSquares, Reduction, cosine, safe_power
from torchbrdf.pairs import Pairs


@LOSSES.register("compressed")
class CompressedLoss(LeastSquares):
    """sqrt(sum(((M cos_i)^p - (A cos_i)^p)^2) / n) with the exponent p, 1/3 by default. Shapes as `Loss`.

    Negative values count as 0. A power below 1 has an infinite slope at 0, so that x^p is (x + eps)^p - eps^p:
    exact at eps = 0, where the gradient at 0 is defined as 0. The exponents are what the paper names as future work.
    """

    needs = ("cos_i",)

    def __init__(self, exponent: float = 1 / 3, reduction: Reduction = "mean", eps: float = 1e-9) -> None:
        super().__init__(reduction)
        if not 0 < exponent <= 2:
            raise UsageError(f"CompressedLoss: expected an exponent above 0 and at most 2, found {exponent}")
        self.exponent, self.eps = exponent, eps

    def _compress(self, x: Tensor) -> Tensor:
        x = x.clamp_min(0)
        return safe_power(x, self.exponent) if self.eps == 0 else (x + self.eps).pow(self.exponent)

    def residuals(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        """(A cos_i)^p - (M cos_i)^p."""
        cos_i = cosine(pairs)
        return self._compress(prediction * cos_i) - self._compress(target * cos_i)
