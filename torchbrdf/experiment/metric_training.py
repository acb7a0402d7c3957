"""What a metric is trained on and judged by: published answers, or those of one's own study; kept in a run's folder."""

import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.experiment.settings import STANDINS
from torchbrdf.lobes import FitRecord, model_of, read_fits
from torchbrdf.losses import Loss
from torchbrdf.losses.metric_file import schema
from torchbrdf.measured import load_all, standins
from torchbrdf.pairs import Pairs
from torchbrdf.perception import BenchmarkData, EvaluatedBrdfs, evaluate_brdfs
from torchbrdf.perception.datasets.synthetic import SYNTHETIC
from torchbrdf.perception.learning.training import (
    HeldOut,
    Split,
    Training,
    baseline_distances,
    constant_intervals,
    constants_by_name,
    held_out,
    splits,
    train,
)
from torchbrdf.perception.learning.training_set import (
    TrainingSet,
    make_training_set,
    merge_training_sets,
    training_set_from_choices,
)
from torchbrdf.reading import exists, read_json, read_npz, write_npz
from torchbrdf.recipe import RunFolder
from torchbrdf.study import MEASURED, Answer, read_answers, simulated

# Trainings on materials drawn with replacement, at most: each takes a moment, and ends of intervals need no more.
CONSTANT_REPLICATES = 200
PUBLISHED = (
    "triplets of Lagunas et al. 2019, doi:10.1145/3306346.3323036; opinions of Lavoue et al. 2021, "
    "doi:10.1111/cgf.142636"
)


@dataclass(frozen=True)
class TrainingData:
    """What a metric is trained on.

    Args:
        training_set: Terms of distances, and what people were asked of them.
        baselines: The same distances under registered losses, by name.
        facts: Where it comes from, a record a source.
    """

    training_set: TrainingSet
    baselines: dict[str, Tensor]
    facts: list[dict[str, Any]]

    @property
    def mark(self) -> str:
        """What figures have to say: where answers are not people's."""
        return "; ".join(fact["mark"] for fact in self.facts if fact["mark"])


def published_data(
    data: BenchmarkData, pairs: Pairs, losses: Mapping[str, Loss], leave_out: Collection[str], *, synthetic: bool
) -> TrainingData:
    """Published triplets and opinions, without the opinions of some methods.

    Args:
        data: Materials, approximations and answers.
        pairs: Where BRDFs are compared.
        losses: The baselines.
        leave_out: Methods.
        synthetic: Whether the answers are no people's.
    """
    brdfs = evaluate_brdfs(data, pairs)
    training_set = make_training_set(data, brdfs, leave_out)
    fact = {
        "answers": SYNTHETIC if synthetic else PUBLISHED,
        "tables": "stand-ins for measured tables" if data.stand_in else "measured",
        "questions": len(data.triplets),
        "votes": int(data.triplets.votes.sum()),
        "opinions": sum(method in training_set.methods for method in data.opinions.methods),
        "methods": training_set.methods,
        "mark": SYNTHETIC if synthetic else "",
    }
    return TrainingData(training_set, baseline_distances(training_set, brdfs, losses), [fact])


def study_data(run: Path, answers: Path, pairs: Pairs, losses: Mapping[str, Loss]) -> TrainingData:
    """What observers chose about the fits of a run.

    Args:
        run: Its folder, with `fits.json` and `recipe.json`.
        answers: A CSV file of answers.
        pairs: Where BRDFs are compared.
        losses: The baselines.

    Raises:
        DataError: A file cannot be read, or the answers are about something else.
    """
    given = [answer for answer in read_answers(answers) if answer.kind == "trial"]
    names = sorted({answer.material for answer in given})
    stimuli = sorted({(answer.material, side) for answer in given for side in (answer.left, answer.right)})
    materials, stand_in = _materials_of(run, names, pairs, answers)
    target = torch.tensor([names.index(material) for material, _ in stimuli], dtype=torch.int64, device="cpu")
    values = _stimulus_values(run, stimuli, materials[target], pairs, answers)
    brdfs = EvaluatedBrdfs(materials, values, target, pairs)
    compared, votes = _votes(given, stimuli)
    training_set = training_set_from_choices(names, [name for _, name in stimuli], brdfs, compared, votes)
    fact = {
        "answers": f"{len(given)} choices of {len({answer.observer for answer in given})} observers of a study",
        "tables": "stand-ins" if stand_in else "as given",
        "methods": training_set.methods,
        "mark": "simulated observers: not people" if simulated(given) else "",
    }
    return TrainingData(training_set, baseline_distances(training_set, brdfs, losses), [fact])


def join_data(parts: Sequence[TrainingData]) -> TrainingData:
    """Training data of several sources as one."""
    names = parts[0].baselines
    return TrainingData(
        merge_training_sets([part.training_set for part in parts]),
        {name: torch.cat([part.baselines[name] for part in parts]) for name in names},
        [fact for part in parts for fact in part.facts],
    )


@dataclass(frozen=True)
class TrainedMetric:
    """A metric trained on everything, judged by trainings on halves.

    Args:
        metric: What `metric.json` holds.
        held_out: Results by what was kept from trainings, 0: materials, 1: and a method, 2: and two methods, where
            there are some; as `perception.learning.training.held_out` gives them.
        shares: What each term has on average of the distances of two materials and of each method, `{name: (T,)}`.
    """

    metric: dict[str, Any]
    held_out: dict[int, HeldOut]
    shares: dict[str, Tensor]


def train_metric(
    data: TrainingData,
    folder: RunFolder,
    *,
    repeats: int,
    replicates: int,
    given: Mapping[str, float],
    samples: int,
    seed: int,
) -> TrainedMetric:
    """Train on halves of the materials, and on all of them. Nothing is chosen with a look at what is held out.

    Args:
        data: What it learns from.
        folder: Of the run; trainings are kept in `trainings/`, and read where they are there.
        repeats: Of the two-fold cross-validation over materials.
        replicates: Of the bootstrap.
        given: Shares of the mean distance of two materials that are set, not learned, by the names of the last terms.
        samples: Pairs, for the record.
        seed: Of the halves and of the bootstrap.

    Raises:
        DataError: Too few materials, or what is kept of a training cannot be read.
    """
    training_set, shares = data.training_set, tuple(given.values())
    count, terms = training_set.terms.shape
    folder.log(f"{count} distances of {terms} terms, {len(training_set.names)} materials")
    if len(training_set.names) < 4:
        raise DataError(f"train_metric: expected answers about 4 materials at least, found {len(training_set.names)}")
    halves = list(splits(training_set, repeats, seed))
    everything = Split("all", torch.ones(len(training_set.names), dtype=torch.bool, device="cpu"))
    progress, found = folder.progress("trainings"), []
    for k, split in enumerate([everything, *halves], 1):
        found.append(_trained(folder, training_set, split, shares))
        progress(k, len(halves) + 1)
    best, *others = found
    judged = [(split, training.constants) for split, training in zip(halves, others, strict=True)]
    results = {
        left_out: held_out(training_set, own, data.baselines, seed, replicates)
        for left_out in (0, 1, 2)
        if (own := [one for one in judged if len(one[0].without) == left_out])
    }
    drawn = min(replicates, CONSTANT_REPLICATES)
    folder.log(f"intervals of the constants, from {drawn} trainings on materials drawn with replacement")
    seen = (training_set.terms @ best.constants)[None]
    provenance = {
        "learned_from": data.facts,
        "materials": len(training_set.names),
        "pairs": samples,
        "seed": seed,
        "version": version("torchbrdf"),
        "date": time.strftime("%Y-%m-%d"),
        "given_shares": dict(given),
        "intervals": constant_intervals(training_set, shares, drawn, seed),
        "slopes": {
            name: float(f"{x:.4g}") for name, x in zip(("triplets", "others"), best.slopes.tolist(), strict=True)
        },
        "held_out": _shares_of(results[0]),
        "methods_held_out": [_shares_of(results[k]) for k in (1, 2) if k in results],
        "seen": {
            name: round(float(part.agreement_rate(part.concordant(seen))), 4)
            for name, part in training_set.statistics.items()
        },
    }
    metric = schema() | {"constants": constants_by_name(best.constants), "provenance": provenance}
    return TrainedMetric(metric, results, _term_shares(training_set, best.constants))


def _shares_of(results: HeldOut) -> dict[str, list[float]]:
    return {name: [round(x, 4) for x in rows["learned"]["share"]] for name, rows in results.items()}


def _term_shares(training_set: TrainingSet, constants: Tensor) -> dict[str, Tensor]:
    kinds = {"two materials": -1} | {name: k for k, name in enumerate(training_set.methods)}
    parts = training_set.terms * constants
    return {
        name: parts[own].mean(0) for name, kind in kinds.items() if bool((own := training_set.method == kind).any())
    }


class _Settings(msgspec.Struct):
    materials: str


class _Run(msgspec.Struct):
    """What is needed of a run's `recipe.json`."""

    settings: _Settings


def _materials_of(run: Path, names: Sequence[str], pairs: Pairs, answers: Path) -> tuple[Tensor, bool]:
    """Values of the materials that a run was about, `(K, N, 3)`, and whether any is a stand-in."""
    path = run / "recipe.json"
    settings: _Run = read_json(path, _Run, "the settings of a run, with its materials")
    folder = settings.settings.materials
    try:
        tables = load_all(standins() if folder == STANDINS else folder)
    except DataError as error:
        raise DataError(f"{path}: materials: {error}") from None
    where = {name: (group, k) for group in tables for k, name in enumerate(group.names)}
    for name in names:
        if name not in where:
            raise DataError(f"{answers}: expected materials of {folder}, found {name!r}")
    values = torch.cat([where[name][0].batch([where[name][1]]).at(pairs) for name in names]).to(pairs.dtype)
    return values, any(group.stand_in for group in tables)


def _stimulus_values(
    run: Path, stimuli: Sequence[tuple[str, str]], measured: Tensor, pairs: Pairs, answers: Path
) -> Tensor:
    """Values of what observers saw, by material and name of the stimulus, `(R, N, 3)`."""
    records: dict[tuple[str, str], FitRecord] = {}
    for record in read_fits(run / "fits.json"):
        name = f"{record.model}-{record.loss}"
        for stimulus in (name, f"{name}-{record.strategy}"):
            records.setdefault((record.material, stimulus), record)
    values = []
    for key, own in zip(stimuli, measured, strict=True):
        if key[1] == MEASURED:
            values.append(own[None])
        elif key in records:
            with torch.no_grad():
                values.append(model_of([records[key]], torch.float32).to(pairs.dtype)(pairs).to(pairs.dtype))
        else:
            raise DataError(f"{answers}: {key[0]}: expected a fit of {run / 'fits.json'}, found {key[1]!r}")
    return torch.cat(values)


def _votes(given: Sequence[Answer], stimuli: Sequence[tuple[str, str]]) -> tuple[Tensor, Tensor]:
    """Which two stimuli were compared, by their places, and how often either was chosen, `(C, 2)` each."""
    place = {key: k for k, key in enumerate(stimuli)}
    count: Counter[tuple[int, int]] = Counter(
        (place[answer.material, answer.chosen], place[answer.material, answer.rejected]) for answer in given
    )
    compared = sorted({(min(key), max(key)) for key in count})
    return torch.tensor(compared, dtype=torch.int64, device="cpu"), torch.tensor(
        [[count[a, b], count[b, a]] for a, b in compared], dtype=torch.int64, device="cpu"
    )


def read_training(path: Path, terms: int) -> Training:
    """Read what is kept of a training.

    Args:
        path: The file.
        terms: How many constants it has.

    Raises:
        DataError: It was changed or damaged, or is of another training; says that it may be removed.
    """
    layout = {"constants": ((terms,), "f"), "slopes": ((2,), "f"), "mismatch": ((2,), "f")}
    remedy = "remove it to train again"
    try:
        parts = read_npz(path, f"a finished training; {remedy}", layout)
    except DataError as error:
        raise DataError(str(error) if remedy in str(error) else f"{error}; {remedy}") from None
    return Training(**{name: torch.from_numpy(parts[name]) for name in layout})


def _trained(folder: RunFolder, training_set: TrainingSet, split: Split, given: tuple[float, ...]) -> Training:
    """One training, read where an earlier run has finished it."""
    path = folder.path / "trainings" / f"{split.name}.npz"
    if exists(path):
        return read_training(path, training_set.terms.shape[1])
    training = train(training_set, split, given)
    write_npz(path, {name: value.numpy() for name, value in vars(training).items()})
    learned_from, rest = training.mismatch.tolist()
    folder.log(
        f"{split.name}: negative log-likelihood {learned_from:.4f} of what was learned from, {rest:.4f} of the rest"
    )
    return training
