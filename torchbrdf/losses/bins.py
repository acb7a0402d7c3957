"""Soft bins of pairs over the half and the difference angle, and weighted averages over them."""

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from torchbrdf.pairs import Pairs

THETA_H = (0.0, 5.0, 15.0, 35.0, 70.0)
THETA_D = (25.0, 50.0, 75.0)
"""Centres of the bins, in degrees."""
THETA_H_BINS, THETA_D_BINS = len(THETA_H), len(THETA_D)
BIN_COUNT = THETA_H_BINS * THETA_D_BINS
# Pairs whose products are summed in the values' dtype before sums go on in float64.
PART = 1 << 13
# A bin with less than this share of the weight is empty: what rounding leaves of a pair on the centre of another bin.
EMPTY = 1e-6


def soft_bins(pairs: Pairs) -> Tensor:
    """How much of each pair lies in each bin, `(..., N, BIN_COUNT)`, theta_h slowest; its shares add up to 1."""
    high, wide = (_hats(angle, centres) for angle, centres in ((pairs.theta_h, THETA_H), (pairs.theta_d, THETA_D)))
    return (high[..., :, None] * wide[..., None, :]).flatten(-2)


def _hats(angle: Tensor, centres: tuple[float, ...]) -> Tensor:
    """Piecewise linear functions that are 1 at one centre and 0 at the others, constant outside, `(..., N, K)`."""
    degrees = angle.rad2deg()
    rises = [((degrees - low) / (high - low)).clamp(0, 1) for low, high in pairwise(centres)]
    one, none = torch.ones_like(degrees), torch.zeros_like(degrees)
    return torch.stack([a - b for a, b in zip([one, *rises], [*rises, none], strict=True)], -1)


class Bins(NamedTuple):
    """Pairs in their bins, under some weights.

    Args:
        shares: of each pair in each bin, `(..., N, B)`.
        weight: of pairs, `(..., N, 1|C)`, or None.
        mass: the weight in each bin, 1 where it is empty, `(..., 1|C, B)`, float64.
        present: which bins are not empty, as numbers, `(..., B)`, float64.
        total: the weight of each channel, `(..., 1|C)`, float64.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> pairs = Pairs.from_half_diff(*torch.full((3, 5), 0.5))
        >>> found = sort_into_bins(pairs, None, torch.ones(5, 3))
        >>> found.shares.shape, int(found.present.sum())
        (torch.Size([5, 15]), 4)
    """

    shares: Tensor
    weight: Tensor | None
    mass: Tensor
    present: Tensor
    total: Tensor

    def averages(self, values: Tensor) -> Tensor:
        """The weighted average of values `(..., N, C)` in each bin, `(..., C, B)`, float64; 0 in empty ones."""
        weighed = values if self.weight is None else values * self.weight
        return product(weighed, self.shares) / self.mass

    def mean_size(self, values: Tensor) -> Tensor:
        """The weighted mean of the magnitude of values `(..., N, C)` over pairs and channels, `(...)`, float64."""
        count, channels = values.shape[-2:]
        if self.weight is None:
            return torch.linalg.vector_norm(values, 1, (-2, -1)).double() / (count * channels)
        each = self.total.mean(-1) * channels
        return (values.abs() * self.weight).sum((-2, -1)).double() / each


def product(values: Tensor, shares: Tensor) -> Tensor:
    """values^T shares, `(..., N, C)` and `(..., N, B)` to `(..., C, B)`, float64."""
    count = values.shape[-2]
    if count <= PART or values.dtype == torch.float64:
        return (values.mT @ shares).double()
    whole = count - count % PART
    one, other = (x[..., :whole, :].unflatten(-2, (-1, PART)) for x in (values, shares))
    rest = values[..., whole:, :].mT @ shares[..., whole:, :]
    return (one.mT @ other).sum(-3, dtype=torch.float64) + rest.double()


def sort_into_bins(pairs: Pairs, weight: Tensor | None, like: Tensor) -> Bins:
    """Bins of pairs for values `like` `(..., N, C)` under weights that broadcast to them."""
    count = like.shape[-2]
    shares = soft_bins(pairs).to(like)
    shares = shares.expand(*shares.shape[:-2], count, BIN_COUNT)  # one pair may stand for all
    if weight is None:
        mass = shares.sum(-2, keepdim=True, dtype=torch.float64)
    else:
        weight = torch.atleast_2d(weight.to(like))
        weight = weight.expand(*weight.shape[:-2], count, weight.shape[-1])
        mass = product(weight, shares)
    total = mass.sum(-1)
    held = mass.sum(-2)
    present = held > EMPTY * held.sum(-1, keepdim=True)
    mass = torch.where(mass > EMPTY * total.sum(-1, keepdim=True)[..., None], mass, 1)
    return Bins(shares, weight, mass, present.double(), total)
