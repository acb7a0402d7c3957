"""Losses that compare averages over groups of pairs beside single pairs."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchbrdf.losses.base import Loss, Reduction, safe_sqrt, version
from torchbrdf.pairs import Pairs

# A group that holds less than this share of the pairs fades instead of saying much about little.
FADE = 1e-3
# Numbers of a grouping that are kept for the next call with the same pairs.
KEPT = 1 << 24


class Grouping(NamedTuple):
    """shares: how much of each pair is in each group, `(..., N, G)`; held: what the groups hold, with their fading,
    `(..., 1, G)`, float64; profile: how much the square of each difference counts, `(..., N, C)`."""

    shares: Tensor
    held: Tensor
    profile: Tensor


def holdings(shares: Tensor, weight: Tensor | None = None) -> Tensor:
    """What groups hold, with their fading, `(..., 1, G)`, float64; shares: `(..., N, G)`, weight: `(..., N|1, 1)`."""
    if weight is None:
        held = shares.sum(-2, keepdim=True, dtype=torch.float64)
    else:
        held = (weight.expand(*weight.shape[:-2], shares.shape[-2], 1).mT.to(shares) @ shares).double()
    return held + FADE * held.sum(-1, keepdim=True)


class GroupedLoss(Loss):
    """sqrt(sum_g u_g <mean_c d_c^2>_g + |F m|^2), d = encode(prediction) - encode(target), m the averages <d_c>_g.

    < >_g is the weighted average over the pairs in group g, into which a pair may belong by a share. A subclass gives
    `encode` and `encode_slope`, the shares of `groups`, how much the squares in each group count, `square_weight`
    `(G,)`, and F, `root`, `(C G, K)`. Weights that differ by channel are made `even`.

    The square is one of residuals, so that Gauss-Newton solvers apply: `analytic` is false, but fits know it.
    """

    square_weight: Tensor

    def __init__(self, reduction: Reduction = "mean") -> None:
        super().__init__(reduction)
        self._kept: tuple[Pairs, Tensor, tuple[int, torch.dtype, int], Grouping] | None = None

    def groups(self, pairs: Pairs) -> Tensor:
        """How much of each pair is in each group, `(..., N, G)`; the shares of a pair add up to 1."""
        raise NotImplementedError

    def root(self, channels: int) -> Tensor:
        """The matrix whose product with averages `(..., C G)` has the square that counts, `(C G, K)`, float64."""
        raise NotImplementedError

    def even(self, difference: Tensor, weight: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Differences and weights that are the same for all channels, `(..., N, 1)`, in place of any."""
        raise NotImplementedError

    def penalty(self, difference: Tensor) -> Tensor:
        """The square, of single pairs."""
        return difference.square()

    def penalty_slope(self, difference: Tensor, width: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """The square is its own parabola."""
        return difference.square(), 2 * difference, difference.new_full((1, 1), 2)

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The distance of each material, `(...)`, float64."""
        self._check(prediction, target, pairs, weight)
        prediction, target, pairs = self._widened(prediction, target, pairs)
        assert pairs is not None
        difference = self.encode(prediction, pairs) - self.remembered(target, pairs, lambda: self.encode(target, pairs))
        difference, weight = self.even(difference, weight)
        own = self.grouping(pairs, weight, difference)
        weighed = difference if weight is None else difference * weight
        means = (weighed.mT @ own.shares).double() / own.held
        squares = (weighed * difference).mul_(own.profile).sum((-2, -1)).double()
        parts = means.flatten(-2) @ self.root(difference.shape[-1]).to(means.device)
        return safe_sqrt(squares + parts.square().sum(-1))

    def grouping(self, pairs: Pairs, weight: Tensor | None, like: Tensor) -> Grouping:
        """The groups for values `like` `(..., N, C)` under weights `(..., N|1, 1)`.

        Those without weights are kept for when the same pairs come again, as they do in every step of a fit.
        """
        count, channels = like.shape[-2:]
        kept, key = self._kept, (channels, like.dtype, version(self.square_weight))
        if kept is not None and kept[0] is pairs and kept[1] is self.square_weight and kept[2] == key:
            if weight is None:
                return kept[3]
            shares = kept[3].shares
        else:
            shares = self.groups(pairs).to(like)
            shares = shares.expand(*shares.shape[:-2], count, shares.shape[-1])  # one pair may stand for all
        held = holdings(shares, weight)
        profile = shares @ (self.square_weight.to(held) / (channels * held)).mT.to(shares)
        own = Grouping(shares, held, profile.expand(*profile.shape[:-1], channels).contiguous())
        if weight is None and shares.numel() <= KEPT and not (shares.requires_grad or torch.compiler.is_compiling()):
            self._kept = pairs, self.square_weight, key, own
        return own

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_kept": None}  # copies and other processes have other pairs
