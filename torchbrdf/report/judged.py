"""Experiments as observers judged them: the scales of each, and the figure of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from torchbrdf.psychophysics import Comparisons, Method, ObserverReport, Scales, observer_reports, scale
from torchbrdf.report.claims import confused
from torchbrdf.report.labels import loss_label, model_label
from torchbrdf.report.scale_figures import Line, Shown, dots_figure, lines_figure
from torchbrdf.study import MEASURED, Answer, Plan

# More lines than these are no figure any more.
MOST_LINES = 12


@dataclass(frozen=True)
class Judged:
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
        asked = self.plan.experiment(self.name).stimuli if self.plan else sorted(there)
        return [name for name in asked if name in there]

    def label(self, stimulus: str) -> str:
        """A stimulus for people."""
        what = self.plan.materials[0].stimuli.get(stimulus) if self.plan else None
        if what is None or what.model is None:
            return stimulus
        return f"{model_label(what.model)} {loss_label(what.loss or '')}".strip()


def judge(answers: Sequence[Answer], plan: Plan | None, method: Method = "likelihood", seed: int = 0) -> list[Judged]:
    """The scales of every experiment that there are answers to."""
    judged = []
    for name in dict.fromkeys(answer.experiment for answer in answers):
        own = [answer for answer in answers if answer.experiment == name]
        comparisons = Comparisons.from_answers(own)
        known = plan if plan is not None and _planned(plan, name, comparisons) else None
        judged.append(Judged(name, own, comparisons, scale(comparisons, method=method, seed=seed), known))
    return judged


def _planned(plan: Plan, name: str, comparisons: Comparisons) -> bool:
    materials = {material.name: material for material in plan.materials}
    return name in [experiment.name for experiment in plan.experiments] and all(
        material in materials and set(stimuli) <= set(materials[material].stimuli)
        for material, stimuli in zip(comparisons.materials, comparisons.stimuli, strict=True)
    )


def draw(judged: Judged, path: Path, mark: str) -> str:
    """The paper's Figure 5 or 6, or dots where no plan says what belongs together; gives its caption."""
    plan = judged.plan
    lost = confused(judged.scales)
    values = {
        (material, name): Shown(
            record["scale"],
            record["low"],
            record["high"],
            outlier=plan is not None and plan.material(material).stimuli[name].outlier,
            confused=name in lost[material],
        )
        for record in judged.scales.records()
        for material, name in [(record["material"], record["stimulus"])]
    }
    panels = _panels(judged)
    bars = "Bars: 95 % intervals."
    if panels and max(map(len, panels.values())) <= MOST_LINES and len(judged.order) > 1:
        lines_figure(path, judged.order, panels, values, mark)
        said = ["Scale values, materials by rising DoI angle (sharpest highlight first).", bars]
        said += ["Black rectangles: fits stuck in a local minimum."] if any(p.outlier for p in values.values()) else []
        said += ["Rings: confused with the measured material."] if any(map(len, lost.values())) else []
        return " ".join(said)
    dots_figure(path, judged.order, values, mark)
    return f"Scale values of each material's stimuli. {bars}"


def _panels(judged: Judged) -> dict[str, list[Line]]:
    """A panel a model where there are several metrics; else one. What is no fit is in every panel."""
    if judged.plan is None:
        return {}
    experiment = judged.plan.experiment(judged.name)
    stimuli = {name: judged.plan.materials[0].stimuli[name] for name in experiment.stimuli}
    others = [Line(name, name) for name, what in stimuli.items() if what.model is None and name != MEASURED]
    others += [Line(name, name, black=True) for name in stimuli if name == MEASURED]
    if len({what.loss for what in stimuli.values()} - {None}) < 2:
        fits = [Line(model_label(what.model), name) for name, what in stimuli.items() if what.model]
        return {experiment.title: fits + others}
    return {
        model_label(model): [
            Line(loss_label(what.loss or name), name, what.loss)
            for name, what in stimuli.items()
            if what.model == model
        ]
        + others
        for model in dict.fromkeys(what.model for what in stimuli.values() if what.model)
    }
