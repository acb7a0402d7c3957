"""How numbers of several materials or pictures become one, as losses and image differences offer it."""

from typing import Literal

from torch import Tensor

from torchbrdf.errors import UsageError

Reduction = Literal["none", "mean", "sum"]


def check_reduction(owner: object, reduction: str) -> None:
    """Refuse a reduction that is none; owner: the loss or difference that is made.

    Raises:
        UsageError: it is not "none", "mean" or "sum".
    """
    if reduction not in ("none", "mean", "sum"):
        raise UsageError(f"{type(owner).__name__}: expected reduction none, mean or sum, found {reduction!r}")


def reduced(values: Tensor, reduction: Reduction) -> Tensor:
    """The values themselves, their mean or their sum."""
    if reduction == "none":
        return values
    return values.mean() if reduction == "mean" else values.sum()
