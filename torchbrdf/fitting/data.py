"""What a fit is compared with, laid out for speed."""

from collections.abc import Iterator

import torch
from torch import Tensor

from torchbrdf.fitting.averages import Groups
from torchbrdf.losses import GroupedLoss, Loss, Problem
from torchbrdf.pairs import Pairs

# Numbers (fits times pairs) that are worked on at a time: on a processor as many as its cache holds of some dozen
# arrays (one of float32 is 128 KiB), on a GPU as many as keep it busy.
AT_ONCE = {"cpu": 1 << 15, "cuda": 1 << 24}


class Data:
    """A problem under a loss: targets encoded once, channels before pairs, and pairs that keep what lobes derive.

    target: `(M, 3, N)`; weight: `(M|1, 1|3, N)` or None; total: the sum of weights over pairs and channels, `(M,)`;
    black: the squared error of a prediction that is 0 everywhere, `(M,)`; spread: the mean of the targets' magnitude,
    `(M,)`; both are 1 where they would be 0 or there is no data, so that they can serve as units. groups: those of a
    loss that has some; they divide for themselves, so that total is 1.
    """

    def __init__(self, problem: Problem, loss: Loss) -> None:
        self.loss, self.pairs, self.chunks = loss, problem.pairs, Chunks(problem.pairs)
        materials, count = problem.target.shape[:2]
        self.target = problem.target.new_empty(materials, 3, count)
        self.groups = Groups(problem, loss) if isinstance(loss, GroupedLoss) else None
        weight = loss.counted(self.pairs, problem.weight) if self.groups is None else self.groups.weight
        self.weight = None if weight is None else weight.transpose(1, 2)
        sums = torch.zeros(3, materials, dtype=torch.float64, device=self.target.device)
        for part, pairs in chunked(self.pairs, materials):
            own = problem.target[:, part].transpose(1, 2).contiguous().transpose(1, 2)
            encoded = loss.encode(own, pairs)
            black = loss.penalty(loss.encode(torch.zeros_like(own), pairs) - encoded)
            self.target[..., part] = encoded.transpose(1, 2)
            counted = torch.ones_like(own[:1, :, :1]) if weight is None else weight[:, part]
            counted = counted.expand(materials, own.shape[1], 3)
            sums += torch.stack(
                [one.sum((1, 2)).double() for one in (counted, black * counted, encoded.abs() * counted)]
            )
        self.total, black, size = sums
        self.spread = torch.where(size > 0, size / self.total, 1)
        black = black / self.total
        if self.groups is not None:
            self.total = torch.ones_like(size)
            dark = torch.zeros_like(problem.target)
            black = loss.error(dark, problem.target, self.pairs, problem.weight).square()
        self.black = torch.where(black > 0, black, 1)

    def __len__(self) -> int:
        return len(self.target)

    def part(self, samples: slice, materials: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Targets and weights of some samples, for these materials."""
        target = self.target[..., samples]
        weight = None if self.weight is None else self.weight[..., samples]
        if materials is not None:
            target = target[materials]
            weight = weight[materials] if weight is not None and len(weight) > 1 else weight
        return target, weight


class Chunks:
    """As `chunked`, but kept, with what lobes derive from the pairs."""

    def __init__(self, pairs: Pairs) -> None:
        self.pairs = pairs
        self._kept: dict[int, list[tuple[slice, Pairs]]] = {}

    def __call__(self, fits: int) -> list[tuple[slice, Pairs]]:
        size = _size(fits, self.pairs)
        if size not in self._kept:
            self._kept[size] = list(chunked(self.pairs, fits))
        return self._kept[size]


def chunked(pairs: Pairs, fits: int) -> Iterator[tuple[slice, Pairs]]:
    """The pairs in parts, so small that arrays of one number for each of so many fits stay in the cache."""
    size = _size(fits, pairs)
    for start in range(0, len(pairs), size):
        part = slice(start, start + size)
        yield part, pairs.select(samples=part)


def _size(fits: int, pairs: Pairs) -> int:
    """Pairs of a part, a power of 2."""
    at_once = AT_ONCE.get(pairs.device.type, AT_ONCE["cpu"])
    return 1 << max(at_once // max(fits, 1), 256).bit_length() - 1


def stratified(total: int, samples: int | None, seed: int) -> Tensor | None:
    """One index, drawn at random, from each of `samples` equal stretches of range(total); None if that is all of it.

    Every index is as likely as any other, so that a mean over the subset estimates the whole mean without bias.
    """
    if samples is None or samples >= total:
        return None
    generator = torch.Generator().manual_seed(seed)
    within = torch.rand(samples, generator=generator, dtype=torch.float64)
    return ((torch.arange(samples, dtype=torch.float64) + within) * (total / samples)).long().clamp_max(total - 1)
