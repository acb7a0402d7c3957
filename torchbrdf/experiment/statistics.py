"""What a grid of fits says in numbers: who is best, who is stuck, and which metric orders fits as pictures do."""

from collections.abc import Iterable, Sequence

import numpy as np

from torchbrdf.experiment.pictures import DIFFERENCE
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import FitRecord

Records = Sequence[FitRecord]


def penalty(value: float, difference: str) -> float:
    """An image difference turned so that lower is better."""
    return -value if DIFFERENCES[difference].higher_is_better else value


def best_counts(records: Records, losses: Iterable[str], difference: str) -> dict[str, int]:
    """For how many (material, model) the fit under each loss has the best image difference."""
    groups: dict[tuple[str, str], list[FitRecord]] = {}
    for record in records:
        groups.setdefault((record.material, record.model), []).append(record)
    counts = dict.fromkeys(losses, 0)
    for group in groups.values():
        counts[min(group, key=lambda record: penalty(record.differences[difference], difference)).loss] += 1
    return counts


def rank_agreement(records: Records, metric: str, difference: str) -> float:
    """How well a metric orders fits as an image difference does.

    Spearman's rank correlation over the fits of a material, averaged over materials; 1 if always in the same order.
    """
    found = []
    for material in dict.fromkeys(record.material for record in records):
        own = [record for record in records if record.material == material]
        errors = [record.errors[metric] for record in own]
        differences = [penalty(record.differences[difference], difference) for record in own]
        if len(own) > 2 and np.ptp(errors) > 0 and np.ptp(differences) > 0:
            found.append(float(np.corrcoef(_ranks(errors), _ranks(differences))[0, 1]))
    return float(np.mean(found)) if found else float("nan")


def _ranks(values: Sequence[float]) -> np.ndarray:
    """The rank of each value; of equals their mean rank."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - (counts - 1) / 2)[place]


def outlier_count(records: Records, model: str, loss: str) -> int:
    """How many fits of a model under a loss are stuck in a local minimum."""
    return sum(bool(record.outlier) for record in records if record.model == model and record.loss == loss)


def mean_difference(records: Records, loss: str, difference: str) -> float:
    """Mean image difference of the fits under a loss."""
    values = [record.differences[difference] for record in records if record.loss == loss]
    return float(np.mean(values)) if values else float("nan")


def error_ratios(records: Records, others: Records) -> np.ndarray:
    """Errors of another strategy over the strategy's, of the same fits."""
    pairs = zip(records, others, strict=True)
    return np.array([other.error / one.error if one.error else 1.0 for one, other in pairs])


def difference_gains(records: Records, others: Records) -> np.ndarray:
    """By how much the strategy's pictures are closer than another's, in units of the image difference."""
    pairs = zip(records, others, strict=True)
    return np.array([other.differences[DIFFERENCE] - one.differences[DIFFERENCE] for one, other in pairs])
