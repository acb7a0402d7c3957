"""The bootstrap: draws with replacement, and percentile intervals of what they give."""

import torch
from torch import Tensor

from torchbrdf.errors import UsageError


def resample_counts(items: int, draws: int = 1000, seed: int = 0) -> Tensor:
    """How often each of several items is drawn when as many are drawn with replacement.

    Args:
        items: K, at least 1.
        draws: B, at least 0.
        seed: Of the random numbers.

    Returns:
        Counts `(B, K)`, int64; each row adds up to K.

    Raises:
        UsageError: `draws` is below 0.

    Source: B. Efron, R. Tibshirani, An Introduction to the Bootstrap, 1993.

    Example:
        >>> resample_counts(4, draws=3).sum(1)
        tensor([4, 4, 4])
    """
    if draws < 0:
        raise UsageError(f"bootstrap: draws: expected 0 or more, found {draws}")
    drawn = torch.randint(items, (draws, items), generator=torch.Generator("cpu").manual_seed(seed), device="cpu")
    return torch.zeros(draws, items, dtype=torch.long, device="cpu").scatter_add_(1, drawn, torch.ones_like(drawn))


def percentile_interval(replicates: Tensor, level: float = 0.95) -> Tensor:
    """Ends of the interval that holds the middle share of replicates; nan ones do not count.

    Args:
        replicates: `(B, L)`, of L figures.
        level: The share, between 0 and 1.

    Returns:
        Low and high ends, `(L, 2)`.

    Example:
        >>> percentile_interval(torch.arange(101.0)[:, None], level=0.9)
        tensor([[ 5., 95.]])
    """
    ends = torch.tensor([(1 - level) / 2, (1 + level) / 2], dtype=replicates.dtype, device=replicates.device)
    return replicates.nanquantile(ends, 0).T
