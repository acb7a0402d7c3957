"""Experiments that observers answered, with the scales of each."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from torchbrdf.experiment.labels import loss_label, model_label
from torchbrdf.progress import Progress, part_of, quiet
from torchbrdf.psychophysics import Comparisons, Method, ObserverReport, Scales, observer_reports, scale
from torchbrdf.study import Answer, Plan

DRAWS = 1000
"""Of the bootstrap, and of the test of goodness."""


@dataclass(frozen=True)
class ScaledExperiment:
    """An experiment, its answers, and their scales. The plan is None where it does not know the answers' stimuli."""

    name: str
    answers: list[Answer]
    comparisons: Comparisons
    scales: Scales
    plan: Plan | None

    @cached_property
    def reports(self) -> list[ObserverReport]:
        """What each observer's answers look like."""
        return observer_reports(self.answers)

    @property
    def title(self) -> str:
        """What was compared."""
        named = f"Experiment {self.name}" if self.name else "Paired comparisons"
        return f"{named}: {self.plan.experiment(self.name).title}" if self.plan else named

    @property
    def order(self) -> list[str]:
        """The materials as figures show them."""
        plan = self.plan
        if plan is None:
            return sorted(self.scales.materials)
        return sorted(self.scales.materials, key=lambda name: plan.material(name).order)

    @property
    def stimuli(self) -> list[str]:
        """All stimuli, as tables show them."""
        there = {name for names in self.scales.stimuli for name in names}
        planned = self.plan.experiment(self.name).stimuli if self.plan else sorted(there)
        return [name for name in planned if name in there]

    def label(self, stimulus: str) -> str:
        """A stimulus for people."""
        what = self.plan.materials[0].stimuli.get(stimulus) if self.plan else None
        if what is None or what.model is None:
            return stimulus
        return f"{model_label(what.model)} {loss_label(what.loss or '')}".strip()


def scale_experiments(
    answers: Sequence[Answer],
    plan: Plan | None,
    method: Method = "likelihood",
    seed: int = 0,
    progress: Progress = quiet,
) -> list[ScaledExperiment]:
    """The scales of every experiment that there are answers to."""
    by_experiment: dict[str, list[Answer]] = {}
    for answer in answers:
        by_experiment.setdefault(answer.experiment, []).append(answer)
    scaled = []
    for k, (name, own) in enumerate(by_experiment.items()):
        comparisons = Comparisons.from_answers(own)
        known = plan if plan is not None and _planned(plan, name, comparisons) else None
        part = part_of(progress, 2 * DRAWS * k, 2 * DRAWS * len(by_experiment))
        scales = scale(comparisons, method=method, draws=DRAWS, seed=seed, progress=part)
        scaled.append(ScaledExperiment(name, own, comparisons, scales, known))
    return scaled


def _planned(plan: Plan, name: str, comparisons: Comparisons) -> bool:
    materials = {material.name: material for material in plan.materials}
    return name in [experiment.name for experiment in plan.experiments] and all(
        material in materials and set(stimuli) <= set(materials[material].stimuli)
        for material, stimuli in zip(comparisons.materials, comparisons.stimuli, strict=True)
    )
