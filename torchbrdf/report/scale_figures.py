"""Figures of scales from observers' answers: the paper's Figures 5 and 6, and dots where materials share nothing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.experiment.conclusions import confused
from torchbrdf.experiment.labels import loss_label, model_label
from torchbrdf.experiment.scaling import ScaledExperiment
from torchbrdf.report.style import COLORS, new_figure
from torchbrdf.study import MEASURED

# More lines than these are no figure any more.
MOST_LINES = 12
UNIT = "scale (standard deviations of a difference)"
# Where no metric gives the colour.
_OTHERS = ("#4c72b0", "#dd8452", "#55a868", "#c44e52", "#8172b3", "#937860", "#da8bc3", "#8c8c8c")


@dataclass(frozen=True)
class Line:
    """A stimulus across materials: its label, its name in the answers, and the metric whose colour it has, or black."""

    label: str
    name: str
    loss: str | None = None
    black: bool = False


@dataclass(frozen=True)
class ScalePoint:
    """The scale value of a stimulus of a material, with its interval."""

    value: float
    low: float
    high: float
    outlier: bool = False
    confused: bool = False


Values = Mapping[tuple[str, str], ScalePoint]


def scales_figure(path: Path, scaled: ScaledExperiment, mark: str) -> str:
    """The paper's Figure 5 or 6, or dots where no plan says what belongs together; gives its caption."""
    plan = scaled.plan
    lost = confused(scaled.scales)
    values = {
        (material, name): ScalePoint(
            record["scale"],
            record["low"],
            record["high"],
            outlier=plan is not None and plan.material(material).stimuli[name].outlier,
            confused=name in lost[material],
        )
        for record in scaled.scales.records()
        for material, name in [(record["material"], record["stimulus"])]
    }
    panels = _panels(scaled)
    bars = "Bars: 95 % intervals."
    if panels and max(map(len, panels.values())) <= MOST_LINES and len(scaled.order) > 1:
        _lines_figure(path, scaled.order, panels, values, mark)
        said = ["Scale values, materials by rising DoI angle (sharpest highlight first).", bars]
        said += ["Black rectangles: fits stuck in a local minimum."] if any(p.outlier for p in values.values()) else []
        said += ["Rings: confused with the measured material."] if any(map(len, lost.values())) else []
        return " ".join(said)
    _dots_figure(path, scaled.order, values, mark)
    return f"Scale values of each material's stimuli. {bars}"


def _lines_figure(
    path: Path, order: Sequence[str], panels: Mapping[str, Sequence[Line]], values: Values, mark: str
) -> None:
    """Figures 5 and 6: a panel each, a line a stimulus, materials along it; bars are 95 % intervals.

    Outlier fits are in a black rectangle; what is confused with the measured material has a ring.
    """
    width = max(3.2, 0.26 * len(order) + 1.0)
    with new_figure(path, width * len(panels) + 1.2, 4.4, mark) as figure:
        axes = np.atleast_1d(figure.subplots(1, len(panels), sharey=True))
        for panel, (title, lines) in zip(axes, panels.items(), strict=True):
            for k, line in enumerate(lines):
                color = "black" if line.black else COLORS.get(line.loss or "", _OTHERS[k % len(_OTHERS)])
                offset = 0.09 * (k - (len(lines) - 1) / 2)
                _line(panel, [values.get((name, line.name)) for name in order], offset, line.label, color)
            panel.set_title(title)
            panel.set_xticks(range(len(order)), order, rotation=60, ha="right")
            panel.margins(x=0.04)
        axes[0].set_ylabel(UNIT + ",\nhigher looks closer")
        axes[-1].legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _dots_figure(path: Path, materials: Sequence[str], values: Values, mark: str) -> None:
    """A panel a material: its stimuli from the closest to the farthest."""
    sorted_names = {
        material: sorted((name for m, name in values if m == material), key=lambda name: values[material, name].value)
        for material in materials
    }
    most = max(map(len, sorted_names.values()))
    columns = min(3, len(materials))
    rows = -(-len(materials) // columns)
    with new_figure(path, 4.2 * columns, (0.24 * most + 0.9) * rows, mark) as figure:
        axes = np.atleast_1d(figure.subplots(rows, columns, sharex=True)).ravel()
        for panel, (material, names) in zip(axes, sorted_names.items(), strict=False):
            points = [values[material, name] for name in names]
            _bars(panel, [p.value for p in points], range(len(points)), points, "#4c72b0", "x")
            panel.set_yticks(range(len(names)), names, fontsize=8)
            panel.set_title(material)
        for panel in axes[len(materials) :]:
            panel.set_visible(False)
        figure.supxlabel(UNIT, fontsize=9)


def _line(panel: Any, points: Sequence[ScalePoint | None], offset: float, label: str, color: str) -> None:
    there = [(k + offset, point) for k, point in enumerate(points) if point is not None]
    x, shown = [place for place, _ in there], [point for _, point in there]
    _bars(panel, x, [point.value for point in shown], shown, color, "y", label)
    for place, point in there:
        if point.outlier:
            panel.plot(place, point.value, "s", ms=10, mfc="none", mec="black")
        if point.confused:
            panel.plot(place, point.value, "o", ms=9, mfc="none", mec=color, mew=1.4)


def _bars(
    panel: Any,
    x: Sequence[float],
    y: Sequence[float],
    points: Sequence[ScalePoint],
    color: str,
    along: str,
    label: str = "",
) -> None:
    """Points with their intervals along one axis, joined by a line where they stand side by side.

    A legend leaves labels out that begin with an underscore.
    """
    around = [[p.value - p.low for p in points], [p.high - p.value for p in points]]
    style = {"fmt": "o-" if along == "y" else "o", "ms": 4, "lw": 1, "elinewidth": 1, "capsize": 2}
    panel.errorbar(
        x,
        y,
        **{f"{along}err": np.array(around).clip(0)},
        color=color,
        label=f" {label}" if label.startswith("_") else label or None,
        **style,
    )


def _panels(scaled: ScaledExperiment) -> dict[str, list[Line]]:
    """A panel a model where there are several metrics; else one. What is no fit is in every panel."""
    if scaled.plan is None:
        return {}
    experiment = scaled.plan.experiment(scaled.name)
    stimuli = {name: scaled.plan.materials[0].stimuli[name] for name in experiment.stimuli}
    others = [Line(name, name) for name, what in stimuli.items() if what.model is None and name != MEASURED]
    others += [Line(name, name, black=True) for name in stimuli if name == MEASURED]
    if len({what.loss for what in stimuli.values()} - {None}) < 2:
        fits = [Line(model_label(what.model), name) for name, what in stimuli.items() if what.model]
        return {experiment.title: fits + others}
    return {
        model_label(model): [
            Line(loss_label(what.loss or name), name, what.loss)
            for name, what in stimuli.items()
            if what.model == model
        ]
        + others
        for model in dict.fromkeys(what.model for what in stimuli.values() if what.model)
    }
