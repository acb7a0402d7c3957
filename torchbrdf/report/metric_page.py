"""report.html of a learned metric: how well it foretells answers about what it never saw, and what it looks at."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from torchbrdf.files import write_text
from torchbrdf.perception.agreement.table import LABELS
from torchbrdf.report.drawing import drawing
from torchbrdf.report.inline import png, template
from torchbrdf.report.labels import Cell, loss_label

TITLE = "A metric learned from answers"
MORE = "Its share minus that of each formula, with the paired 95 % interval. Bold: all of the interval is above 0."
Results = dict[str, dict[str, dict[str, list[float]]]]


@dataclass(frozen=True)
class MetricPage:
    """table and methods: results of `perception.learning.training.held_out`, with materials and with a method left out as
    well; metric: what `metric.json` holds; curves: `(trainings, iterations, 2)`; best: the iteration that is taken;
    mark: what figures have to say.
    """

    table: Results
    methods: Results
    metric: dict[str, Any]
    curves: Tensor
    best: int
    mark: str


def write_metric_report(folder: Path, page: MetricPage) -> Path:
    """Draw the figures and write `report.html`; gives its path."""
    curves, weights = folder / "figures" / "curves.png", folder / "figures" / "weights.png"
    _draw_curves(curves, page)
    _draw_weights(weights, page)
    tables = [
        {
            "title": "Materials that it never saw",
            "note": "Share of comparisons ordered as people order them, with 95 % intervals over materials; 0.5 is "
            "chance. The learned metric was learned on one half of the materials and judged on the other, again and "
            "again; all are judged on the same comparisons. One thing was chosen with a look at all of them: the "
            "iteration at which training stops.",
            **_shares(page.table),
        },
        {"title": "How much more the learned metric has", "note": MORE, **_gains(page.table)},
    ]
    if page.methods:
        note = (
            "As above, but no opinion of the method in question was learned from either: what the metric makes of "
            "approximations of a kind that it has not met."
        )
        tables += [
            {"title": "Materials and methods that it never saw", "note": note, **_shares(page.methods)},
            {"title": "How much more it has there", "note": MORE, **_gains(page.methods)},
        ]
    text = template("metric.html").render(
        title=TITLE,
        mark=page.mark,
        tables=tables,
        curves=png(curves),
        weights=png(weights),
        provenance=json.dumps(page.metric["provenance"], indent=1),
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )
    path = folder / "report.html"
    write_text(path, text)
    return path


def _shares(table: Results) -> dict[str, Any]:
    rows = []
    for name in _names(table):
        values = [own[name]["share"] for own in table.values()]
        best = [max(other["share"][0] for other in own.values()) for own in table.values()]
        spans = [f"{value:.3f} ({low:.3f} to {high:.3f})" for value, low, high in values]
        tops = [value[0] == top for value, top in zip(values, best, strict=True)]
        rows.append([Cell(loss_label(name)), *map(Cell, spans, tops)])
    return {"head": ["metric", *(_label(name) for name in table)], "rows": rows}


def _gains(table: Results) -> dict[str, Any]:
    rows = []
    for name in _names(table)[1:]:
        gains = [own[name]["gain"] for own in table.values()]
        cells = [Cell(f"{gain:+.3f} ({low:+.3f} to {high:+.3f})", low > 0) for gain, low, high in gains]
        rows.append([Cell(f"than {loss_label(name)}"), *cells])
    return {"head": ["", *(_label(name) for name in table)], "rows": rows}


def _label(statistic: str) -> str:
    return "choices of observers: majority" if statistic == "choices" else LABELS[statistic]


def _names(table: Results) -> list[str]:
    """The metrics, the learned one first."""
    return list(next(iter(table.values())))


def _draw_curves(path: Path, page: MetricPage) -> None:
    with drawing(path, 5.5, 3.2, page.mark) as figure:
        axes = figure.add_subplot()
        steps = np.arange(1, page.curves.shape[1] + 1)
        for k, (label, color) in enumerate((("learned from", "#4c72b0"), ("held out", "#c44e52"))):
            axes.plot(steps, page.curves[..., k].T.numpy(), color=color, alpha=0.2, linewidth=0.7)
            axes.plot(steps, page.curves[..., k].mean(0).numpy(), color=color, label=label)
        axes.axvline(page.best + 1, color="black", linewidth=0.8, linestyle=":")
        axes.set_xlabel("iteration; dotted: where training stops")
        axes.set_ylabel("mean negative log-likelihood")
        axes.legend(frameon=False)


def _draw_weights(path: Path, page: MetricPage) -> None:
    """The learned weights, as shades of their roots: rows are bins of theta_h, columns of theta_d."""
    weights, high, wide = page.metric["weights"], page.metric["theta_h"], page.metric["theta_d"]
    between = [f"{a:g}-{b:g}" for i, a in enumerate(high) for b in high[i + 1 :]]
    parts = [
        ("pointwise", np.array(weights["pointwise"])[:, None], [f"{a:g}" for a in high]),
        *((f"mean\n{kind}", np.array(own), [f"{a:g}" for a in high]) for kind, own in weights["mean"].items()),
        *((f"contrast\n{kind}", np.array(own), between) for kind, own in weights["contrast"].items()),
    ]
    with drawing(path, 9.5, 3.6, page.mark) as figure:
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
