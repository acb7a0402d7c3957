"""Losses scored against what people answered: how often each agrees with them."""

import csv
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from torchbrdf.errors import TorchbrdfError, UsageError
from torchbrdf.files import replacing, write_text
from torchbrdf.losses import LOSSES, Loss
from torchbrdf.perception import (
    FACTORS,
    Distances,
    Seen,
    Subjects,
    Table,
    gather,
    read_lagunas,
    read_subjects,
    score_opinions,
    score_triplets,
    statistics_of,
    tabulate,
    uniform_pairs,
)
from torchbrdf.perception.datasets.synthetic import made_up
from torchbrdf.recipe import RECIPES, Recipe, RunFolder
from torchbrdf.render import Environment, RenderedLoss, Scene, View, sphere
from torchbrdf.report import HumanPage, write_human_report

LAGUNAS = "lagunas2019_merl_distances.mat"


@RECIPES.register("human_benchmark")
@dataclass(frozen=True)
class HumanBenchmark(Recipe):
    """Score every loss against human answers: triplets of materials, and opinions of approximations."""

    name = "human_benchmark"

    materials: str = field(default="", metadata={"help": "a folder with the 100 MERL tables"})
    human: str = field(default="", metadata={"help": "a folder with the answers"})
    fits: str = field(default="published_fits.json", metadata={"help": "published parameters of approximations"})
    factors: str = field(
        default="npf.bin",
        metadata={
            "help": f"non-parametric factors of approximations, method {FACTORS}; left out where there is no such file"
        },
    )
    triplets: str = field(default="lagunas2019_triplets_train.json", metadata={"help": "a file in `human`"})
    opinions: str = field(default="lavoue2021_distances_train.csv", metadata={"help": "a file in `human`"})
    losses: tuple[str, ...] = field(default=(), metadata={"help": "losses to score; none: all that are registered"})
    images: bool = field(default=False, metadata={"help": "also score pictures of a sphere"})
    differences: tuple[str, ...] = field(default=("delta_e",), metadata={"help": "image differences of the pictures"})
    size: int = field(default=64, metadata={"help": "pixels of a side of the pictures"})
    samples: int = field(default=6000, metadata={"help": "pairs, uniform in theta_i, theta_o and phi"})
    max_theta: float = field(default=80.0, metadata={"help": "only pairs with both directions below this angle"})
    replicates: int = field(default=1000, metadata={"help": "bootstrap replicates"})

    def __post_init__(self) -> None:
        if not self.quick:
            for key in ("materials", "human"):
                if not getattr(self, key):
                    raise UsageError(f"{self.name}: {key}: expected a folder; quick=true runs on made-up answers")
        if min(self.samples, self.replicates) < 2 or not 16 <= self.size <= 512:
            raise UsageError(f"{self.name}: expected 2 samples and replicates at least, and 16 to 512 pixels")
        if not 0 < self.max_theta <= 90:
            raise UsageError(f"{self.name}: max_theta: expected above 0 and at most 90, found {self.max_theta}")

    def steps(self, folder: RunFolder) -> Path:
        """Distances of every loss, statistics, report."""
        kinds = {LOSSES.canonical(name): LOSSES[name] for name in self.losses or LOSSES}
        replicates = min(self.replicates, 200) if self.quick else self.replicates
        subjects = made_up(seed=self.seed) if self.quick else self._subjects()
        pairs = uniform_pairs(500 if self.quick else self.samples, self.max_theta, self.seed)
        scored: dict[str, Distances] = {}
        left_out: list[str] = []
        losses: dict[str, Loss] = {}
        for name, kind in kinds.items():
            try:
                losses[name] = kind(reduction="none")
            except TorchbrdfError as error:
                _leave_out(folder, left_out, name, error)
        self._score(folder, subjects, losses, lambda: gather(subjects, pairs), scored, left_out)
        if self.images:
            size = min(self.size, 24) if self.quick else self.size
            scene = Scene(sphere(), View(), Environment.default(), size=size, cache=folder.path / "cache")
            for name in self.differences:
                loss = RenderedLoss(scene, name, reduction="none")
                see = _watcher(subjects, scene, loss)
                self._score(folder, subjects, {loss.registered_name: loss}, see, scored, left_out)
        theirs = Path(self.human) / LAGUNAS
        if not self.quick and theirs.is_file():
            found = read_lagunas(theirs, len(subjects.triplets.materials))
            scored |= {f"lagunas_{name}": Distances(matrix, None) for name, matrix in found.items()}
        if not scored:
            raise UsageError(f"{self.name}: no loss could be scored")
        table = tabulate(statistics_of(subjects.triplets, subjects.opinions), scored, replicates, self.seed)
        _write(folder.path, table)
        said = HumanPage(
            made_up=self.quick,
            stand_in=subjects.stand_in,
            images=self.images,
            left_out=left_out,
            pairs=len(pairs),
            max_theta=self.max_theta,
            replicates=replicates,
        )
        return write_human_report(folder.path, table, subjects, said)

    def _subjects(self) -> Subjects:
        return read_subjects(self.materials, self.human, self.fits, self.factors, self.triplets, self.opinions)

    def _score(
        self,
        folder: RunFolder,
        subjects: Subjects,
        losses: dict[str, Loss],
        see: Callable[[], Seen],
        scored: dict[str, Distances],
        left_out: list[str],
    ) -> None:
        """Distances of these losses, read where they are stored, else worked out and stored."""
        rows = len(subjects.opinions)
        stored = {name: folder.path / "distances" / f"{name}.npz" for name in losses}
        known = {name: found for name, path in stored.items() if (found := _read(path, rows))}
        if len(known) == len(losses):
            scored |= known
            return
        seen = see()
        advance = folder.progress("losses", len(losses))
        for name, loss in losses.items():
            found = known.get(name)
            if found is None:
                try:
                    found = Distances(score_triplets(loss, seen, subjects.triplets), score_opinions(loss, seen))
                except TorchbrdfError as error:
                    _leave_out(folder, left_out, name, error)
                    continue
                finally:
                    advance(1)
                with replacing(stored[name]) as path, path.open("wb") as file:
                    np.savez_compressed(file, **{key: part.numpy() for key, part in vars(found).items()})
                folder.log(f"{name} is scored")
            scored[name] = found


def _leave_out(folder: RunFolder, left_out: list[str], name: str, error: TorchbrdfError) -> None:
    left_out.append(f"{name}: {error}")
    folder.warn(f"{name} is left out: {error}")


def _watcher(subjects: Subjects, scene: Scene, loss: RenderedLoss) -> Callable[[], Seen]:
    return lambda: gather(subjects, scene.pairs.to(dtype=torch.float32), loss)


def _read(path: Path, rows: int) -> Distances | None:
    """Stored distances; None where there are none, or of another number of opinions: files come and go."""
    if not path.is_file():
        return None
    with np.load(path) as parts:
        found = Distances(torch.from_numpy(parts["triplets"]), torch.from_numpy(parts["opinions"]))
    return found if found.opinions is not None and len(found.opinions) == rows else None


def _write(folder: Path, table: Table) -> None:
    """scores.json and scores.csv."""
    records = table.records()
    write_text(folder / "scores.json", json.dumps(records, indent=1) + "\n")
    text = io.StringIO()
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    write_text(folder / "scores.csv", text.getvalue())
