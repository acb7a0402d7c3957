"""Sums over pairs that are all a fit under a quadratic loss needs, where lobes depend on shape by the half angle alone.

On the pairs of one theta_h every term of such lobes is f = sum_j H_j(theta_h; scalars) B_j(pair), in which no parameter
enters the B_j (`Lobe.pair_factors`). The sum of w (f - t)^2 over these pairs is then a quadratic function of the H_j
with the coefficients sum w B B', sum w t B and sum w t^2, which one pass over the pairs makes. The H_j follow from the
terms at as many probes, pairs of the group that tell the B_j apart, so that lobes are evaluated as anywhere else. Of
MERL's 900,000 bins 85 groups with a few probes each are left, in float64.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import torch
from torch import Tensor

from torchbrdf.fitting import channels
from torchbrdf.fitting.batching import parallel_map
from torchbrdf.fitting.pair_factors import Groups, Probes, candidates, factor_kinds, factors_of, pivots
from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import Lost

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
        right: sum w t B, `(M, G, J, 3)`.
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
        return replace(parts[0], **{name: torch.cat([getattr(part, name) for part in parts]) for name in _OF_MATERIALS})


_OF_MATERIALS = ("gram", "right", "zero", "total", "counts")


class Gathered:
    """The sufficient statistics of materials for several models and losses, made in one pass when they are asked for.

    Args:
        measured: M materials, within the angle that fits shall see.
        models: what may be fitted.
        losses: under which.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import LogLoss, RMSLoss
        >>> from torchbrdf.measured import load, standins
        >>> rms, models = RMSLoss(), [make_model("ward", 2), make_model("ggx", 2)]
        >>> gathered = Gathered(load(standins()).batch([6]).within(20.0), models, [rms, LogLoss()])
        >>> [gathered.find(model, rms) is None for model in models]
        [False, True]
    """

    def __init__(self, measured: Measured, models: Sequence[Lobe], losses: Sequence[Loss]) -> None:
        self.measured = measured
        self.kinds = tuple(dict.fromkeys(kind for model in models for kind in factor_kinds(model)))
        self.losses = [loss for loss in losses if loss.is_quadratic]

    def is_of(self, measured: Measured) -> bool:
        """Whether these are the sums of just these samples of just these materials."""
        own = self.measured
        same = own.samples is measured.samples or (
            own.samples is not None and measured.samples is not None and torch.equal(own.samples, measured.samples)
        )
        return (
            same
            and own.source is measured.source
            and own.materials == measured.materials
            and (own.max_theta == measured.max_theta)
        )

    def find(self, model: Lobe, loss: Loss) -> SufficientStatistics | None:
        """Those of a model under a loss; None where there are none, and the pairs themselves are needed."""
        kinds = factor_kinds(model)
        if not kinds or not {*kinds} <= {*self.kinds} or not any(one is loss for one in self.losses):
            return None
        by_loss = self._by_loss
        return by_loss[id(loss)].of_kinds(kinds) if by_loss else None

    @cached_property
    def _by_loss(self) -> dict[int, SufficientStatistics]:
        """By the losses' identities."""
        groups = Groups.of(self.measured.pairs, LEAST_PAIRS)
        if groups is None:
            return {}
        found = [part for _, part in parallel_map(partial(_gathered, self.losses, self.kinds), self.measured)]
        if any(isinstance(part, Lost) for part in found):
            return {}  # a process died over one of them; a fit says of which
        joined = [SufficientStatistics.joined(parts) for parts in zip(*found, strict=True)]
        return {id(loss): own for loss, own in zip(self.losses, joined, strict=True)}


def _gathered(
    losses: Sequence[Loss], kinds: Sequence[type[Lobe]], rows: list[int], measured: Measured
) -> list[SufficientStatistics]:
    """Of some materials, for each loss."""
    problem = Problem(measured.pairs, measured.values, measured.weight)
    groups = Groups.of(problem.pairs, LEAST_PAIRS)
    assert groups is not None
    return gather_statistics(problem, losses, kinds, groups)


def gather_statistics(
    problem: Problem, losses: Sequence[Loss], kinds: Sequence[type[Lobe]], groups: Groups
) -> list[SufficientStatistics]:
    """One pass over all pairs: the sums of each group under each loss, and the group's probes."""
    materials, sums = len(problem.target), [_Sums(problem) for _ in losses]
    probes, at_probes = [], []
    for index, start in zip(groups, groups.bounds, strict=False):
        pairs = problem.pairs.select(samples=index)
        wide = pairs.to(dtype=torch.float64)
        factors = torch.cat([factors_of(kind, wide) for kind in kinds])
        target = problem.target[:, index].double()
        squares = target.square()
        weight = None if problem.weight is None else problem.weight[:, index]
        for loss, own in zip(losses, sums, strict=True):
            own.add(loss, pairs, weight, factors, target, squares)
        some = candidates(0, len(pairs)).to(factors.device)
        place = some[pivots(factors[:, some])]
        at_probes.append(factors[:, place])
        probes.append(start + place)
    wide = problem.pairs.select(samples=groups.places(torch.cat(probes))).to(dtype=torch.float64)
    own_probes = {kind: Probes.of(kind, problem.pairs, groups) for kind in kinds}
    known, there = (own_probes, wide, torch.stack(at_probes)), problem.weight
    counts = target.new_full((materials,), len(problem.pairs)) if there is None else (there > 0).sum((1, 2)).double()
    return [SufficientStatistics(*known, *own.totals(), 3 * counts.expand(materials)) for own in sums]


class _Sums:
    """Those of a problem under one loss, group after group."""

    def __init__(self, problem: Problem) -> None:
        self.zero, self.total = torch.zeros(2, len(problem.target), dtype=torch.float64, device=problem.target.device)
        self.grams: list[Tensor] = []
        self.rights: list[Tensor] = []

    def add(
        self, loss: Loss, pairs: Pairs, weight: Tensor | None, factors: Tensor, target: Tensor, squares: Tensor
    ) -> None:
        """A group of n pairs; factors: `(J, n)`; target, and its squares: `(M, n, 3)`."""
        materials, count = target.shape[:2]
        nothing = pairs.cos_i.new_zeros(1, 1, count)
        rate = channels.encode_with_derivative(loss, nothing, pairs)[1].double()
        effective = channels.effective_weight(loss, pairs, weight)
        counted = torch.ones_like(nothing, dtype=torch.float64) if effective is None else effective.double()
        self.total += 3 * counted.sum((1, 2))
        counted = (counted * rate.square()).expand(materials, 1, -1)
        self.zero += torch.bmm(counted, squares).sum((1, 2))
        weighted = factors * counted
        self.grams.append(weighted @ factors.mT)
        self.rights.append(torch.bmm(weighted, target))

    def totals(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """gram, right, zero and total."""
        return torch.stack(self.grams, 1), torch.stack(self.rights, 1), self.zero, self.total
