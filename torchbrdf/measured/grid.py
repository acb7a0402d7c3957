"""Interpolation in tables on a regular grid, some of whose entries are invalid.

A table is `(K, 4)`: three channels and 1, or 0, 0, 0, 0 for an invalid entry. A position is a fractional index on every
axis of the grid, and the table's rows follow in C order.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from torchbrdf.measured.format import Interpolation
from torchbrdf.pairs import Pairs

CHUNK = 1 << 17


def chunks(pairs: Pairs) -> Iterator[tuple[slice, Pairs]]:
    """Parts of the pairs, small enough that what is derived from them does not matter for memory."""
    for start in range(0, len(pairs), CHUNK):
        part = slice(start, start + CHUNK)
        yield part, pairs.select(samples=part)


def nearest_rows(position: Sequence[Tensor], shape: Sequence[int]) -> Tensor:
    """The row nearest to each position, `(N,)`; positions beyond the grid are moved to its edge."""
    index = torch.zeros_like(position[0], dtype=torch.int32)
    for x, size in zip(position, shape, strict=True):
        index = index * size + (x.nan_to_num(0) + 0.5).floor().clamp(0, size - 1).to(torch.int32)
    return index


def neighbours(position: Sequence[Tensor], shape: Sequence[int]) -> tuple[Tensor, Tensor]:
    """The 2^d rows around each position and their weights for multilinear interpolation, `(N, 2^d)` both."""
    # Column by column: broadcasting over an inner dimension of 2 would cost five times as much.
    indices, weights = [torch.zeros_like(position[0], dtype=torch.int32)], [torch.ones_like(position[0])]
    for x, size in zip(position, shape, strict=True):
        x = x.nan_to_num(0).clamp(0, size - 1)
        low = x.floor().clamp(max=max(size - 2, 0))
        first, share = low.to(torch.int32), x - low
        steps = (first, first + min(1, size - 1))
        indices = [index * size + step for index in indices for step in steps]
        weights = [weight * part for weight in weights for part in (low + 1 - x, share)]
    return torch.stack(indices, -1), torch.stack(weights, -1)


def weighted_rows(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """Weighted sums of rows of a table `(K, C)`, `(N, C)`: what embedding_bag does, without keeping the rows."""
    return functional.embedding_bag(index, table, per_sample_weights=weight, mode="sum")


def interpolate(
    table: Tensor, position: Sequence[Tensor], shape: Sequence[int], interpolation: Interpolation
) -> tuple[Tensor, Tensor]:
    """Values `(N, C)` from the valid neighbours, and where there are none, `(N,)`."""
    if interpolation == "nearest":
        rows = table[nearest_rows(position, shape)]
    else:
        rows = weighted_rows(table, *neighbours(position, shape))
    return normalized(rows)


def normalized(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Values `(N, C)` of weighted rows `(N, C + 1)`, the last the valid share, and where that is 0, `(N,)`."""
    share = rows[:, -1]
    missing = share <= 0
    return rows[:, :-1] / torch.where(missing, 1, share)[:, None], missing


def nearest_valid(valid: np.ndarray) -> np.ndarray:
    """For every entry of a grid the row of the valid entry nearest to it, by distance in entries, `(K,)`."""
    from scipy import ndimage  # late, as it takes long to import, and most tables have no holes

    place = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return np.ravel_multi_index(tuple(place), valid.shape).reshape(-1).astype(np.int32)
