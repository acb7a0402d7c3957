"""What observers are asked about a study, and what simulated ones answer."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch

from torchbrdf.psychophysics import Comparisons, scale
from torchbrdf.report.drawing import marked
from torchbrdf.report.labels import difference_label, loss_label
from torchbrdf.report.study import DIFFERENCE, Study, picture
from torchbrdf.study import MEASURED, Answer, Experiment, Material, Plan, Stimulus, simulate, write_answers
from torchbrdf.study.plan import PLAN

# The paper's experiments: every model under every metric, and the models under one metric beside the measured material.
FIRST, SECOND = "1", "2"


@dataclass(frozen=True)
class Asked:
    """A plan, the answers that it got, and what has to be said wherever they are shown."""

    plan: Plan
    answers: list[Answer]
    mark: str


def plan_of(
    study: Study,
    metric: str | None = None,
    texts: Mapping[str, str] | None = None,
    screening: Mapping[str, tuple[str, ...]] | None = None,
) -> Plan:
    """The paper's experiments with a study's pictures: the first, if there are two fits to compare, and the second,
    under `metric`, if one is given.

    Every fit that was drawn is a stimulus, those of a strategy beside the study's own as well, for experiments that a
    user adds.
    """
    fits = {record_name(study, record): record for strategy in study.strategies for record in study.drawn(strategy)}
    materials = []
    for name, (doi, _) in study.gloss.items():
        stimuli = {
            stimulus: Stimulus(
                _path(study, study.picture(record)),
                model=record["model"],
                loss=record["loss"],
                outlier=record["outlier"],
                difference=record["differences"][DIFFERENCE],
            )
            for (material, stimulus), record in fits.items()
            if material == name
        }
        stimuli[MEASURED] = Stimulus(_path(study, picture(name)), difference=0.0)
        materials.append(Material(name, _path(study, picture(name, "turned")), stimuli, order=doi))
    experiments = []
    every = tuple(f"{model}-{loss}" for model in study.models for loss in study.losses)
    if len(every) > 1:
        experiments.append(Experiment(FIRST, "models and error metrics", every))
    if metric is not None:
        under = tuple(f"{model}-{metric}" for model in study.models)
        title = f"models under {loss_label(metric)}, and the measured material"
        experiments.append(Experiment(SECOND, title, (*under, MEASURED)))
    mark = marked(study.stand_in)
    return Plan(tuple(materials), tuple(experiments), study.seed, texts or {}, screening or {}, mark)


def record_name(study: Study, record: Mapping[str, str]) -> tuple[str, str]:
    """The material of a fit, and the fit's name among the stimuli."""
    material: str = record["material"]
    return material, study.picture(dict(record)).removeprefix(f"{material}-")


def ask_simulated(
    study: Study,
    observers: tuple[int, int],
    noise: float,
    texts: Mapping[str, str] | None = None,
    screening: Mapping[str, tuple[str, ...]] | None = None,
) -> Asked:
    """Both experiments with so many simulated observers; the second under the metric that the first prefers.

    Their answers are kept in `simulated.csv`, and the plan in `study.json`, unless there is one: a user may have
    changed its words.
    """
    metric, answers = next(iter(study.losses)), []
    if len(study.models) * len(study.losses) > 1:
        first = plan_of(study)
        answers = simulate(first, first.experiment(FIRST), observers[0], noise, study.seed)
        metric = _winner(study, answers)
    plan = plan_of(study, metric, texts, screening)
    answers += simulate(plan, plan.experiment(SECOND), observers[1], noise, study.seed)
    write_answers(study.folder.path / "simulated.csv", answers)
    if not (study.folder.path / PLAN).exists():
        plan.save(study.folder.path)
    return Asked(plan, answers, simulated_mark(noise))


def simulated_mark(noise: float) -> str:
    """What figures say that show simulated answers."""
    return f"simulated observers: not people (they see mean {difference_label(DIFFERENCE)} with noise {noise:g})"


def _winner(study: Study, answers: list[Answer]) -> str:
    """The metric whose fits have the highest mean scale value."""
    scales = scale(Comparisons.from_answers(answers), draws=0)
    means = {
        loss: torch.stack(
            [
                values[names.index(f"{model}-{loss}")]
                for names, values in zip(scales.stimuli, scales.value, strict=True)
                for model in study.models
            ]
        ).mean()
        for loss in study.losses
    }
    return max(means, key=lambda loss: means[loss])


def _path(study: Study, name: str) -> str:
    path: str = study.png(name).relative_to(study.folder.path).as_posix()
    return path
