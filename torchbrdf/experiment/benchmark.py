"""A benchmark of losses against human answers: their distances, kept in the folder of a run, and what failed."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import torch

from torchbrdf.errors import DataError, TorchbrdfError
from torchbrdf.files import write_csv, write_json
from torchbrdf.losses import Loss
from torchbrdf.pairs import Pairs
from torchbrdf.perception import (
    BenchmarkData,
    Distances,
    EvaluatedBrdfs,
    Table,
    distances_of,
    evaluate_brdfs,
    find_metric,
    metric_label,
    read_lagunas,
)
from torchbrdf.reading import exists, read_npz, write_npz
from torchbrdf.recipe import RunFolder
from torchbrdf.render import RenderedLoss, Scene

# Distances between the measured tables by Lagunas et al. (2019), beside their answers.
LAGUNAS = "lagunas2019_merl_distances.mat"


@dataclass
class Benchmark:
    """Distances of losses for everything that people were asked, in `distances/NAME.npz`; stored ones are read.

    Those of a metric from `module:name` are worked out in every run: its module may have changed.

    Args:
        folder: Of the run.
        data: What people were asked.
        distances: By the name of a loss.
        left_out: Names of losses that failed, with why.
    """

    folder: RunFolder
    data: BenchmarkData
    distances: dict[str, Distances] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)

    def score_values(self, names: Iterable[str], pairs: Pairs) -> None:
        """Distances of registered losses, and of metrics from `module:name`, between values at some pairs."""
        losses: dict[str, Loss] = {}
        for text in names:
            name = metric_label(text)
            try:
                losses[name] = find_metric(text)
            except TorchbrdfError as error:
                self._leave_out(name, error)
        self._score(losses, lambda: evaluate_brdfs(self.data, pairs))

    def score_pictures(self, differences: Iterable[str], scene: Scene) -> None:
        """Distances of image differences between pictures of a scene."""
        for name in differences:
            loss = RenderedLoss(scene, name, reduction="none")
            evaluate = partial(evaluate_brdfs, self.data, scene.pairs.to(dtype=torch.float32), loss)
            self._score({loss.registered_name: loss}, evaluate)

    def add_published(self, path: Path) -> None:
        """Distances that others computed on measured tables, where there is such a file."""
        if path.is_file():
            found = read_lagunas(path, len(self.data.triplets.materials))
            self.distances |= {f"lagunas_{name}": Distances(matrix, None) for name, matrix in found.items()}

    def _score(self, losses: Mapping[str, Loss], evaluate: Callable[[], EvaluatedBrdfs]) -> None:
        """Distances of some losses, read where they are stored, else worked out and stored."""
        counts = len(self.data.triplets.materials), len(self.data.opinions)
        stored = {name: self.folder.path / "distances" / f"{name}.npz" for name in losses if ":" not in name}
        known = {name: found for name, path in stored.items() if (found := read_distances(path, *counts))}
        if len(known) == len(losses):
            self.distances |= known
            return
        brdfs = evaluate()
        progress = self.folder.progress("losses")
        for done, (name, loss) in enumerate(losses.items(), 1):
            found = known.get(name)
            if found is None:
                try:
                    found = distances_of(loss, self.data, brdfs)
                except TorchbrdfError as error:
                    self._leave_out(name, error)
                    continue
                finally:
                    progress(done, len(losses))
                if name in stored:
                    _write_distances(stored[name], found)
                self.folder.log(f"{name} is scored")
            self.distances[name] = found

    def _leave_out(self, name: str, error: TorchbrdfError) -> None:
        self.left_out.append(f"{name}: {error}")
        self.folder.warn(f"{name} is left out: {error}")


def write_scores(folder: Path, table: Table) -> None:
    """`scores.json` and `scores.csv` in a folder."""
    records = table.records()
    write_json(folder / "scores.json", records)
    write_csv(folder / "scores.csv", records)


def _write_distances(path: Path, found: Distances) -> None:
    parts = {"triplets": found.triplets, "opinions": found.opinions}
    write_npz(path, {name: part.numpy() for name, part in parts.items() if part is not None}, compressed=True)


def read_distances(path: Path, materials: int, rows: int) -> Distances | None:
    """Read what is kept of the distances of a loss.

    Args:
        path: The file.
        materials: How many the triplets are about.
        rows: How many opinions there are.

    Returns:
        The distances; None where there are none, or of other materials or opinions: files come and go.

    Raises:
        DataError: The file was changed or damaged; says that it may be removed.
    """
    if not exists(path):
        return None
    expected = "the distances of a loss (remove it to score again)"
    parts = read_npz(path, expected)
    if set(parts) != {"triplets", "opinions"} or any(part.dtype != "float64" for part in parts.values()):
        raise DataError(f"{path}: expected {expected}, found {', '.join(parts) or 'nothing'}")
    if parts["triplets"].shape != (materials, materials) or parts["opinions"].shape != (rows,):
        return None
    return Distances(torch.from_numpy(parts["triplets"]), torch.from_numpy(parts["opinions"]))
