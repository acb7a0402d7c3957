"""One strategy beside another: who gets stuck, what that costs in error, and whether it can be seen."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchbrdf.experiment.grid import FitGrid, picture_name
from torchbrdf.experiment.labels import loss_label, model_label
from torchbrdf.experiment.pictures import DIFFERENCE, Pictures
from torchbrdf.experiment.statistics import (
    Records,
    difference_gains,
    error_ratios,
    mean_difference,
    outlier_count,
)
from torchbrdf.report.figures import grid_figure, strategies_figure
from torchbrdf.report.tables import Column, Table, table

# An error that is lower, or higher, by less than this share is the same.
SAME = 0.01
# A difference in mean Delta E that an eye has a chance to see.
VISIBLE = 0.1
# Pictures in the figure of the largest gains.
SHOWN = 8


@dataclass(frozen=True)
class StrategyComparison:
    """Figures, sentences and a table; no `pictures` where no error differs."""

    figure: Path
    pictures: Path | None
    findings: list[str]
    table: Table


def compare_strategies(pictures: Pictures) -> StrategyComparison | None:
    """Figures are drawn into the run's folder; None if the grid has but one strategy."""
    grid = pictures.grid
    if not grid.compare_strategy:
        return None
    ours, theirs = (grid.by_strategy(strategy) for strategy in grid.strategies)
    folder = grid.folder.path / "figures"
    ratio, gain = error_ratios(ours, theirs), difference_gains(ours, theirs)
    strategies_figure(folder / "strategies.png", grid, ratio, gain)
    return StrategyComparison(
        folder / "strategies.png",
        _pictures(pictures, ours, theirs, ratio, folder / "strategies-pictures.png"),
        _findings(grid, ours, theirs, ratio, gain),
        _table(grid, ours, theirs, ratio, gain),
    )


def _findings(grid: FitGrid, ours: Records, theirs: Records, ratio: np.ndarray, gain: np.ndarray) -> list[str]:
    name, other = grid.strategies
    lower = ratio > 1 + SAME
    seen, worse = int((lower & (gain > VISIBLE)).sum()), int((lower & (gain < -VISIBLE)).sum())
    stuck = [sum(bool(record.outlier) for record in part) for part in (theirs, ours)]
    lines = [
        f"The {other} strategy leaves {stuck[0]} of {len(theirs)} fits in a local minimum by "
        f"the paper's test, the {name} one {stuck[1]}. The {name} error is lower by more than "
        f"{SAME:.0%} in {int(lower.sum())} fits, by up to {100 * (1 - 1 / ratio.max()):.0f} %, and higher by more than "
        f"that in {int((ratio < 1 / (1 + SAME)).sum())}."
    ]
    if lower.any():
        lines.append(
            f"Does lower error look better? Of these {int(lower.sum())} fits the picture came closer to the reference "
            f"in {seen} and farther in {worse} (by more than {VISIBLE} ΔE); in the mean ΔE "
            f"{'fell' if gain[lower].mean() > 0 else 'rose'} by {abs(gain[lower].mean()):.2f}."
        )
    means = [np.mean([record.differences[DIFFERENCE] for record in part]) for part in (theirs, ours)]
    lines.append(f"Mean ΔE over all {len(ours)} fits: {other} {means[0]:.2f}, {name} {means[1]:.2f}.")
    return lines


def _table(grid: FitGrid, ours: Records, theirs: Records, ratio: np.ndarray, gain: np.ndarray) -> Table:
    name, other = grid.strategies
    rows = [(model, loss) for model in grid.models for loss in grid.losses]
    chosen = {row: [k for k, r in enumerate(ours) if (r.model, r.loss) == row] for row in rows}

    def stuck(records: Records, strategy: str) -> Column[tuple[str, str]]:
        return Column(f"stuck, {strategy}", lambda row: outlier_count(records, *row))

    def delta_e76(records: Records, strategy: str) -> Column[tuple[str, str]]:
        def value(row: tuple[str, str]) -> float:
            return mean_difference([records[k] for k in chosen[row]], row[1], DIFFERENCE)

        return Column(f"mean ΔE, {strategy}", value, ".2f")

    columns = [
        Column("model", lambda row: model_label(row[0])),
        Column("metric", lambda row: loss_label(row[1])),
        stuck(theirs, other),
        stuck(ours, name),
        Column(f"{name} lower by 1 %", lambda row: int((ratio[chosen[row]] > 1 + SAME).sum())),
        Column("error ratio, median", lambda row: np.median(ratio[chosen[row]]), ".3f"),
        Column("range", lambda row: ratio[chosen[row]], lambda own: f"{own.min():.3f} to {own.max():.3f}"),
        delta_e76(theirs, other),
        delta_e76(ours, name),
        Column(
            "closer / farther",
            lambda row: gain[chosen[row]],
            lambda own: f"{int((own > VISIBLE).sum())} / {int((own < -VISIBLE).sum())}",
        ),
    ]
    note = (
        f"Stuck: local minima by the paper's test, among the fits of one strategy. Error ratio: {other} over "
        f"{name}. Closer / farther: pictures that the {name} fit brings closer to the reference, or farther from it, "
        f"by more than {VISIBLE} ΔE."
    )
    return table(f"{other.capitalize()} beside {name}", note, rows, columns)


def _pictures(pictures: Pictures, ours: Records, theirs: Records, ratio: np.ndarray, path: Path) -> Path | None:
    """The fits whose error differs most, as pictures."""
    order = [k for k in np.argsort(-ratio)[:SHOWN] if ratio[k] > 1 + SAME]
    if not order:
        return None
    grid = pictures.grid
    titles = [f"{ours[k].material}\n{model_label(ours[k].model)}, {loss_label(ours[k].loss)}" for k in order]
    name, other = grid.strategies
    rows = {
        "reference": [pictures.path(picture_name(ours[k].material)) for k in order],
        other: [pictures.path(grid.picture(theirs[k])) for k in order],
        name: [pictures.path(grid.picture(ours[k])) for k in order],
    }
    grid_figure(path, titles, rows, grid.stand_in)
    return path
