"""Fits that others published, beside ours of the same models, under every metric."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from torchbrdf.experiment.grid import FitGrid
from torchbrdf.files import write_csv
from torchbrdf.fitting import cross_score
from torchbrdf.lobes import model_name
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured
from torchbrdf.perception import PublishedFits


@dataclass(frozen=True)
class Comparison:
    """One set's errors under one metric, and those of our fits of its model under this metric, a number a material.

    Attributes:
        name: of the set.
        model: registered name of its lobe.
        loss: registered name of the metric.
        materials: M.
        published: errors of the published parameters, `(M,)`.
        ours: errors of our fits, `(M,)`; NaN where there is none.
    """

    name: str
    model: str
    loss: str
    materials: list[str]
    published: np.ndarray = field(repr=False)
    ours: np.ndarray = field(repr=False)

    @property
    def fitted(self) -> np.ndarray:
        """Which of the materials we fitted, `(M,)`."""
        return np.isfinite(self.ours)

    @property
    def ratio(self) -> np.ndarray:
        """Published errors over ours, of the materials that we fitted; above 1 ours are lower."""
        return (self.published / self.ours)[self.fitted]

    def rows(self) -> list[dict[str, object]]:
        """A row a material, for a table; empty where we have no fit."""
        ours = [value if fitted else None for value, fitted in zip(self.ours.tolist(), self.fitted, strict=True)]
        return [
            {"set": self.name, "model": self.model, "loss": self.loss, "material": name, "published": a, "ours": b}
            for name, a, b in zip(self.materials, self.published.tolist(), ours, strict=True)
        ]


def models_of(published: Mapping[str, PublishedFits]) -> list[str]:
    """The models of some sets, each once."""
    return list(dict.fromkeys(model_name(one.model)[0] for one in published.values()))


def compare_published(
    grid: FitGrid, published: Mapping[str, PublishedFits], groups: Sequence[Measured]
) -> list[Comparison]:
    """Score published fits under the losses of a grid of our fits, which is fitted first.

    Args:
        grid: of our fits with one lobe, of the models of these sets.
        published: sets by name.
        groups: the materials whose published fits are scored; those of the grid are among them.

    Returns:
        One for each set and loss; `errors.csv` in the grid's folder has all of it.
    """
    grid.fit()
    own = {(record.material, record.model, record.loss): record.error for record in grid.records}
    found = []
    progress = grid.folder.progress("published sets")
    for k, one in enumerate(published.values()):
        model = model_name(one.model)[0]
        losses = list(grid.losses.values())
        scored = [_score(one, group.within(grid.max_theta), losses) for group in groups]
        names = [name for own, _ in scored for name in own]
        errors = np.concatenate([values for _, values in scored], 1)
        for loss, row in zip(grid.losses, errors, strict=True):
            ours = np.array([own.get((name, model, loss), np.nan) for name in names])
            found.append(Comparison(one.name, model, loss, names, row, ours))
        progress(k + 1, len(published))
    write_csv(grid.folder.path / "errors.csv", [row for one in found for row in one.rows()])
    return found


def _score(published: PublishedFits, measured: Measured, losses: Sequence[Loss]) -> tuple[list[str], np.ndarray]:
    """Names of the materials that a set has, and errors `(L, M)`."""
    rows = [k for k, name in enumerate(measured.names) if name in published.materials]
    names = [measured.names[k] for k in rows]
    if not rows:
        return [], np.zeros((len(losses), 0))
    return names, cross_score([published.of(names)], measured.batch(rows), losses)[:, 0].numpy()
