"""Losses that compare averages over bins of pairs beside single pairs."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.losses.base import Loss, version
from torchbrdf.pairs import Pairs
from torchbrdf.precision import without_autocast
from torchbrdf.reduction import Reduction
from torchbrdf.roots import safe_sqrt

# A bin that holds less than this share of the pairs fades instead of saying much about little.
SHRINKAGE = 1e-3
# Numbers of an assignment that are kept for the next call with the same pairs.
CACHED = 1 << 24


class BinAssignment(NamedTuple):
    """Which bins pairs are in.

    Args:
        membership: the share of each pair in each bin, `(..., N, B)`.
        mass: what the bins hold, with their fading, `(..., 1, B)`, float64.
        pointwise_weight: how much the square of each difference counts, `(..., N, C)`.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.losses import LearnedLoss
        >>> pairs = Pairs.from_half_diff(*torch.full((3, 5), 0.5))
        >>> LearnedLoss().assignment(pairs, None, torch.ones(5, 3)).membership.shape
        torch.Size([5, 15])
    """

    membership: Tensor
    mass: Tensor
    pointwise_weight: Tensor


def bin_mass(membership: Tensor, weight: Tensor | None = None) -> Tensor:
    """What bins hold, with their fading, `(..., 1, B)`, float64; membership: `(..., N, B)`, weight: `(..., N|1, 1)`."""
    if weight is None:
        mass = membership.sum(-2, keepdim=True, dtype=torch.float64)
    else:
        weight = weight.expand(*weight.shape[:-2], membership.shape[-2], 1)
        mass = (weight.mT.to(membership) @ membership).double()
    return mass + SHRINKAGE * mass.sum(-1, keepdim=True)


class BinnedLoss(Loss):
    """sqrt(sum_b u_b <mean_c d_c^2>_b + |F m|^2), d = encode(prediction) - encode(target), m the averages <d_c>_b.

    < >_b is the weighted average over the pairs in bin b, into which a pair may belong by a share. A subclass gives
    `encode`, the shares of `membership`, how much the squares in each bin count, `square_weight` `(B,)`, and F,
    `mean_factor`, `(C B, K)`. Weights that differ by channel are made one by `collapse_channel_weights`.

    Args:
        reduction: as of `Loss`.

    Example:
        >>> from torchbrdf.losses import LearnedLoss
        >>> issubclass(LearnedLoss, BinnedLoss)
        True
    """

    objective = "binned"
    square_weight: Tensor

    def __init__(self, reduction: Reduction = "mean") -> None:
        super().__init__(reduction)
        self._assignment: tuple[Pairs, Tensor, tuple[int, torch.dtype, int], BinAssignment] | None = None

    def membership(self, pairs: Pairs) -> Tensor:
        """The share of each pair in each bin, `(..., N, B)`; the shares of a pair add up to 1."""
        raise NotImplementedError(f"{type(self).__name__}: expected a method membership, found none")

    def mean_factor(self, channels: int) -> Tensor:
        """The matrix whose product with averages `(..., C B)` has the square that counts, `(C B, K)`, float64."""
        raise NotImplementedError(f"{type(self).__name__}: expected a method mean_factor, found none")

    def collapse_channel_weights(self, difference: Tensor, weight: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Differences and weights that are the same for all channels, `(..., N, 1)`, in place of any."""
        raise NotImplementedError(f"{type(self).__name__}: expected a method collapse_channel_weights, found none")

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The distance of each material, `(...)`, float64."""
        self._check(prediction, target, pairs, weight)
        prediction, target, pairs = self._widened(prediction, target, pairs)
        if pairs is None:
            raise ShapeError(f"{type(self).__name__}: needs pairs, to sort them into bins")
        with without_autocast(prediction.device.type):
            encoded_target = self._cached_target(target, pairs, lambda: self.encode(target, pairs))
            difference = self.encode(prediction, pairs) - encoded_target
            difference, weight = self.collapse_channel_weights(difference, weight)
            own = self.assignment(pairs, weight, difference)
            weighed = difference if weight is None else difference * weight
            means = (weighed.mT @ own.membership).double() / own.mass
            squares = (weighed * difference).mul_(own.pointwise_weight).sum((-2, -1)).double()
            parts = means.flatten(-2) @ self.mean_factor(difference.shape[-1]).to(means.device)
            return safe_sqrt(squares + parts.square().sum(-1))

    def assignment(self, pairs: Pairs, weight: Tensor | None, like: Tensor) -> BinAssignment:
        """The bins for values `like` `(..., N, C)` under weights `(..., N|1, 1)`.

        Those without weights are kept for when the same pairs come again, as they do in every step of a fit.
        """
        count, channels = like.shape[-2:]
        kept, key = self._assignment, (channels, like.dtype, version(self.square_weight))
        if kept is not None and kept[0] is pairs and kept[1] is self.square_weight and kept[2] == key:
            if weight is None:
                return kept[3]
            shares = kept[3].membership
        else:
            shares = self.membership(pairs).to(like)
            shares = shares.expand(*shares.shape[:-2], count, shares.shape[-1])  # one pair may stand for all
        mass = bin_mass(shares, weight)
        each = shares @ (self.square_weight.to(mass) / (channels * mass)).mT.to(shares)
        own = BinAssignment(shares, mass, each.expand(*each.shape[:-1], channels).contiguous())
        if weight is None and shares.numel() <= CACHED and not (shares.requires_grad or torch.compiler.is_compiling()):
            self._assignment = pairs, self.square_weight, key, own
        return own

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_assignment": None}  # copies and other processes have other pairs
