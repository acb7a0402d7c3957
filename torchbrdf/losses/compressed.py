"""Differences of powers: the compressive reading of the cube root, and the family it belongs to."""

import torch
from torch import Tensor

from torchbrdf.color import safe_power
from torchbrdf.errors import UsageError
from torchbrdf.losses.base import LOSSES, Loss, cosine
from torchbrdf.losses.elementary import NEW, Out, power, where_positive
from torchbrdf.pairs import Pairs
from torchbrdf.reduction import Reduction


@LOSSES.register("compressed")
class CompressedLoss(Loss):
    """sqrt(sum(((M cos_i)^p - (A cos_i)^p)^2) / n) with the exponent p, 1/3 by default. Shapes as `Loss`.

    Negative values count as 0. A power below 1 has an infinite slope at 0, so that x^p is (x + eps)^p - eps^p:
    exact at eps = 0, where the gradient at 0 is defined as 0. The exponents are what the paper names as future work.

    Args:
        exponent: p, above 0 and at most 2.
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.
        eps: keeps the slope at 0 finite.

    Raises:
        UsageError: for any other exponent.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_cosines(cos_i=torch.full((5,), 1.0))
        >>> CompressedLoss(0.5, eps=0.0)(torch.full((2, 5, 3), 9.0), torch.ones(2, 5, 3), pairs)
        tensor(2.)
    """

    needs = ("cos_i",)

    def __init__(self, exponent: float = 1 / 3, reduction: Reduction = "mean", eps: float = 1e-9) -> None:
        super().__init__(reduction)
        if not 0 < exponent <= 2:
            raise UsageError(f"CompressedLoss: expected an exponent above 0 and at most 2, found {exponent}")
        self.exponent, self.eps = exponent, eps

    def extra_repr(self) -> str:
        """The exponent, and what else is not the default."""
        rest = [part for part in super().extra_repr().split(", ") if part and not part.startswith("exponent")]
        return ", ".join([f"exponent={self.exponent:g}", *rest])

    def exposure(self, pairs: Pairs | None) -> Tensor:
        """cos_i."""
        return cosine(pairs)[..., 0]

    def compress(self, x: Tensor) -> Tensor:
        """x^p."""
        x = x.clamp_min(0)
        return safe_power(x, self.exponent) if self.eps == 0 else (x + self.eps).pow(self.exponent)

    def compress_with_derivative(self, x: Tensor, out: Out = NEW) -> tuple[Tensor, Tensor]:
        """p x^(p - 1), 0 for values of 0 or less."""
        base = torch.where(x > 0, x, 1) if self.eps == 0 else torch.clamp_min(x, 0, out=out[1]).add_(self.eps)
        code = power(base, self.exponent, out[0])
        slope = torch.addcdiv(x.new_zeros(()), code, base, value=self.exponent, out=out[1])
        return (torch.where(x > 0, code, 0) if self.eps == 0 else code), where_positive(slope, x)
