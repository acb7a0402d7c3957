"""The global strategy: many starts, of which the best few go on."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.fitting.data import stratified
from torchbrdf.fitting.lbfgs import Solution
from torchbrdf.fitting.seeds import seeds
from torchbrdf.fitting.solve import Task, descend, solve
from torchbrdf.fitting.staged import stages
from torchbrdf.fitting.strategy import STRATEGIES, Outcome
from torchbrdf.fitting.variables import Values, Variable

# Starts from the dictionary; the staged result is one more.
SEEDS = 6
# How many different minima go on from the first samples, and how many at most to all of them.
KEPT = 3
# One in so many of all samples is between the subset and all of them: steps there are cheap, and few are left to do.
SHARE = 6
# Errors that differ by less belong to the same minimum; minima within TIE of the best are worth another look.
SAME, TIE = 1e-4, 0.01


@STRATEGIES.register("global")
def global_search(task: Task, values: Values, fit_diffuse: bool) -> Outcome:
    """Find the best fit: starts from a dictionary of shapes, all parameters moved together, ever more samples.

    The starts (see `seeds`) and the staged result go through Levenberg-Marquardt on a few thousand samples; the best
    different minima on the whole subset; those that are within a hundredth of the best on all samples.
    """
    if not task.analytic:
        return _joint(task, values, fit_diffuse)
    parts, variables, everyone = task.parts, task.moved(fit_diffuse), task.everyone
    outcome = Outcome(values, starts=SEEDS + 1)
    few, curved = task.few, task.curved
    rounding = few.loss.rounding

    def quickly(start: Values, moved: list[Variable], present: list[int]) -> tuple[Values, Solution]:
        return descend(few, everyone, start, moved, present, max_iterations=20, tolerance=1e-4, rounding=rounding[:1])

    *_, (_, staged, _) = stages(task, values, fit_diffuse, quickly)
    tried = _join(seeds(few, values, fit_diffuse, SEEDS), staged)
    rivals = _Rivals(everyone.repeat(SEEDS + 1), tried)
    found = rivals.move(few, variables, parts, max_iterations=30, tolerance=1e-5, rounding=rounding[:2])
    outcome.add(f"{SEEDS + 1} starts, {few.extent}", *rivals.best(found))
    rivals.keep(found, KEPT, 1.0)
    last = curved.precision if task.whole is None else 1e-6
    rounding = curved.loss.rounding
    found = rivals.move(
        curved, variables, parts, max_iterations=task.max_iterations, tolerance=last, rounding=rounding[-2:]
    )
    outcome.add(f"best {KEPT}, {curved.extent}", *rivals.best(found))
    outcome.ties = rivals.ties(found)
    if curved is not task:
        outcome.add("the loss itself", *solve(task, outcome.values, variables, parts))
    if task.whole is not None:
        between = _between(task)
        if between is not None:
            rivals.keep(found, KEPT, TIE)
            found = rivals.move(between, variables, parts, max_iterations=50, tolerance=1e-7, rounding=rounding[-1:])
            outcome.add(f"{len(between.problem.pairs)} samples", *rivals.best(found))
        rivals.keep(found, KEPT, TIE if between is None else TIE / 5)
        found = rivals.move(task.finish, variables, parts, max_iterations=50, tolerance=1e-6, rounding=rounding[-1:])
        outcome.add(f"all {len(task.whole.pairs)} samples", *rivals.best(found))
    return outcome


def _between(task: Task) -> Task | None:
    """The task on a share of all samples, where those are many times what it works on."""
    whole = task.finish
    samples = stratified(len(whole.problem.pairs), len(whole.problem.pairs) // SHARE, 1)
    if samples is None or len(samples) < 2 * len(task.problem.pairs):
        return None
    return whole.on(samples.to(whole.problem.target.device))


def _joint(task: Task, values: Values, fit_diffuse: bool) -> Outcome:
    """For models and losses that need a graph: the staged procedure, then all parameters together."""
    outcome = Outcome(values)
    for step in stages(task, values, fit_diffuse, lambda *move: solve(task, *move)):
        outcome.add(*step)
    variables = task.moved(fit_diffuse)
    outcome.add("all parameters", *solve(task, outcome.values, variables, task.parts))
    if task.whole is not None:
        outcome.add("all parameters, all samples", *solve(task.finish, outcome.values, variables, task.parts))
    outcome.ties = [0] * len(task)
    return outcome


@dataclass
class _Rivals:
    """Problems that compete for being a material's fit: of which material each is, `(R,)`, and its values."""

    materials: Tensor
    values: Values

    def move(self, task: Task, variables: list[Variable], parts: list[int], **options: object) -> Solution:
        """Descend from where each is."""
        self.values, found = descend(task, self.materials, self.values, variables, parts, **options)  # type: ignore[arg-type]
        return found

    def best(self, found: Solution) -> tuple[Values, Solution]:
        """The best of each material."""
        order = self._order(found.value)
        first = torch.ones_like(order, dtype=torch.bool)
        first[1:] = self.materials[order][1:] != self.materials[order][:-1]
        rows = order[first]
        status = [found.status[row] for row in rows.tolist()]
        value, x = found.value[rows], found.x[rows]
        own = Solution(x, value, status, found.iterations[rows.cpu()], found.evaluations[rows.cpu()])
        return {key: values[rows] for key, values in self.values.items()}, own

    def keep(self, found: Solution, most: int, within: float) -> None:
        """Let only the best different ones of each material go on, with errors up to 1 + `within` times the best."""
        rows = self._different(found.value, most, within)
        self.materials = self.materials[rows]
        self.values = {key: values[rows] for key, values in self.values.items()}

    def ties(self, found: Solution) -> list[int]:
        """How many other minima each material has within TIE."""
        rows = self._different(found.value, len(found.value), TIE)
        return (torch.bincount(self.materials[rows], minlength=int(self.materials.max()) + 1) - 1).tolist()

    def _order(self, error: Tensor) -> Tensor:
        """Material after material, each by rising error; without one last."""
        rising = error.nan_to_num(torch.inf).argsort(stable=True)
        return rising[self.materials[rising].argsort(stable=True)]

    def _different(self, error: Tensor, most: int, within: float) -> Tensor:
        kept: list[int] = []
        before, count, lowest = -1, 0, 0.0
        last = 0.0
        order = self._order(error)
        for row, material, value in zip(
            order.tolist(), self.materials[order].tolist(), error[order].tolist(), strict=True
        ):
            if material != before:
                before, count, lowest, last = material, 1, value, value
                kept.append(row)
            elif count < most and value <= lowest * (1 + within) and value > last * (1 + SAME):
                kept.append(row)
                count, last = count + 1, value
        return torch.tensor(kept, device=error.device)


def _join(*several: Values) -> Values:
    return {key: torch.cat([values[key] for values in several]) for key in several[0]}
