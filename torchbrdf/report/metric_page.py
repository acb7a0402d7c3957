"""report.html of a learned metric: how well it foretells answers about what it never saw, and what it looks at."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.experiment.labels import loss_label
from torchbrdf.experiment.metric_training import TrainedMetric
from torchbrdf.files import write_text
from torchbrdf.perception.agreement.table import LABELS
from torchbrdf.perception.learning.training import HeldOut
from torchbrdf.report.embed import embed_png, template
from torchbrdf.report.style import new_figure
from torchbrdf.report.tables import Column, Table, table

TITLE = "A metric learned from answers"
MORE = "Its share minus that of each formula, with the paired 95 % interval. Bold: all of the interval is above 0."


def write_metric_report(folder: Path, trained: TrainedMetric, mark: str) -> Path:
    """Draw the figures and write `report.html`.

    Args:
        folder: Of the run.
        trained: The metric, and how good it is.
        mark: What figures have to say; nothing, where answers are people's.

    Returns:
        The path of the trained.
    """
    curves, weights = folder / "figures" / "curves.png", folder / "figures" / "weights.png"
    _draw_curves(curves, trained, mark)
    _draw_weights(weights, trained.metric, mark)
    note = (
        "Share of comparisons ordered as people order them, with 95 % intervals over materials; 0.5 is chance. The "
        "learned metric was learned on one half of the materials and judged on the other, again and again; all are "
        "judged on the same comparisons. One thing was chosen with a look at all of them: the iteration at which "
        "training stops."
    )
    tables = [
        _share_table("Materials that it never saw", note, trained.materials),
        _gain_table("How much more the learned metric has", trained.materials),
    ]
    if trained.methods:
        note = (
            "As above, but no opinion of the method in question was learned from either: what the metric makes of "
            "approximations of a kind that it has not met."
        )
        tables += [
            _share_table("Materials and methods that it never saw", note, trained.methods),
            _gain_table("How much more it has there", trained.methods),
        ]
    text = template("metric.html").render(
        title=TITLE,
        mark=mark,
        tables=tables,
        curves=embed_png(curves),
        weights=embed_png(weights),
        provenance=json.dumps(trained.metric["provenance"], indent=1),
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )
    path = folder / "report.html"
    write_text(path, text)
    return path


def _share_table(title: str, note: str, results: HeldOut) -> Table:
    def share(name: str, own: dict[str, dict[str, list[float]]]) -> Column[str]:
        return Column(
            _label(name),
            lambda metric: own[metric]["share"],
            lambda found: "{:.3f} ({:.3f} to {:.3f})".format(*found),
            max,
            key=lambda found: found[0],
        )

    columns = [Column("metric", loss_label), *(share(name, own) for name, own in results.items())]
    return table(title, note, _names(results), columns)


def _gain_table(title: str, results: HeldOut) -> Table:
    def gain(name: str, own: dict[str, dict[str, list[float]]]) -> Column[str]:
        return Column(
            _label(name),
            lambda metric: own[metric]["gain"],
            lambda found: "{:+.3f} ({:+.3f} to {:+.3f})".format(*found),
            bold=lambda metric: own[metric]["gain"][1] > 0,
        )

    head = Column[str]("", lambda metric: f"than {loss_label(metric)}")
    return table(title, MORE, _names(results)[1:], [head, *(gain(name, own) for name, own in results.items())])


def _label(statistic: str) -> str:
    return "choices of observers: majority" if statistic == "choices" else LABELS[statistic]


def _names(table: HeldOut) -> list[str]:
    """The metrics, the learned one first."""
    return list(next(iter(table.values())))


def _draw_curves(path: Path, trained: TrainedMetric, mark: str) -> None:
    with new_figure(path, 5.5, 3.2, mark) as figure:
        axes = figure.add_subplot()
        steps = np.arange(1, trained.curves.shape[1] + 1)
        for k, (label, color) in enumerate((("learned from", "#4c72b0"), ("held out", "#c44e52"))):
            axes.plot(steps, trained.curves[..., k].T.numpy(), color=color, alpha=0.2, linewidth=0.7)
            axes.plot(steps, trained.curves[..., k].mean(0).numpy(), color=color, label=label)
        axes.axvline(trained.best + 1, color="black", linewidth=0.8, linestyle=":")
        axes.set_xlabel("iteration; dotted: where training stops")
        axes.set_ylabel("mean negative log-likelihood")
        axes.legend(frameon=False)


def _draw_weights(path: Path, metric: dict[str, Any], mark: str) -> None:
    """The learned weights, as shades of their roots: rows are bins of theta_h, columns of theta_d."""
    weights, high, wide = metric["weights"], metric["theta_h"], metric["theta_d"]
    between = [f"{a:g}-{b:g}" for i, a in enumerate(high) for b in high[i + 1 :]]
    parts = [
        ("pointwise", np.array(weights["pointwise"])[:, None], [f"{a:g}" for a in high]),
        *((f"mean\n{kind}", np.array(own), [f"{a:g}" for a in high]) for kind, own in weights["mean"].items()),
        *((f"contrast\n{kind}", np.array(own), between) for kind, own in weights["contrast"].items()),
    ]
    with new_figure(path, 9.5, 3.6, mark) as figure:
        panels = figure.subplots(1, len(parts), width_ratios=[1, 3, 3, 3, 3])
        for panel, (title, values, labels) in zip(panels, parts, strict=True):
            panel.imshow(np.sqrt(values), cmap="Blues", aspect="auto", vmin=0, vmax=np.sqrt(values).max() or 1)
            panel.grid(visible=False)
            panel.set_title(title, fontsize=8)
            panel.set_yticks(range(len(labels)), labels, fontsize=7)
            columns = [f"{b:g}" for b in wide] if values.shape[1] > 1 else ["all"]
            panel.set_xticks(range(len(columns)), columns, fontsize=7)
            for (row, column), value in np.ndenumerate(values):
                shade = "white" if value > 0.4 * values.max() else "black"
                panel.text(column, row, f"{value:.2g}", ha="center", va="center", fontsize=6, color=shade)
        panels[0].set_ylabel("theta_h, degrees")
        figure.supxlabel("theta_d, degrees", fontsize=8)
