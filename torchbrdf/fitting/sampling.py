"""Subsets of pairs, and pairs in parts that a processor's cache holds."""

from collections.abc import Iterator

import torch
from torch import Tensor

from torchbrdf.pairs import Pairs

# Numbers (fits times pairs) that are worked on at a time: on a processor as many as its cache holds of some dozen
# arrays (one of float32 is 128 KiB), on a GPU as many as keep it busy.
CHUNK = {"cpu": 1 << 15, "cuda": 1 << 24}


def stratified(total: int, samples: int | None, seed: int) -> Tensor | None:
    """A stratified random subset of range(total).

    Every index is as likely as any other, so that a mean over the subset estimates the whole mean without bias.

    Args:
        total: how many there are.
        samples: how many are wanted; None: all.
        seed: of the random numbers.

    Returns:
        One index from each of `samples` equal stretches, rising, `(samples,)`; None if that is all of it.

    Example:
        >>> index = stratified(1000, 10, seed=0)
        >>> (index // 100).tolist()
        [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
    """
    if samples is None or samples >= total:
        return None
    generator = torch.Generator("cpu").manual_seed(seed)
    within = torch.rand(samples, generator=generator, dtype=torch.float64, device="cpu")
    place = torch.arange(samples, dtype=torch.float64, device="cpu") + within
    return (place * (total / samples)).long().clamp_max(total - 1)


def chunked(pairs: Pairs, fits: int) -> Iterator[tuple[slice, Pairs]]:
    """The pairs in parts, so small that arrays of one number for each of so many fits stay in the cache."""
    size = _size(fits, pairs)
    for start in range(0, len(pairs), size):
        part = slice(start, start + size)
        yield part, pairs.select(samples=part)


class Chunks:
    """As `chunked`, but kept, with what lobes derive from the pairs."""

    def __init__(self, pairs: Pairs) -> None:
        self.pairs = pairs
        self._kept: dict[int, list[tuple[slice, Pairs]]] = {}

    def __call__(self, fits: int) -> list[tuple[slice, Pairs]]:
        """The parts for so many fits."""
        size = _size(fits, self.pairs)
        if size not in self._kept:
            self._kept[size] = list(chunked(self.pairs, fits))
        return self._kept[size]


def _size(fits: int, pairs: Pairs) -> int:
    """Pairs of a part, a power of 2."""
    numbers = CHUNK.get(pairs.device.type, CHUNK["cpu"])
    return 1 << max(numbers // max(fits, 1), 256).bit_length() - 1
