"""What distances mean, for every metric of a benchmark: calibrated on its answers, checked by halves, and written."""

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch

from torchbrdf.errors import DataError
from torchbrdf.files import write_csv, write_json
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import FitRecord
from torchbrdf.losses import LOSSES, Loss, make_loss
from torchbrdf.measured import Measured, StandIn, load, standins
from torchbrdf.measured.standin import all_round
from torchbrdf.pairs import Pairs
from torchbrdf.perception import FORMULAS, BenchmarkData, Distances, find_metric, uniform_pairs
from torchbrdf.perception.discrimination.calibration import (
    ReliabilityBin,
    calibrate,
    choices,
    flat,
    mean_error,
    reliability,
)
from torchbrdf.perception.discrimination.psychometric import (
    BUNDLED,
    Discrimination,
    DiscriminationFile,
    JustObjectionable,
    Share,
    discrimination_of,
)
from torchbrdf.recipe import RunFolder

METRIC = "learned"
"""The metric that says what fits mean, whatever loss they were made under."""
# Of covariances; each takes a pass over all answers.
MOST_REPLICATES = 200
# Where fits are compared by it, as where it was calibrated.
PAIRS = 6000


@dataclass(frozen=True)
class Calibrated:
    """What distances mean under the metrics of a benchmark, and how that was checked on answers kept apart."""

    metrics: dict[str, Discrimination]
    bins: dict[str, list[ReliabilityBin]]


def calibrate_metrics(
    folder: RunFolder,
    data: BenchmarkData,
    distances: Mapping[str, Distances],
    provenance: Mapping[str, Any],
    replicates: int,
    seed: int,
) -> Calibrated:
    """Calibrate every metric with distances of all kinds; write `discrimination.json` and `reliability.csv`.

    Args:
        folder: Of the run.
        data: What people were asked.
        distances: By metric.
        provenance: Where the numbers come from, for the file.
        replicates: Of the bootstrap.
        seed: Of the halves and of the bootstrap.
    """
    parts, names = choices(data.triplets, data.opinions, data.names), data.names
    metrics: dict[str, Discrimination] = {}
    bins: dict[str, list[ReliabilityBin]] = {}
    progress = folder.progress("calibrations")
    for done, (metric, own) in enumerate(distances.items(), 1):
        every = flat(own)
        if every is not None and not _rises_with_likeness(metric):
            try:
                found = calibrate(every, parts, len(names), min(replicates, MOST_REPLICATES), seed)
                checked = reliability(every, parts, len(names), replicates, seed)
            except DataError as error:
                folder.warn(f"{metric}: what it means is not known: {error}")
                continue
            metrics[metric], bins[metric] = replace(found, check=mean_error(checked)), checked
            folder.log(f"{metric}: half of observers would tell apart what is {found.distance(0.5):.3g} apart")
        progress(done, len(distances))
    facts = {
        **provenance,
        "questions": len(data.triplets),
        "votes": int(data.triplets.votes.sum()),
        "pairs of opinions": len(parts["pairs"]) if "pairs" in parts else 0,
        "seed": seed,
        "date": time.strftime("%Y-%m-%d"),
        "probes": {metric: probe(metric) for metric in metrics if metric in LOSSES or metric in FORMULAS},
    }
    write_json(folder.path / BUNDLED, asdict(DiscriminationFile(metrics, facts)))
    write_csv(
        folder.path / "reliability.csv", [{"metric": name, **asdict(one)} for name, own in bins.items() for one in own]
    )
    return Calibrated(metrics, bins)


def probe(metric: str) -> float:
    """The distance of two of the bundled stand-ins: tells whether a calibration is of the metric that there is now."""
    pairs = uniform_pairs(500)
    values = load(standins(), dtype=torch.float64).batch([0, 1]).at(pairs)
    return float(f"{find_metric(metric)(values[:1], values[1:], pairs).item():.4g}")


def shares_of_fits(groups: list[Measured], records: list[FitRecord]) -> list[Share | None]:
    """How many observers would be expected to tell each fit from its material, by the learned metric.

    Args:
        groups: The materials.
        records: Fits of all of them, in their order.

    Returns:
        A share for each; None for a fit without a model, or where values have no distance.
    """
    known, loss, pairs = (
        discrimination_of(METRIC),
        make_loss(METRIC, "none"),
        all_round(uniform_pairs(PAIRS)).to(dtype=torch.float32),
    )
    if known is None:
        return [None] * len(records)
    materials = [(group, row) for group in groups for row in range(len(group))]
    found: list[Share | None] = []
    for (group, row), record in zip(materials, records, strict=True):
        found.append(_share(known, loss, group.batch([row]), record, pairs))
    return found


def shares_by_name(measured: Measured, records: list[FitRecord]) -> dict[str, Share | None]:
    """As `shares_of_fits`, by the materials' names.

    Args:
        measured: The materials.
        records: Fits of some of them.
    """
    rows = {name: row for row, name in enumerate(measured.names)}
    own = [measured.batch([rows[record.material]]) for record in records]
    return dict(zip((record.material for record in records), shares_of_fits(own, records), strict=True))


def _share(
    known: Discrimination | JustObjectionable, loss: Loss, material: Measured, record: FitRecord, pairs: Pairs
) -> Share | None:
    if not math.isfinite(record.error) or not material.has_colors:
        return None
    with torch.no_grad():
        fitted = Measured(StandIn([record], [])).at(pairs)  # as linear RGB, as people see it
        distance = loss(fitted, material.to_rgb().at(pairs).to(fitted), pairs).item()
    return known.share(distance) if 0 <= distance < torch.inf else None


def _rises_with_likeness(metric: str) -> bool:
    name = metric.removeprefix("rendered_")
    return metric.startswith("rendered_") and name in DIFFERENCES and DIFFERENCES[name].higher_is_better
