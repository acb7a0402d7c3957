"""Sums over pairs that are all a fit under a quadratic loss needs, where lobes depend on shape by the half angle alone.

On the pairs of one theta_h every term of such lobes is f = sum_j H_j(theta_h; scalars) B_j(pair), in which no parameter
enters the B_j (`Lobe.pair_factors`). The sum of w (f - t)^2 over these pairs is then a quadratic function of the H_j
with the coefficients sum w B B', sum w t B and sum w t^2, which one pass over the pairs makes. The H_j follow from the
terms at as many probes, pairs of the group that tell the B_j apart, so that lobes are evaluated as anywhere else. Of
MERL's 900,000 bins 85 groups with a few probes each are left, in float64.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchbrdf.fitting import channels
from torchbrdf.fitting.layout import Layout, spread_factors
from torchbrdf.fitting.pair_factors import (
    Groups,
    Probes,
    chosen_probes,
    kept,
    probes_of,
)
from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss, Problem
from torchbrdf.pairs import Pairs

# Pairs of a group, on average, from which on sums are worth their pass.
LEAST_PAIRS = 64


@dataclass(frozen=True)
class SufficientStatistics:
    """What is left of M materials under one loss: sums over each of G groups.

    Args:
        own: where the lobes of each kind are evaluated; of all kinds together there are J factors B.
        probes: P of each group, `(1, G P)`, float64, which tell all factors apart, for functions of any kind.
        at_probes: the factors there, `(G, J, P)`, float64 as all that follows.
        gram: sum w B B', `(M, G, J, J)`; w is the weight times the square of what the loss multiplies values by.
        right: sum w t B, `(M, G, J, C)`.
        zero: sum w t^2 over all pairs and channels, `(M,)`.
        total: the sum of the weights, over channels, too, `(M,)`.
        counts: how many values count, `(M,)`.
    """

    own: dict[type[Lobe], Probes]
    probes: Pairs
    at_probes: Tensor
    gram: Tensor
    right: Tensor
    zero: Tensor
    total: Tensor
    counts: Tensor

    def select(self, rows: Sequence[int] | Tensor) -> "SufficientStatistics":
        """Those of some materials."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _OF_MATERIALS})

    def of_kinds(self, kinds: Sequence[type[Lobe]]) -> "SufficientStatistics":
        """Those of some kinds of lobes."""
        chosen, start = dict[type[Lobe], list[int]](), 0
        for kind, own in self.own.items():
            size = own.inverse.shape[1]
            chosen[kind] = list(range(start, start + size))
            start += size
        rows = [j for kind in kinds for j in chosen[kind]]
        return replace(
            self,
            own={kind: self.own[kind] for kind in kinds},
            at_probes=self.at_probes[:, rows],
            gram=self.gram[:, :, rows][..., rows],
            right=self.right[:, :, rows],
        )

    @classmethod
    def joined(cls, parts: Sequence["SufficientStatistics"]) -> "SufficientStatistics":
        """Those of several batches of materials as one."""
        sums: dict[str, Any] = {name: torch.cat([getattr(part, name) for part in parts]) for name in _OF_MATERIALS}
        return replace(parts[0], **sums)


_OF_MATERIALS = ("gram", "right", "zero", "total", "counts")


def without_idle_weight(problem: Problem) -> Problem:
    """Weights that are all 1 say nothing: leave them out of every step."""
    if problem.weight is not None and bool((problem.weight == 1).all()):
        return Problem(problem.pairs, problem.target)
    return problem


def gather_statistics(
    problem: Problem, losses: Sequence[Loss], kinds: Sequence[type[Lobe]], groups: Groups
) -> list[SufficientStatistics]:
    """One pass over all pairs: the sums of each group under each loss, and the group's probes."""
    pairs, materials = problem.pairs, len(problem.target)
    layout = kept(pairs, Layout, lambda: Layout(pairs, groups))
    factors = torch.cat([spread_factors(kind, pairs, layout) for kind in kinds], 1)
    probes, at_probes = kept(pairs, (Probes, *kinds), lambda: chosen_probes(kinds, pairs, groups))
    sums = [_Sums(problem, loss, layout, factors) for loss in losses]
    spread = layout.spread(problem.target.mT)
    for part in layout.parts(materials * problem.target.shape[2]):
        target = spread[part].double()
        for own in sums:
            own.add(part, target)
    known, there = ({kind: probes_of(kind, pairs, groups) for kind in kinds}, probes, at_probes), problem.weight
    counts = problem.target.new_full((materials,), len(pairs)) if there is None else (there > 0).sum((1, 2)).double()
    counts = problem.target.shape[2] * counts.expand(materials)
    return [SufficientStatistics(*known, *own.totals(), counts) for own in sums]


class _Sums:
    """Those of a problem under one loss, some blocks after others.

    counted: the weight of pairs times the square of what the loss multiplies values by, `(B, M|1, size)`.
    """

    def __init__(self, problem: Problem, loss: Loss, layout: Layout, factors: Tensor) -> None:
        self.layout, self.factors = layout, factors
        pairs, target = problem.pairs, problem.target
        rate = channels.encode_with_derivative(loss, pairs.cos_i.new_zeros(1, 1, len(pairs)), pairs)[1]
        effective = channels.effective_weight(loss, pairs, problem.weight)
        counted = torch.ones_like(target[:1, :, :1].mT) if effective is None else effective
        counted = counted.expand(-1, -1, len(pairs))
        self.total = target.shape[2] * counted.sum((1, 2), dtype=torch.float64).expand(len(target))
        square = counted * rate.to(counted).square()
        self.counted = layout.spread(square[:, 0])
        self.zero = torch.zeros(len(target), dtype=torch.float64, device=target.device)
        count = factors.shape[1]
        shape = (len(layout.groups), len(self.counted[0]), count)
        self.gram = self.zero.new_zeros(*shape, count)
        self.right = self.zero.new_zeros(len(layout.groups), len(target), count, target.shape[2])

    def add(self, part: slice, target: Tensor) -> None:
        """Some blocks; target: `(b, M, C, size)`, float64."""
        counted, factors, group = self.counted[part].double(), self.factors[part].double(), self.layout.group[part]
        weighted = target * counted[:, :, None]
        right = torch.bmm(weighted.flatten(1, 2), factors.mT).unflatten(1, target.shape[1:3])
        self.right.index_add_(0, group, right.mT)
        self.zero += weighted.mul_(target).flatten(2).sum(2).sum(0)
        for k in range(counted.shape[1]):
            self.gram[:, k].index_add_(0, group, torch.bmm(factors * counted[:, k, None], factors.mT))

    def totals(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """gram, right, zero and total."""
        gram, right = self.gram.transpose(0, 1), self.right.transpose(0, 1)
        return gram.expand(len(right), -1, -1, -1), right, self.zero, self.total
