"""report.html of published fits: their errors under every metric, beside those of our fits of the same models."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from torchbrdf.experiment.grid import FitGrid
from torchbrdf.experiment.labels import caveat, loss_label, model_label
from torchbrdf.experiment.published import Comparison
from torchbrdf.files import write_text
from torchbrdf.report.embed import embed_png, template
from torchbrdf.report.style import COLORS, new_figure, plain_ticks
from torchbrdf.report.tables import Column, Table, table

TITLE = "Published fits, beside ours of the same models"
NOTE = (
    "Medians: of the published errors of all materials; then, of those that we fitted, of the published errors and "
    "ours, and of their ratio, with the quarter and three quarters of materials. Lower: for how many of them our error "
    "is the lower one, as it has to be, ours being fitted under that metric to these very tables. Errors count pairs "
    "within {max_theta:g} degrees."
)


def write_published_report(
    grid: FitGrid, found: Sequence[Comparison], sources: Mapping[str, str], bad: Sequence[str]
) -> Path:
    """Draw the figure and write `report.html`.

    Args:
        grid: our fits.
        found: the comparisons.
        sources: where each set was published.
        bad: what was left out.

    Returns:
        The path of the page.
    """
    folder = grid.folder.path
    figure = folder / "figures" / "ratios.png"
    _draw_ratios(figure, found, caveat(grid.stand_in))
    text = template("published.html").render(
        title=TITLE,
        mark=caveat(grid.stand_in),
        tables=[_table(name, [one for one in found if one.name == name], sources[name], grid) for name in sources],
        figure=embed_png(figure),
        bad=bad,
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )
    path = folder / "report.html"
    write_text(path, text)
    return path


def _table(name: str, found: Sequence[Comparison], source: str, grid: FitGrid) -> Table:
    def quartiles(one: Comparison) -> list[float]:
        return [float(x) for x in np.quantile(one.ratio, [0.5, 0.25, 0.75])] if len(one.ratio) else []

    columns = [
        Column[Comparison]("metric", lambda one: loss_label(one.loss)),
        Column[Comparison]("materials", lambda one: len(one.materials)),
        Column[Comparison]("published, all", lambda one: _median(one.published), ".4g"),
        Column[Comparison]("published", lambda one: _median(one.published[one.fitted]), ".4g"),
        Column[Comparison]("ours", lambda one: _median(one.ours[one.fitted]), ".4g"),
        Column[Comparison]("ratio", quartiles, lambda q: f"{q[0]:.2f} ({q[1]:.2f} to {q[2]:.2f})" if q else ""),
        Column[Comparison]("lower", lambda one: f"{int((one.ratio >= 1).sum())} of {len(one.ratio)}"),
    ]
    model = model_label(found[0].model) if found else ""
    return table(f"{name}: {model}", f"{source}. {NOTE.format(max_theta=grid.max_theta)}", found, columns)


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None


def _draw_ratios(path: Path, found: Sequence[Comparison], mark: str) -> None:
    """Published error over ours, a point a material, a row a set and a colour a metric."""
    sets = list(dict.fromkeys(one.name for one in found))
    losses = list(dict.fromkeys(one.loss for one in found))
    with new_figure(path, 8, 1.4 + 0.75 * len(sets), mark) as figure:
        panel = figure.subplots()
        for k, loss in enumerate(losses):
            for row, name in enumerate(sets):
                (one,) = (one for one in found if one.name == name and one.loss == loss)
                place = row + (k + 0.5) / len(losses) * 0.8 - 0.4
                color = COLORS.get(loss, "#937860")
                panel.plot(one.ratio, np.full(len(one.ratio), place), ".", ms=4, alpha=0.45, color=color)
                if len(one.ratio):
                    label = loss_label(loss) if row == 0 else None
                    panel.plot(
                        [np.median(one.ratio)], [place], "D", ms=6, mec="black", mew=0.5, color=color, label=label
                    )
        panel.axvline(1, color="grey", lw=0.8)
        panel.set_yticks(range(len(sets)), sets)
        panel.set_ylim(len(sets) - 0.4, -0.6)
        panel.set(xscale="log", xlabel="published error over ours; diamonds: medians")
        plain_ticks(panel.xaxis)
        panel.legend(frameon=False, fontsize=7, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
