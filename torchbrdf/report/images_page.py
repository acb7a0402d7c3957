"""report.html of analytic metrics beside losses of pictures."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.experiment import statistics
from torchbrdf.experiment.grid import FitGrid, picture_name
from torchbrdf.experiment.labels import difference_label, diffuse_label, loss_label, model_label
from torchbrdf.experiment.pictures import BRIGHTEST, DIFFERENCE, Pictures
from torchbrdf.files import write_text
from torchbrdf.images import DIFFERENCES
from torchbrdf.perception.discrimination.words import MEANING, brief
from torchbrdf.report.embed import embed_png, embed_webp, template
from torchbrdf.report.figures import bars_figure, grid_figure
from torchbrdf.report.meaning import scales
from torchbrdf.report.tables import Column, Table, table

TITLE = "Which metric stands in for looking at pictures?"


def write_images_report(pictures: Pictures, scenes: Mapping[str, str], used: str, problems: Sequence[str]) -> Path:
    """Write `report.html` for a grid whose fits and pictures are done.

    Args:
        pictures: Of the grid, in two scenes.
        scenes: Of each scene what it is, in words, the training scene first.
        used: What losses of pictures saw, in words.
        problems: What was left out.

    Returns:
        The path of the page.
    """
    grid, folder = pictures.grid, pictures.grid.folder.path
    training, unseen = scenes
    pictured = [name for name, loss in grid.losses.items() if loss.scene_summary]
    analytic = [name for name in grid.losses if name not in pictured]
    figure = folder / "figures" / "losses.png"
    means = {scene: {x: _values(pictures.records_in(scene), x) for x in grid.losses} for scene in scenes}
    bars_figure(figure, means, pictured, grid.stand_in)
    for scene in scenes:
        for model in grid.models:
            _grid_figure(pictures, scene, model)
    page = template("images.html").render(
        title=TITLE,
        grid=grid,
        diffuse=diffuse_label(grid.diffuse),
        stand_in=grid.stand_in,
        problems=problems,
        findings=findings(pictures, training, unseen, analytic, pictured),
        brightest=f"{BRIGHTEST:g}",
        blocks=[_block(pictures, scene, model, scenes) for scene in (unseen, training) for model in grid.models],
        figure=embed_png(figure),
        scales=scales(pictures.differences),
        meaning=MEANING,
        tables=[
            *(_difference_table(pictures, scene, scenes[scene]) for scene in (unseen, training)),
            *(_choice_table(grid, loss) for loss in grid.own_strategies),
            *(_agreement_table(pictures, scene, _metrics(grid)) for scene in (unseen, training)),
            _error_table(grid),
            _cost_table(grid),
        ],
        scenes={"training": scenes[training], "unseen": scenes[unseen]},
        used=used,
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )
    path = folder / "report.html"
    write_text(path, page)
    return path


def findings(pictures: Pictures, training: str, unseen: str, analytic: list[str], pictured: list[str]) -> list[str]:
    """What the numbers say, in sentences."""
    grid = pictures.grid
    records = pictures.records_in(unseen)
    agree = {
        metric: np.mean([statistics.rank_agreement(records, metric, difference) for difference in pictures.differences])
        for metric in analytic
    }
    order = sorted(analytic, key=lambda metric: -agree[metric])
    lines = [
        "The analytic metric that stands in best for looking at pictures: "
        f"{loss_label(order[0])}. It ranks the fits of a material as the image differences of the unseen scene do with "
        f"a mean correlation of {agree[order[0]]:.2f}; "
        + ", ".join(f"{loss_label(metric)} {agree[metric]:.2f}" for metric in order[1:])
        + "."
    ]
    for scene in (unseen, training):
        mean = {x: float(np.mean(_values(pictures.records_in(scene), x))) for x in grid.losses}
        best, bought = (min(part, key=lambda x: mean[x]) for part in (analytic, pictured))
        lines.append(
            f"In the {scene} scene the fits under {loss_label(best)} look best of those under analytic metrics (mean "
            f"ΔE {mean[best]:.2f}), those by {loss_label(bought)} best of those that see pictures ({mean[bought]:.2f})."
        )
    mean = {x: float(np.mean(_values(records, x))) for x in grid.losses}
    nearest = min(pictured, key=lambda x: mean[x])
    for loss in pictured:
        ours = _by_fit(records, loss)
        others = {key: min(_by_fit(records, x)[key] for x in analytic) for key in ours}
        count = sum(ours[key] <= others[key] for key in ours)
        lines.append(
            f"{loss_label(loss)}: in the unseen scene mean ΔE {mean[loss]:.2f}, {mean[loss] / mean[nearest]:.2f} times "
            f"that of {loss_label(nearest)}; no farther from the reference than the best of all "
            f"{len(analytic)} analytic metrics in {count} of {len(ours)} fits. A fit took "
            f"{_seconds(grid, loss):.1f} s; analytic ones {min(_seconds(grid, x) for x in analytic):.2f} to "
            f"{max(_seconds(grid, x) for x in analytic):.2f} s."
        )
    return lines


def _values(records: statistics.Records, loss: str) -> list[float]:
    return [record.differences[DIFFERENCE] for record in records if record.loss == loss]


def _by_fit(records: statistics.Records, loss: str) -> dict[tuple[str, str], float]:
    return {(r.material, r.model): r.differences[DIFFERENCE] for r in records if r.loss == loss}


def _seconds(grid: FitGrid, loss: str) -> float:
    return float(np.mean([record.seconds for record in grid.shown if record.loss == loss]))


def _block(pictures: Pictures, scene: str, model: str, scenes: Mapping[str, str]) -> dict[str, Any]:
    """The pictures of one model's fits in one scene."""
    grid = pictures.grid
    rows = []
    for material in grid.materials:
        fits = []
        for loss in grid.losses:
            record = grid.record(material, model, loss)
            name = grid.picture(record)
            fits.append(
                {
                    "loss": loss_label(loss),
                    "image": embed_webp(pictures.path(name, scene)),
                    "map": embed_webp(pictures.path(f"map-{name}", scene)),
                    "delta_e76": record.pictures[scene][DIFFERENCE],
                    "told": brief(DIFFERENCE, record.pictures[scene][DIFFERENCE]),
                }
            )
        reference = embed_webp(pictures.path(picture_name(material), scene))
        rows.append({"material": material, "reference": reference, "fits": fits})
    label = f"{model_label(model)}, {scene} scene ({scenes[scene]})"
    return {"label": label, "losses": [loss_label(loss) for loss in grid.losses], "rows": rows}


def _metrics(grid: FitGrid) -> list[str]:
    """The losses without those that a loss before them is, too, but for the strategy."""
    return [loss for loss in grid.losses if loss not in grid.own_strategies]


def _grid_figure(pictures: Pictures, scene: str, model: str) -> None:
    """The pictures of one model's fits in one scene as a figure."""
    grid = pictures.grid
    lines = {"reference": [pictures.path(picture_name(material), scene) for material in grid.materials]}
    for loss in grid.losses:
        records = [grid.record(material, model, loss) for material in grid.materials]
        lines[loss_label(loss).replace(" + ", "\n+ ")] = [
            pictures.path(grid.picture(record), scene) for record in records
        ]
    grid_figure(grid.folder.path / "figures" / f"{scene}-{model}.png", grid.materials, lines, grid.stand_in)


def _difference_table(pictures: Pictures, scene: str, words: str) -> Table:
    """Mean image differences of the fits under each loss."""
    records = pictures.records_in(scene)

    def difference(name: str) -> Column[str]:
        best = max if DIFFERENCES[name].higher_is_better else min
        return Column(difference_label(name), lambda loss: statistics.mean_difference(records, loss, name), ".3f", best)

    treated = diffuse_label(pictures.grid.diffuse)
    note = f"Means over all materials and models, in the {scene} scene ({words}); {treated}. Bold: the best."
    columns = [Column("fits under", loss_label), *map(difference, pictures.differences)]
    return table(f"Fits judged by pictures: {scene} scene", note, pictures.grid.losses, columns)


def _choice_table(grid: FitGrid, loss: str) -> Table:
    """How often the fit under each metric was the nearest."""
    counts = {
        model: Counter(record.chosen for record in grid.shown if record.loss == loss and record.model == model)
        for model in grid.models
    }
    names = sorted({name for own in counts.values() for name in own}, key=lambda x: -sum(c[x] for c in counts.values()))

    def count(model: str) -> Column[str]:
        return Column(model_label(model), lambda name: counts[model][name])

    note = f"For how many of the {len(grid.materials)} materials the fit under each metric was the nearest."
    return table(
        f"What {loss_label(loss)} chose", note, names, [Column("metric", loss_label), *map(count, grid.models)]
    )


def _agreement_table(pictures: Pictures, scene: str, metrics: Sequence[str]) -> Table:
    """How each metric ranks fits, beside how image differences do."""
    records = pictures.records_in(scene)

    def agreement(name: str) -> Column[str]:
        return Column(difference_label(name), lambda metric: statistics.rank_agreement(records, metric, name), ".2f")

    def mean(metric: str) -> float:
        return float(np.mean([statistics.rank_agreement(records, metric, name) for name in pictures.differences]))

    note = (
        "Spearman's rank correlation between a metric's error and an image difference over all fits of a material "
        f"(every model and loss), averaged over materials, in the {scene} scene; 1: always in the same order."
    )
    columns = [Column("metric", loss_label), *map(agreement, pictures.differences), Column("mean", mean, ".2f")]
    return table(f"Which metric stands in for pictures: {scene} scene", note, metrics, columns)


def _error_table(grid: FitGrid) -> Table:
    """Every error under every loss, relative to that of the loss's own fits."""

    def ratio(metric: str) -> Column[str]:
        own = {(r.material, r.model): r.errors[metric] for r in grid.shown if r.loss == metric}

        def value(loss: str) -> float:
            theirs = [(r.errors[metric], own[r.material, r.model]) for r in grid.shown if r.loss == loss]
            return float(np.median([error / least if least else 1.0 for error, least in theirs]))

        return Column(loss_label(metric), value, ".2f")

    note = (
        "The error of the fits under the loss of a row, measured by the loss of a column, over that of the column's "
        "own fits; the median over materials and models."
    )
    columns = [Column("fits under", loss_label), *map(ratio, _metrics(grid))]
    return table("Errors across losses", note, grid.losses, columns)


def _cost_table(grid: FitGrid) -> Table:
    """Seconds a fit."""

    def seconds(model: str) -> Column[str]:
        return Column(
            f"{model_label(model)}, s",
            lambda loss: np.mean([r.seconds for r in grid.shown if r.loss == loss and r.model == model]),
            ".2f",
        )

    def odd(loss: str) -> int:
        return sum(r.status != "converged" for r in grid.shown if r.loss == loss)

    note = "Seconds a fit, on this machine, with all materials fitted side by side."
    columns = [Column("loss", loss_label), *map(seconds, grid.models), Column("not converged", odd)]
    return table("Cost", note, grid.losses, columns)
