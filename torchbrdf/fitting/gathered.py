"""What several fits of the same materials share: sums over all pairs, their noise, and problems laid out."""

from collections.abc import Sequence
from concurrent.futures import Executor
from functools import cached_property, partial

import torch

from torchbrdf.fitting.batching import parallel_map
from torchbrdf.fitting.noise import NoiseRecords
from torchbrdf.fitting.pair_factors import factor_kinds, groups_of
from torchbrdf.fitting.shared import Shared
from torchbrdf.fitting.sufficient_statistics import (
    LEAST_PAIRS,
    SufficientStatistics,
    gather_statistics,
    without_idle_weight,
)
from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured
from torchbrdf.parallel import Lost


class Gathered:
    """What fits of the same materials share: sufficient statistics, made in one pass when they are asked for, and more.

    Args:
        measured: M materials, within the angle that fits shall see.
        models: what may be fitted.
        losses: under which.
        executor: what works on the materials, as of `torchbrdf.fit`.
        shared: problems laid out that fits leave for the next; by default a few tables.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import LogLoss, RMSLoss
        >>> from torchbrdf.measured import load, standins
        >>> rms, models = RMSLoss(), [make_model("ward", 2), make_model("ggx", 2)]
        >>> gathered = Gathered(load(standins()).batch([6]).within(20.0), models, [rms, LogLoss()])
        >>> [gathered.find(model, rms) is None for model in models]
        [False, True]
    """

    def __init__(
        self,
        measured: Measured,
        models: Sequence[Lobe],
        losses: Sequence[Loss],
        executor: Executor | None = None,
        shared: Shared | None = None,
    ) -> None:
        self.measured, self.executor = measured, executor
        self.kinds = tuple(dict.fromkeys(kind for model in models for kind in factor_kinds(model)))
        self.losses = [loss for loss in losses if loss.is_quadratic]
        self.noise, self.shared = NoiseRecords(measured), Shared() if shared is None else shared

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
        groups = groups_of(self.measured.pairs, LEAST_PAIRS)
        if groups is None:
            return {}
        work = partial(_gathered, self.losses, self.kinds)
        found = [part for _, part in parallel_map(work, self.measured, None, self.executor)]
        if any(isinstance(part, Lost) for part in found):
            return {}  # a process died over one of them; a fit says of which
        joined = [SufficientStatistics.joined(parts) for parts in zip(*found, strict=True)]
        return {id(loss): own for loss, own in zip(self.losses, joined, strict=True)}


def _gathered(
    losses: Sequence[Loss], kinds: Sequence[type[Lobe]], rows: list[int], measured: Measured
) -> list[SufficientStatistics]:
    """Of some materials, for each loss."""
    problem = without_idle_weight(Problem(measured.pairs, measured.values, measured.weight))
    groups = groups_of(problem.pairs, LEAST_PAIRS)
    assert groups is not None
    return gather_statistics(problem, losses, kinds, groups)
