"""Pairs in blocks of one half angle each, so that sums over them are products of whole batches."""

from collections.abc import Iterator
from itertools import pairwise

import torch
from torch import Tensor

from torchbrdf.fitting.pair_factors import Groups, factors_of, kept
from torchbrdf.lobes import Lobe
from torchbrdf.pairs import Pairs

# Pairs of a block: of few pairs not too many to fill up with, of many not too many blocks.
SMALLEST_BLOCK, LARGEST_BLOCK = 16, 512
# Numbers that are worked on at a time, in five arrays: so many that calls do not count, and few enough for a cache.
WORK = {"cpu": 1 << 17, "cuda": 1 << 26}


class Layout:
    """Pairs in blocks of one half angle each, the last of a group filled up.

    size: of a block; group: of each of B blocks; sample: which of the pairs are in it, `(B, size)`; real: 1, or 0 of
    what fills up.
    """

    def __init__(self, pairs: Pairs, groups: Groups) -> None:
        self.groups, self.device = groups, pairs.device
        average = len(pairs) // (2 * len(groups))
        self.size = min(max(1 << average.bit_length(), SMALLEST_BLOCK), LARGEST_BLOCK)
        bounds = torch.tensor(groups.bounds, dtype=torch.int64, device=pairs.device)
        count = bounds.diff()
        blocks = (count + self.size - 1) // self.size
        every = torch.arange(len(groups), dtype=torch.int64, device=pairs.device)
        self.group = every.repeat_interleave(blocks)
        self._firsts = [0, *blocks.cumsum(0).tolist()]
        rank = torch.arange(len(self.group), dtype=torch.int64, device=pairs.device)
        rank = (rank - (blocks.cumsum(0) - blocks)[self.group]) * self.size
        place = rank[:, None] + torch.arange(self.size, dtype=torch.int64, device=pairs.device)
        most = count[self.group, None]
        self.sample = groups.places(bounds[self.group, None] + torch.minimum(place, most - 1))
        self.real = (place < most).to(pairs.dtype)

    def spread(self, values: Tensor) -> Tensor:
        """Values of pairs `(..., N)`, `(B, ..., size)`, contiguous, 0 in what fills up."""
        shape = values.shape[:-1]
        found = values.new_zeros(len(self.group), *shape, self.size)
        sorted_values = values if self.groups.order is None else values.index_select(-1, self.groups.order)
        for (first, stop), (start, end) in zip(pairwise(self._firsts), pairwise(self.groups.bounds), strict=True):
            full = (end - start) // self.size
            place, last = start + full * self.size, first + full
            found[first:last] = sorted_values[..., start:place].unflatten(-1, (full, self.size)).movedim(-2, 0)
            if last < stop:
                found[last, ..., : end - place] = sorted_values[..., place:end]
        return found

    def parts(self, rows: int) -> Iterator[slice]:
        """Blocks in parts, so small that arrays of a number for each of so many channels of fits stay in the cache."""
        numbers = WORK.get(self.device.type, WORK["cpu"])
        step = max(1, numbers // (rows * self.size))
        for start in range(0, len(self.group), step):
            yield slice(start, min(start + step, len(self.group)))


def spread_factors(kind: type[Lobe], pairs: Pairs, layout: Layout) -> Tensor:
    """The B_j of a kind in blocks, `(B, J, size)`, 0 in what fills up, in the dtype of the pairs; kept."""
    return kept(pairs, (spread_factors, kind), lambda: layout.spread(factors_of(kind, pairs)))
