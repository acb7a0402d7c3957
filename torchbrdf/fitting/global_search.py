"""The global strategy: many starts, of which the best few go on."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.fitting.initialization import has_dictionary, most_shape_parameters, starts_from_dictionary
from torchbrdf.fitting.objective import GaussNewtonObjective
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.fitting.quasi_random import quasi_random_starts
from torchbrdf.fitting.staged import minimizer_of, stages
from torchbrdf.fitting.strategy import STRATEGIES, Outcome
from torchbrdf.fitting.tabulated import TabulatedFit
from torchbrdf.fitting.tabulated_problem import is_tabulated
from torchbrdf.fitting.task import Task, lbfgs_fit, levenberg_marquardt_fit
from torchbrdf.lobes.parameter_dict import ParameterDict, take_materials
from torchbrdf.solvers import Solution


@dataclass(frozen=True)
class GlobalSearch:
    """Find the best fit: starts from a dictionary of shapes, all parameters moved together, ever more samples.

    The starts (see `initialization`) and the staged result go through Levenberg-Marquardt on a few thousand samples;
    the best different minima on the whole subset; those that are close to the best on all samples.

    Args:
        starts: from the dictionary; the staged result is one more, and so is one with two lobes of one shape that
            differ in F0, where lobes have that.
        shapes: of a lobe in the dictionary.
        beam: combinations of lobes that are extended by one more, from the third on.
        coarse_samples: that starts are tried on.
        kept: how many different minima go on from there, and how many at most to all samples.
        share: one in so many of all samples, or twice the subset, is between the subset and all of them, where steps
            are cheap, and few are left to do.
        same: errors that differ by less belong to the same minimum.
        near_optimal: minima within so much of the best are worth another look.
        quasi_random: starts all over the bounds of a model that the dictionary serves badly, as one of its lobes has
            several shape parameters, or not at all, as one is no albedo times a scalar function.
        first_samples: that they begin on.
        first_steps: after which the best of them are chosen; earlier, those that are slow at first are lost.
        chosen: how many of them, at most, go on.

    Example:
        >>> from torchbrdf.fitting import GlobalSearch
        >>> GlobalSearch(starts=12).kept
        3
    """

    starts: int = 6
    shapes: int = 16
    beam: int = 8
    coarse_samples: int = 4_000
    kept: int = 3
    share: int = 12
    same: float = 1e-4
    near_optimal: float = 0.01
    quasi_random: int = 32
    first_samples: int = 1_000
    first_steps: int = 40
    chosen: int = 12

    def __call__(self, task: Task, values: ParameterDict, fit_diffuse: bool) -> Outcome:
        """Fit."""
        if is_tabulated(task.model):
            return TabulatedFit()(task, values, fit_diffuse)
        objective = task.objective
        if not isinstance(objective, GaussNewtonObjective):
            return _by_gradient(task, values, fit_diffuse)
        free = task.all_free(fit_diffuse)
        outcome = Outcome(values)
        coarse, smooth = objective.coarse(self.coarse_samples), objective.surrogate()
        widths = coarse.loss.smoothing_widths

        def quickly(start: ParameterDict, parametrization: Parametrization) -> tuple[ParameterDict, Solution]:
            return levenberg_marquardt_fit(
                coarse, start, parametrization, max_iterations=20, ftol=1e-4, widths=widths[:1]
            )

        *_, (_, staged, _) = stages(task, values, fit_diffuse, quickly)
        candidates = self._starts(task, coarse, values, free, fit_diffuse).joined(objective.material_indices, staged)
        outcome.starts = int(torch.bincount(candidates.materials).max())
        errors = candidates.refine(coarse, max_iterations=30, ftol=1e-5, widths=widths[:1])
        outcome.add(f"{outcome.starts} starts, {coarse.describe_size()}", *candidates.best(errors))
        candidates.prune(errors, self.kept, 1.0)
        last = smooth.ftol if task.full is None else 1e-6
        widths = smooth.loss.smoothing_widths
        errors = candidates.refine(smooth, max_iterations=task.max_iterations, ftol=last, widths=widths[-2:])
        outcome.add(f"best {self.kept}, {smooth.describe_size()}", *candidates.best(errors))
        outcome.near_optimal = candidates.others_within(errors, self.near_optimal)
        if smooth is not objective:
            step = lbfgs_fit(objective, outcome.values, free, max_iterations=task.max_iterations)
            outcome.add("the loss itself", *step)
        if isinstance(task.full, GaussNewtonObjective):
            self._on_all_samples(task, task.full, outcome, candidates, errors)
        return outcome

    def _starts(
        self,
        task: Task,
        coarse: GaussNewtonObjective,
        values: ParameterDict,
        free: Parametrization,
        fit_diffuse: bool,
    ) -> "_Candidates":
        """From the dictionary, and, where it serves the model badly or not, the best from all over the bounds."""
        materials, by_dictionary = coarse.material_indices, None
        if has_dictionary(task.model):
            found = starts_from_dictionary(
                task.model, coarse, values, fit_diffuse, self.starts, shapes=self.shapes, beam=self.beam
            )
            count = len(next(iter(found.values()))) // len(materials)
            by_dictionary = _Candidates(materials.repeat(count), found, free, self.same)
            if most_shape_parameters(task.model) < 2 or not coarse.starts_are_cheap:
                return by_dictionary
        found = quasi_random_starts(free, values, self.quasi_random)
        candidates = _Candidates(materials.repeat(self.quasi_random), found, free, self.same)
        first, widths = coarse.coarse(self.first_samples), coarse.loss.smoothing_widths[:1]
        errors = candidates.refine(first, max_iterations=self.first_steps, ftol=1e-4, widths=widths)
        candidates.prune(errors, self.chosen, torch.inf)
        return by_dictionary.joined(candidates.materials, candidates.values) if by_dictionary else candidates

    def _on_all_samples(
        self, task: Task, full: GaussNewtonObjective, outcome: Outcome, candidates: "_Candidates", errors: Solution
    ) -> None:
        """The minima that are close to the best, on ever more samples."""
        near, count = self.near_optimal, len(full.problem.pairs)
        last = full.loss.smoothing_widths[-1:]
        some = max(count // self.share, 2 * len(task.objective.problem.pairs))
        if count >= 3 * some:
            candidates.prune(errors, self.kept, near)
            between, near = full.subsample(some, 1), near / 5
            errors = candidates.refine(between, max_iterations=50, ftol=1e-7, widths=last)
            outcome.add(between.describe_size(), *candidates.best(errors))
        candidates.prune(errors, self.kept, near)
        errors = candidates.refine(full, max_iterations=50, ftol=1e-5, widths=last)
        outcome.add(f"all {full.describe_size()}", *candidates.best(errors))


STRATEGIES.register("global")(GlobalSearch())


def _by_gradient(task: Task, values: ParameterDict, fit_diffuse: bool) -> Outcome:
    """For objectives without curvature: the staged procedure, then all parameters together."""
    outcome = Outcome(values)
    for step in stages(task, values, fit_diffuse, minimizer_of(task)):
        outcome.add(*step)
    free, most = task.all_free(fit_diffuse), task.max_iterations
    outcome.add("all parameters", *lbfgs_fit(task.objective, outcome.values, free, max_iterations=most))
    if task.full is not None:
        end = lbfgs_fit(task.full, outcome.values, free, max_iterations=most)
        outcome.add("all parameters, all samples", *end)
    outcome.near_optimal = [0] * len(task)
    return outcome


@dataclass
class _Candidates:
    """Problems that compete for being a material's fit: of which material each is, `(R,)`, and its parameters."""

    materials: Tensor
    values: ParameterDict
    free: Parametrization
    same: float

    def joined(self, materials: Tensor, values: ParameterDict) -> "_Candidates":
        """With more of them."""
        both = {name: torch.cat([own, values[name]]) for name, own in self.values.items()}
        return _Candidates(torch.cat([self.materials, materials]), both, self.free, self.same)

    def refine(
        self, objective: GaussNewtonObjective, *, max_iterations: int, ftol: float, widths: tuple[float | None, ...]
    ) -> Solution:
        """From where each is, by Levenberg-Marquardt."""
        self.values, found = levenberg_marquardt_fit(
            objective,
            self.values,
            self.free,
            materials=self.materials,
            max_iterations=max_iterations,
            ftol=ftol,
            widths=widths,
        )
        return found

    def best(self, found: Solution) -> tuple[ParameterDict, Solution]:
        """The best of each material."""
        order = self._order(found.value)
        first = torch.ones_like(order, dtype=torch.bool)
        first[1:] = self.materials[order][1:] != self.materials[order][:-1]
        rows = order[first]
        status = [found.status[row] for row in rows.tolist()]
        return take_materials(self.values, rows), Solution(
            found.x[rows], found.value[rows], status, found.iterations[rows.cpu()]
        )

    def prune(self, found: Solution, most: int, within: float) -> None:
        """Let only the best different ones of each material go on, with errors up to 1 + `within` times the best."""
        rows = self._different(found.value, most, within)
        self.materials, self.values = self.materials[rows], take_materials(self.values, rows)

    def others_within(self, found: Solution, within: float) -> list[int]:
        """How many other minima each material has within so much of the best."""
        rows = self._different(found.value, len(found.value), within)
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
            elif count < most and value <= lowest * (1 + within) and value > last * (1 + self.same):
                kept.append(row)
                count, last = count + 1, value
        return torch.tensor(kept, dtype=torch.int64, device=error.device)
