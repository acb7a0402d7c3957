"""What observers are asked about a grid of fits, and what simulated ones answer."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from torchbrdf.experiment.grid import picture_name
from torchbrdf.experiment.labels import caveat, difference_label, loss_label
from torchbrdf.experiment.pictures import DIFFERENCE, Pictures
from torchbrdf.lobes import FitRecord
from torchbrdf.psychophysics import Comparisons, scale
from torchbrdf.study import MEASURED, Answer, Experiment, Material, Plan, Stimulus, simulate, write_answers
from torchbrdf.study.plan import PLAN

# The paper's experiments: every model under every metric, and the models under one metric beside the measured material.
FIRST, SECOND = "1", "2"
# Degrees: where a material stands whose distinctness of image is not known.
LAST = 180.0


@dataclass(frozen=True)
class Responses:
    """A plan, the answers that it got, and what has to be said wherever they are shown."""

    plan: Plan
    answers: list[Answer]
    caveat: str


def make_plan(
    pictures: Pictures,
    metric: str | None = None,
    texts: Mapping[str, str] | None = None,
    screening: Mapping[str, tuple[str, ...]] | None = None,
) -> Plan:
    """The paper's experiments with a grid's pictures: the first, if there are two fits to compare, and the second.

    Every fit that was drawn is a stimulus, those of the other strategy as well, for experiments that a user adds.

    Args:
        pictures: Of the one scene of the grid, and of the materials turned.
        metric: The loss whose fits are in the second experiment; None leaves it out.
        texts: What observers are told, where it is not the default.
        screening: Who may take part.

    Returns:
        The plan, as `study.json` holds it.
    """
    grid = pictures.grid

    def path(name: str) -> str:
        return pictures.path(name).relative_to(grid.folder.path).as_posix()

    materials = []
    for name, (doi, _) in grid.gloss.items():
        stimuli = {
            stimulus_name(pictures, record): Stimulus(
                path(grid.picture(record)),
                model=record.model,
                loss=record.loss,
                outlier=bool(record.outlier),
                difference=_known(record.differences[DIFFERENCE]),
            )
            for record in grid.drawn
            if record.material == name
        }
        stimuli[MEASURED] = Stimulus(path(picture_name(name)), difference=0.0)
        materials.append(
            Material(name, path(picture_name(name, "turned")), stimuli, order=doi if math.isfinite(doi) else LAST)
        )
    experiments = []
    every = tuple(f"{model}-{loss}" for model in grid.models for loss in grid.losses)
    if len(every) > 1:
        experiments.append(Experiment(FIRST, "models and error metrics", every))
    if metric is not None:
        under = tuple(f"{model}-{metric}" for model in grid.models)
        title = f"models under {loss_label(metric)}, and the measured material"
        experiments.append(Experiment(SECOND, title, (*under, MEASURED)))
    mark = caveat(grid.stand_in)
    return Plan(tuple(materials), tuple(experiments), grid.seed, texts or {}, screening or {}, mark)


def _known(value: float) -> float | None:
    """A number that a plan may hold."""
    return value if math.isfinite(value) else None


def stimulus_name(pictures: Pictures, record: FitRecord) -> str:
    """The name of a fit among the stimuli of its material."""
    return pictures.grid.picture(record).removeprefix(f"{record.material}-")


def simulate_responses(
    pictures: Pictures,
    observers: tuple[int, int],
    noise: float,
    texts: Mapping[str, str] | None = None,
    screening: Mapping[str, tuple[str, ...]] | None = None,
) -> Responses:
    """Both experiments with simulated observers; the second under the metric that those of the first prefer.

    Their answers are kept in `simulated.csv`, and the plan in `study.json`, unless there is one: a user may have
    changed its words.

    Args:
        pictures: As in `make_plan`.
        observers: How many, in either experiment.
        noise: Of what they see, in units of the image difference.
        texts: As in `make_plan`.
        screening: As in `make_plan`.
    """
    grid = pictures.grid
    metric, answers = next(iter(grid.losses)), []
    if len(grid.models) * len(grid.losses) > 1:
        first = make_plan(pictures)
        answers = simulate(first, first.experiment(FIRST), observers[0], noise, grid.seed)
        metric = _preferred(pictures, answers)
    plan = make_plan(pictures, metric, texts, screening)
    answers += simulate(plan, plan.experiment(SECOND), observers[1], noise, grid.seed)
    write_answers(grid.folder.path / "simulated.csv", answers)
    if not (grid.folder.path / PLAN).exists():
        plan.save(grid.folder.path)
    seen = f"they see mean {difference_label(DIFFERENCE)} with noise {noise:g}"
    return Responses(plan, answers, f"simulated observers: not people ({seen})")


def _preferred(pictures: Pictures, answers: list[Answer]) -> str:
    """The metric whose fits have the highest mean scale value."""
    grid = pictures.grid
    scales = scale(Comparisons.from_answers(answers), draws=0)
    means = {
        loss: torch.stack(
            [
                values[names.index(f"{model}-{loss}")]
                for names, values in zip(scales.stimuli, scales.value, strict=True)
                for model in grid.models
            ]
        ).mean()
        for loss in grid.losses
    }
    return max(means, key=lambda loss: means[loss])
