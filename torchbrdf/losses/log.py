"""Differences of logarithms."""

import torch
from torch import Tensor

from torchbrdf.losses.base import LOSSES, LeastSquares, cosine
from torchbrdf.pairs import Pairs


@LOSSES.register("log")
class LogLoss(LeastSquares):
    """sqrt(sum((log(1 + M cos_i) - log(1 + A cos_i))^2) / n). Shapes as `Loss`; negative values count as 0.

    Source: the metric E2 of J. Low et al., BRDF Models for Accurate and Efficient Rendering of Glossy Surfaces,
    2012, doi:10.1145/2077341.2077350. A plain logarithm, as in Matusik 2003, has no value at 0.
    """

    needs = ("cos_i",)

    def residuals(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        """log(1 + A cos_i) - log(1 + M cos_i)."""
        cos_i = cosine(pairs)
        return torch.log1p((prediction * cos_i).clamp_min(0)) - torch.log1p((target * cos_i).clamp_min(0))
