"""The fit of some of all materials: what a thread or a process does at a time."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.fitting.basis import is_separable
from torchbrdf.fitting.determined import undetermined
from torchbrdf.fitting.intervals import Intervals, find_intervals
from torchbrdf.fitting.objective import QuadraticObjective, make_objective
from torchbrdf.fitting.sampling import stratified
from torchbrdf.fitting.scoring import errors_seen
from torchbrdf.fitting.shared import Objectives, Shared
from torchbrdf.fitting.strategy import STRATEGIES, Outcome, Strategy, strategy_name
from torchbrdf.fitting.sufficient_statistics import SufficientStatistics, without_idle_weight
from torchbrdf.fitting.task import Task
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict, canonical, get_parameters, take_materials, with_parameters
from torchbrdf.losses import Loss, Problem
from torchbrdf.measured import Measured


@dataclass(frozen=True)
class Subset:
    """The pairs that a solver works on: so many of all, and the seed by which they are drawn."""

    total: int
    samples: int | None
    seed: int

    def index(self, loss: Loss) -> Tensor | None:
        """Which of the pairs; None: all."""
        return stratified(self.total, self.samples, self.seed) if loss.supports_subsampling else None

    def size(self, loss: Loss) -> int | None:
        """How many of the pairs; None: all."""
        index = self.index(loss)
        return None if index is None else len(index)


class Fitted(NamedTuple):
    """What was found of some materials."""

    values: ParameterDict
    outcome: Outcome
    error: Tensor
    subset_error: Tensor
    counts: Tensor
    intervals: dict[str, Intervals]
    open: ParameterDict


@dataclass
class FitSome:
    """The fit of some materials, the work of one thread or process at a time."""

    model: Lobe
    start: ParameterDict
    loss: Loss
    subset: Subset
    strategy: str | Strategy
    fit_diffuse: bool
    max_iterations: int
    intervals: str
    sums: SufficientStatistics | None
    shared: Shared

    def __call__(self, rows: list[int], measured: Measured) -> Fitted:
        """The fits of these rows of all materials, of which `measured` is that part."""
        values = take_materials(self.start, rows)
        part = with_parameters(self.model, values)
        if self.sums is not None:
            return self._by_sums(part, values, measured, self.sums.select(rows))
        loss, key = self.loss, (id(self.loss), *measured.materials, self.subset, is_separable(part))
        known = self.shared.take(key) or self._objectives(part, measured, loss)
        task = self._task(part, measured, known)
        outcome = self._run(task, values)
        fitted = with_parameters(part, outcome.values)
        values, counts, free = get_parameters(fitted), _counts(known.whole), task.all_free(self.fit_diffuse)
        subset_error = errors_seen(fitted, known.some or known.whole, loss, known.seen, free)
        error = subset_error if known.some is None else errors_seen(fitted, known.whole, loss, known.full, free)
        intervals = find_intervals(self.intervals, task.objective, values, free, counts, self.subset.seed)
        open_ = undetermined(task.objective, values, free)
        self.shared.put(key, known)
        return Fitted(values, outcome, error, subset_error, counts, intervals, open_)

    def _by_sums(self, part: Lobe, values: ParameterDict, measured: Measured, sums: SufficientStatistics) -> Fitted:
        """The fits from sufficient statistics: all pairs from the first step on."""
        objective = QuadraticObjective(sums, self.loss)
        task = Task(
            part,
            objective,
            max_iterations=self.max_iterations,
            under=partial(self._task_under, part, measured),
        )
        outcome = self._run(task, values)
        fitted = with_parameters(part, {name: value.to(values[name]) for name, value in outcome.values.items()})
        error, values = objective.errors(fitted), get_parameters(fitted)
        free = task.all_free(self.fit_diffuse)
        intervals = find_intervals(self.intervals, objective, values, free, sums.counts, self.subset.seed)
        open_ = undetermined(objective, values, free)
        return Fitted(values, outcome, error, error, sums.counts.long().cpu(), intervals, open_)

    def _run(self, task: Task, values: ParameterDict) -> Outcome:
        """What the strategy finds."""
        run = STRATEGIES[self.strategy] if isinstance(self.strategy, str) else self.strategy
        outcome = run(task, values, self.fit_diffuse)
        if not isinstance(outcome, Outcome):
            found = type(outcome).__name__
            raise UsageError(f"strategy {strategy_name(self.strategy)}: expected an Outcome from it, found {found}")
        outcome.values = canonical(task.model, outcome.values)
        return outcome

    def _objectives(self, model: Lobe, measured: Measured, loss: Loss) -> Objectives:
        """Those of these materials under a loss: of all pairs, and of the subset that the solver sees."""
        whole, index = without_idle_weight(loss.problem(measured)), self.subset.index(loss)
        some = None if index is None else loss.select(whole, index.to(measured.device))
        full = make_objective(model, whole, loss)
        return Objectives(whole, some, full, full if some is None else make_objective(model, some, loss))

    def _task(self, model: Lobe, measured: Measured, known: Objectives) -> Task:
        full = None if known.some is None else known.full
        return Task(model, known.seen, full, self.max_iterations, partial(self._task_under, model, measured))

    def _task_under(self, model: Lobe, measured: Measured, loss: Loss) -> Task:
        return self._task(model, measured, self._objectives(model, measured, loss))


def _counts(problem: Problem) -> Tensor:
    """Valid values of each material, `(M,)`."""
    if problem.weight is None:
        return torch.full((len(problem.target),), problem.target.shape[1:].numel(), dtype=torch.int64, device="cpu")
    return (problem.weight > 0).expand(len(problem.target), -1, problem.target.shape[-1]).sum((1, 2)).cpu()
