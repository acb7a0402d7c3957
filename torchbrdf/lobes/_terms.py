"""Sums of coloured terms: value_c = sum_j coefficient_cj term_j, with coefficients that no pair changes."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchbrdf.lobes.fresnel import schlick_weight
from torchbrdf.pairs import Pairs


def combine(pairs: Pairs, coefficients: Sequence[Tensor], terms: Sequence[Tensor]) -> Tensor:
    """The sum of terms `(..., N)` times their coefficients `(..., 3)` or `(..., 1)`, zero below the horizon."""
    total = sum(term[..., None] * colour[..., None, :] for colour, term in zip(coefficients, terms, strict=True))
    return torch.where(pairs.above_horizon[..., None], total, 0).expand(*total.shape[:-1], 3)


def f82_weight(pairs: Pairs) -> Tensor:
    """cos_d (1 - cos_d)^6 over its largest value, that at cos_d = 1/7, `(..., N)`."""

    def make() -> Tensor:
        cosine = pairs.cos_d
        return schlick_weight(pairs) * (1 - cosine) * cosine * (7 * (7 / 6) ** 6)

    return pairs.cached(f82_weight, make)


def f82_colours(f0: Tensor, tint: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """What 1, `schlick_weight` and `f82_weight` are multiplied by in F.

    Its value where cos_d = 1/7 is tint times Schlick's.
    """
    return f0, 1 - f0, (tint - 1) * (f0 + (1 - f0) * (6 / 7) ** 5)
