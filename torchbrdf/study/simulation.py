"""Observers who are no people, for where there are none: to try a study out, and to see what it could show."""

import random

from torchbrdf.errors import UsageError
from torchbrdf.progress import Progress, quiet
from torchbrdf.study.answers import SIMULATED, Answer
from torchbrdf.study.design import observer_seed, trials
from torchbrdf.study.plan import Experiment, Plan

NOISE = 2.0
"""Of an internal value, in units of the image difference. An assumption, no measurement."""
LARGEST_NOISE = 1e6
MOST_ANSWERS = 1_000_000
"""Of all observers together; they take a minute, and some hundred bytes each."""


def simulate(
    plan: Plan,
    experiment: Experiment,
    observers: int,
    noise: float = NOISE,
    seed: int = 0,
    progress: Progress = quiet,
) -> list[Answer]:
    """Simulate observers' answers by Thurstone's case V.

    Each sees a stimulus's difference D from the reference as D + noise * e, e normal, anew in every trial, and chooses
    the smaller one.
    So P(i over j) = Phi((D_j - D_i) / (sqrt(2) noise)), and the scale's unit is sqrt(2) noise. D is the `difference` in
    the plan: it is of pictures from the same side, while people see the reference from another. All observers are
    alike. Their names begin with "simulated".
    Source: L. L. Thurstone, A law of comparative judgment, 1927, doi:10.1037/h0070288.
    """
    if observers < 1:
        raise UsageError(f"simulated observers: expected at least 1, found {observers}")
    each = len(plan.materials) * experiment.pair_count + experiment.repeats + experiment.catch
    if observers * each > MOST_ANSWERS:
        raise UsageError(
            f"simulated observers: expected at most {MOST_ANSWERS // each} with {each} trials each, found {observers}"
        )
    if not 0 < noise <= LARGEST_NOISE:
        raise UsageError(f"simulated observers: noise: expected a number above 0 up to 1e6, found {noise}")
    seen = {
        (material.name, name): stimulus.difference
        for material in plan.materials
        for name, stimulus in material.stimuli.items()
    }
    answers = []
    for index in range(observers):
        source = random.Random(f"{seed}/{experiment.name}/{index}")
        for trial in trials(plan, experiment, index):
            felt = {}
            for name in (trial.left, trial.right):
                difference = seen[trial.material, name]
                if difference is None:
                    raise UsageError(f"simulated observers: {name} of {trial.material}: its difference is not known")
                felt[name] = difference + source.gauss(0, noise)
            answers.append(
                Answer(
                    observer=f"{SIMULATED}-{index + 1:03d}",
                    experiment=experiment.name,
                    material=trial.material,
                    left=trial.left,
                    right=trial.right,
                    chosen=min(felt, key=lambda name: felt[name]),
                    seed=observer_seed(plan, index),
                    kind=trial.kind,
                )
            )
        progress(index + 1, observers)
    return answers
