"""What distances mean: the reliability figure, and a table of how many observers tell what apart."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from torchbrdf.experiment.discrimination import METRIC, Calibrated
from torchbrdf.experiment.labels import difference_label
from torchbrdf.perception.discrimination.calibration import ReliabilityBin
from torchbrdf.perception.discrimination.psychometric import Discrimination, Share, discrimination_of
from torchbrdf.perception.discrimination.words import MARKS, digits, scale
from torchbrdf.report.embed import embed_png
from torchbrdf.report.style import new_figure
from torchbrdf.report.tables import Column, Table, table

# Panels of the figure, how close marks on an axis may be, and how a row of the table calls the parts.
MOST_PANELS, CLOSE = 4, 0.08
PARTS = {"triplets": ("triplets of materials", "#4c72b0", "o"), "pairs": ("pairs of approximations", "#dd8452", "s")}


def meaning(figure: Path, calibrated: Calibrated, mark: str, label: Callable[[str], str]) -> dict[str, Any] | None:
    """What `meaning.html` shows; None where no metric could be calibrated.

    Args:
        figure: Where the figure is written.
        calibrated: The metrics.
        mark: What has to be written on the figure.
        label: Names of metrics for people.
    """
    if not calibrated.metrics:
        return None
    names = sorted(calibrated.metrics, key=lambda name: (name != METRIC, not name.startswith("rendered_")))
    reliability_figure(figure, {label(name): calibrated.bins[name] for name in names[:MOST_PANELS]}, mark)
    return {"figure": embed_png(figure), "table": meaning_table(calibrated.metrics, names, label)}


def scales(differences: Iterable[str]) -> list[str]:
    """The scales of those image differences of which it is known what they mean."""
    return [line for name in differences if (line := scale(name, difference_label(name)))]


def mark_shares(panel: Any, metric: str, along: Literal["x", "y"]) -> None:
    """Mark on the far side of a panel which share of observers would tell apart what lies so far along an axis.

    Args:
        panel: Drawn, so that its limits are known.
        metric: What is along the axis; nothing is marked where it is not known what it means.
        along: The axis.
    """
    known = discrimination_of(metric)
    if known is None:
        return
    low, high = panel.get_xlim() if along == "x" else panel.get_ylim()
    inside: list[tuple[float, str]] = []
    for tenth in range(1, 10):
        at, last = known.distance(tenth / 10), inside[-1][0] if inside else -math.inf
        if low <= at <= high and at - last > CLOSE * (high - low):
            inside.append((at, f"{10 * tenth} %"))
    axis = panel.secondary_xaxis("top") if along == "x" else panel.secondary_yaxis("right")
    ticks = [at for at, _ in inside], [text for _, text in inside]
    if along == "x":
        axis.set_xticks(*ticks)
        axis.set_xlabel("told apart by", fontsize=8)
    else:
        axis.set_yticks(*ticks)
        axis.set_ylabel("told apart by", fontsize=8)
    axis.tick_params(labelsize=8)


def reliability_figure(path: Path, bins: Mapping[str, Sequence[ReliabilityBin]], mark: str) -> None:
    """Shares of observers that were foretold beside those that were found, a panel a metric."""
    with new_figure(path, 3.1 * len(bins) + 0.5, 3.4, mark) as figure:
        panels = np.atleast_1d(figure.subplots(1, len(bins), sharey=True, sharex=True))
        for panel, (name, own) in zip(panels, bins.items(), strict=True):
            panel.plot([0.4, 1], [0.4, 1], color="grey", lw=0.8, ls=":")
            for part, (said, color, marker) in PARTS.items():
                here = [one for one in own if one.part == part]
                if not here:
                    continue
                across = [one.predicted for one in here]
                panel.vlines(across, [one.low for one in here], [one.high for one in here], color=color, alpha=0.5)
                panel.plot(across, [one.observed for one in here], marker, color=color, ms=5, label=said)
            panel.set(title=name, xlabel="share foretold", xlim=(0.45, 1), ylim=(0.4, 1))
        panels[0].set_ylabel("share found")
        panels[0].legend(frameon=False, fontsize=8, loc="upper left")


def meaning_table(metrics: Mapping[str, Discrimination], names: Sequence[str], label: Callable[[str], str]) -> Table:
    """The distances at which so many would tell two things apart, under each metric."""

    def at(share: float) -> Column[str]:
        head = Share(share, share, share).words
        return Column(f"{head} at", lambda name: _within(metrics[name], share))

    def check(part: str, said: str) -> Column[str]:
        return Column(f"off, {said}", lambda name: (metrics[name].check or {}).get(part), ".3f", min)

    columns = [
        Column[str]("metric", label),
        *map(at, MARKS),
        Column[str]("half, for one pair", lambda name: metrics[name].share(metrics[name].distance(0.5)).text),
        *(check(part, said) for part, (said, _, _) in PARTS.items()),
    ]
    note = (
        "Distances at which such a share of observers would be expected to tell two things apart; in brackets: beyond "
        "what was asked. Half, for one pair: the 95 % interval of the share where half is expected; the wider, the "
        "less a metric says about one pair. Off: how far, in the mean, shares in the other half of the answers are "
        "from those foretold."
    )
    return table("Told apart by", note, names, columns)


def _within(metric: Discrimination, share: float) -> str:
    distance = metric.distance(share)
    inside = metric.lowest <= distance <= metric.highest
    return digits(distance) if inside else f"({digits(distance)})"
