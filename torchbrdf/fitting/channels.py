"""Losses with channels before pairs: values `(M, C, N)`, as objectives have them; losses have `(M, N, C)`."""

from torch import Tensor

from torchbrdf.losses import Loss
from torchbrdf.pairs import Pairs


def encode(loss: Loss, values: Tensor, pairs: Pairs) -> Tensor:
    """`Loss.encode`."""
    return loss.encode(values.mT, pairs).mT


def encode_with_derivative(loss: Loss, values: Tensor, pairs: Pairs) -> tuple[Tensor, Tensor]:
    """`Loss.encode_with_derivative`."""
    encoded, rate = loss.encode_with_derivative(values.mT, pairs)
    return encoded.mT, rate.mT


def effective_weight(loss: Loss, pairs: Pairs, weight: Tensor | None) -> Tensor | None:
    """`Loss.effective_weight` of a problem's weight `(M|1, N, 1|C)`, `(M|1, 1|C, N)`."""
    found = loss.effective_weight(pairs, weight)
    return None if found is None else found.mT
