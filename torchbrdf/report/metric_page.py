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
CONSTANTS_NOTE = (
    "Intervals: trainings on materials drawn with replacement. The shares of bins and of single values in the mean "
    "distance of two materials are set, not learned."
)
KEPT = (
    (
        "Materials that it never saw",
        "Share of comparisons ordered as people order them, with 95 % intervals over materials; 0.5 is chance. The "
        "learned metric was learned on one half of the materials and judged on the other, again and again; all are "
        "judged on the same comparisons. Nothing was chosen with a look at what was held out.",
    ),
    (
        "Materials and a method that it never saw",
        "As above, but no opinion of the method in question was learned from either: what the metric makes of "
        "approximations of a kind that it has not met.",
    ),
    (
        "Materials and two methods that it never saw",
        "As above, without two methods; what is compared is of these alone.",
    ),
)
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
    shares = folder / "figures" / "shares.png"
    _draw_shares(shares, trained, mark)
    tables = [_constants_table(trained.metric)]
    for left_out, results in trained.held_out.items():
        title, note = KEPT[left_out]
        tables += [_share_table(title, note, results), _gain_table("How much more the learned metric has", results)]
    text = template("metric.html").render(
        title=TITLE,
        mark=mark,
        tables=tables,
        shares=embed_png(shares),
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


def _constants_table(metric: dict[str, Any]) -> Table:
    intervals = metric["provenance"]["intervals"]
    columns = [
        Column[str]("constant", str),
        Column[str]("value", lambda name: metric["constants"][name], ".4g"),
        Column[str]("95 % interval", lambda name: intervals[name], lambda ends: "{:.4g} to {:.4g}".format(*ends)),
    ]
    return table("Constants", CONSTANTS_NOTE, list(metric["constants"]), columns)


def _draw_shares(path: Path, trained: TrainedMetric, mark: str) -> None:
    """What each term has of distances, on average: a bar for each kind of distance."""
    kinds = list(trained.shares)
    heights = np.stack([trained.shares[name].numpy() for name in kinds])
    with new_figure(path, 6.5, 1.2 + 0.25 * len(kinds), mark) as figure:
        axes, start = figure.add_subplot(), np.zeros(len(kinds))
        for k, name in enumerate(trained.metric["constants"]):
            axes.barh(kinds, heights[:, k], left=start, label=name)
            start = start + heights[:, k]
        axes.invert_yaxis()
        axes.set_xlabel("mean distance; 1: as two materials, on average")
        axes.legend(frameon=False)
