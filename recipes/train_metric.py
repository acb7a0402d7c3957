"""Learn a readable BRDF metric from what people answered, and judge it on materials that it never saw."""

import json
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import torch

from torchbrdf.errors import DataError, UsageError
from torchbrdf.files import replacing, write_text
from torchbrdf.lobes import model_of, read_fits
from torchbrdf.losses import LOSSES
from torchbrdf.losses.learned import schema
from torchbrdf.measured import load_all, standins
from torchbrdf.perception import (
    Opinions,
    Seen,
    Subjects,
    gather,
    read_subjects,
    uniform_pairs,
)
from torchbrdf.perception.datasets.synthetic import MADE_UP, made_up
from torchbrdf.perception.learning.training import (
    Course,
    Split,
    best_iteration,
    finished,
    formulas,
    held_out,
    splits,
    train,
)
from torchbrdf.perception.learning.training_set import Lesson, joined, lesson_of, lesson_of_choices
from torchbrdf.recipe import RECIPES, Recipe, RunFolder
from torchbrdf.report import STANDINS, MetricPage, write_metric_report
from torchbrdf.study import MEASURED, read_answers, simulated

PUBLISHED = (
    "triplets of Lagunas et al. 2019, doi:10.1145/3306346.3323036; opinions of Lavoue et al. 2021, "
    "doi:10.1111/cgf.142636"
)


@RECIPES.register("train_metric")
@dataclass(frozen=True)
class TrainMetric(Recipe):
    """Learn the weights of LearnedLoss from published answers, from one's own study, or both."""

    name = "train_metric"

    materials: str = field(default="", metadata={"help": "a folder with the 100 MERL tables, for published answers"})
    human: str = field(default="", metadata={"help": "a folder with the published answers"})
    fits: str = field(default="published_fits.json", metadata={"help": "published parameters of approximations"})
    factors: str = field(default="npf.bin", metadata={"help": "published factors of approximations, if there is one"})
    triplets: str = field(default="lagunas2019_triplets_train.json", metadata={"help": "a file in `human`"})
    opinions: str = field(default="lavoue2021_distances_train.csv", metadata={"help": "a file in `human`"})
    leave_out: tuple[str, ...] = field(
        default=("ABC",), metadata={"help": "methods whose parameters are not what people saw"}
    )
    study: str = field(
        default="", metadata={"help": "the folder of a run of fores2012 that observers were asked about"}
    )
    answers: str = field(default="", metadata={"help": "the answers, a CSV file: torchbrdf study export"})
    samples: int = field(default=6000, metadata={"help": "pairs, uniform in theta_i, theta_o and phi"})
    repeats: int = field(default=10, metadata={"help": "of the two-fold cross-validation over materials"})
    iterations: int = field(default=40, metadata={"help": "of L-BFGS, from which early stopping chooses"})
    replicates: int = field(default=1000, metadata={"help": "bootstrap replicates over materials"})

    def __post_init__(self) -> None:
        if bool(self.study) != bool(self.answers):
            raise UsageError(f"{self.name}: expected a study and its answers, found only one of them")
        if not self.quick and not self.study and not self.human:
            raise UsageError(f"{self.name}: expected human, or study and answers; quick=true runs on made-up answers")
        if self.human and not self.materials:
            raise UsageError(f"{self.name}: materials: expected a folder with the MERL tables")
        if min(self.samples, self.repeats, self.iterations) < 1 or self.replicates < 2:
            raise UsageError(f"{self.name}: expected at least 1 sample, repeat and iteration, and 2 replicates")

    def steps(self, folder: RunFolder) -> Path:
        """Terms of all distances, trainings on halves, one on everything, and what they are worth."""
        samples, repeats, iterations = (500, 2, 15) if self.quick else (self.samples, self.repeats, self.iterations)
        pairs = uniform_pairs(samples, seed=self.seed).to(dtype=torch.float32)
        lessons, others, facts = [], [], []
        losses = {
            name: kind(reduction="none")
            for name, kind in LOSSES.items()
            if kind.supports_subsampling and name != "learned"
        }
        if self.human or (self.quick and not self.study):
            subjects = self._subjects() if self.human else made_up(seed=self.seed)
            seen = gather(subjects, pairs)
            lessons.append(lesson_of(subjects, seen, self.leave_out))
            others.append(formulas(lessons[-1], seen, losses))
            facts.append(_published_facts(subjects, lessons[-1], bool(self.human)))
        if self.study:
            lesson, seen, fact = _studied(Path(self.study), Path(self.answers), pairs)
            lessons.append(lesson)
            others.append(formulas(lesson, seen, losses))
            facts.append(fact)
        lesson = joined(lessons)
        folder.log(f"{len(lesson.terms)} distances of {lesson.terms.shape[1]} terms, {len(lesson.names)} materials")
        if len(lesson.names) < 4:
            raise DataError(f"{self.name}: expected answers about 4 materials at least, found {len(lesson.names)}")
        halves = list(splits(lesson, repeats, self.seed))
        advance = folder.progress("trainings", len(halves) + 1)
        courses = [_trained(folder, lesson, split, iterations, advance) for split in halves]
        plain = [k for k, split in enumerate(halves) if split.without < 0]
        best = best_iteration([courses[k] for k in plain])
        folder.log(f"held-out answers are likeliest after iteration {best + 1}")
        everything = Split("all", torch.ones(len(lesson.names), dtype=torch.bool))
        whole = _trained(folder, lesson, everything, iterations, advance).weights[best]
        compared = {name: torch.cat([other[name] for other in others]) for name in losses}
        replicates = min(self.replicates, 100) if self.quick else self.replicates
        judged = [(split, course.weights[best]) for split, course in zip(halves, courses, strict=True)]
        table = held_out(lesson, [judged[k] for k in plain], compared, self.seed, replicates)
        strange = [one for one in judged if one[0].without >= 0]
        methods = held_out(lesson, strange, compared, self.seed, replicates) if strange else {}
        methods = {name: own for name, own in methods.items() if name != "majority"}
        own = lesson.distances(whole)
        provenance = {
            "learned_from": facts,
            "materials": len(lesson.names),
            "pairs": samples,
            "seed": self.seed,
            "iterations": best + 1,
            "date": time.strftime("%Y-%m-%d"),
            "held_out": {name: [round(x, 4) for x in rows["learned"]["share"]] for name, rows in table.items()},
            "seen": {
                name: round(float(part.share(part.right(own[None]))), 4) for name, part in lesson.statistics.items()
            },
        }
        metric = schema() | {"weights": finished(lesson, whole), "provenance": provenance}
        write_text(folder.path / "metric.json", json.dumps(metric) + "\n")
        write_text(folder.path / "held_out.json", json.dumps({"materials": table, "methods": methods}, indent=1) + "\n")
        marks = [fact["mark"] for fact in facts if fact["mark"]]
        curves = torch.stack([courses[k].curve for k in plain])
        return write_metric_report(folder.path, MetricPage(table, methods, metric, curves, best, "; ".join(marks)))

    def _subjects(self) -> Subjects:
        return read_subjects(self.materials, self.human, self.fits, self.factors, self.triplets, self.opinions)


def _published_facts(subjects: Subjects, lesson: Lesson, published: bool) -> dict[str, Any]:
    opinions: Opinions = subjects.opinions
    return {
        "answers": PUBLISHED if published else MADE_UP,
        "tables": "stand-ins for measured tables" if subjects.stand_in else "measured",
        "questions": len(subjects.triplets),
        "votes": int(subjects.triplets.votes.sum()),
        "opinions": sum(method in lesson.methods for method in opinions.methods),
        "methods": lesson.methods,
        "mark": "" if published else MADE_UP,
    }


def _studied(run: Path, answers: Path, pairs: Any) -> tuple[Lesson, Seen, dict[str, Any]]:
    """What observers chose about the fits of a run."""
    given = [answer for answer in read_answers(answers) if answer.kind == "trial"]
    records: dict[tuple[str, str], dict[str, Any]] = {}
    for record in read_fits(run / "fits.json"):
        name = f"{record['model']}-{record.get('loss', '')}"
        for stimulus in (name, f"{name}-{record.get('strategy', '')}"):
            records.setdefault((record["material"], stimulus), record)
    try:
        folder = json.loads((run / "recipe.json").read_text(encoding="utf-8"))["settings"]["materials"]
    except (OSError, ValueError, KeyError, TypeError):
        raise DataError(f"{run / 'recipe.json'}: expected the settings of a run, with its materials") from None
    tables = load_all(standins() if folder == STANDINS else folder)
    where = {name: (group, k) for group in tables for k, name in enumerate(group.names)}
    names = sorted({answer.material for answer in given})
    for name in names:
        if name not in where:
            raise DataError(f"{answers}: expected materials of {folder}, found {name!r}")
    materials = torch.cat([where[name][0].batch([where[name][1]]).at(pairs) for name in names]).to(pairs.dtype)
    stimuli = sorted({(answer.material, side) for answer in given for side in (answer.left, answer.right)})
    values = []
    for material, stimulus in stimuli:
        if stimulus == MEASURED:
            values.append(materials[names.index(material)][None])
        elif (material, stimulus) in records:
            with torch.no_grad():
                values.append(model_of([records[material, stimulus]]).to(pairs.dtype)(pairs).to(pairs.dtype))
        else:
            raise DataError(f"{answers}: {material}: expected a fit of {run / 'fits.json'}, found {stimulus!r}")
    target = torch.tensor([names.index(material) for material, _ in stimuli])
    seen = Seen(materials, torch.cat(values), target, pairs)
    place = {key: k for k, key in enumerate(stimuli)}
    count: Counter[tuple[int, int]] = Counter(
        (place[answer.material, answer.chosen], place[answer.material, answer.rejected]) for answer in given
    )
    asked = sorted({(min(key), max(key)) for key in count})
    votes = torch.tensor([[count[a, b], count[b, a]] for a, b in asked])
    lesson = lesson_of_choices(names, [name for _, name in stimuli], seen, torch.tensor(asked), votes)
    nobody = simulated(given)
    return (
        lesson,
        seen,
        {
            "answers": f"{len(given)} choices of {len({answer.observer for answer in given})} observers of a study",
            "tables": "stand-ins" if any(group.stand_in for group in tables) else "as given",
            "methods": lesson.methods,
            "mark": "simulated observers: not people" if nobody else "",
        },
    )


def _trained(folder: RunFolder, lesson: Lesson, split: Split, iterations: int, advance: Any) -> Course:
    """One training, read where an earlier run has finished it."""
    path = folder.path / "trainings" / f"{split.name}.npz"
    if path.is_file():
        try:
            with np.load(path) as parts:
                course = Course(torch.from_numpy(parts["curve"]), torch.from_numpy(parts["weights"]))
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            raise DataError(f"{path}: expected a finished training; remove it to train again") from None
    else:
        course = train(lesson, split, iterations)
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, curve=course.curve.numpy(), weights=course.weights.numpy())
        seen, unseen = course.curve[-1].tolist()
        folder.log(f"{split.name}: mismatch {seen:.4f} of what was learned from, {unseen:.4f} of the rest")
    advance(1)
    return course
