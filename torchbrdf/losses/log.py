"""Differences of logarithms."""

import torch
from torch import Tensor

from torchbrdf.losses.base import LOSSES, Loss, cosine
from torchbrdf.losses.elementary import NEW, Out, log1p, where_positive
from torchbrdf.pairs import Pairs


@LOSSES.register("log")
class LogLoss(Loss):
    """sqrt(sum((log(1 + M cos_i) - log(1 + A cos_i))^2) / n). Shapes as `Loss`; negative values count as 0.

    Source: the metric E2 of J. Low et al., BRDF Models for Accurate and Efficient Rendering of Glossy Surfaces,
    2012, doi:10.1145/2077341.2077350. A plain logarithm, as in Matusik 2003, has no value at 0.

    Args:
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_cosines(cos_i=torch.full((5,), 1.0))
        >>> LogLoss()(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3), pairs)
        tensor(0.6931)
    """

    needs = ("cos_i",)

    def exposure(self, pairs: Pairs | None) -> Tensor:
        """cos_i."""
        return cosine(pairs)[..., 0]

    def compress(self, x: Tensor) -> Tensor:
        """log(1 + x)."""
        return torch.log1p(x.clamp_min(0))

    def compress_with_derivative(self, x: Tensor, out: Out = NEW) -> tuple[Tensor, Tensor]:
        """1 / (1 + x), 0 for negative values."""
        positive = torch.clamp_min(x, 0, out=out[1])
        code = log1p(positive, out[0])
        return code, where_positive(positive.add_(1).reciprocal_(), x)
