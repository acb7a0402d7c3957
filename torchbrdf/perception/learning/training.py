"""Learn the constants of `LearnedLoss` from answers: likelihood, cross-validation, the bootstrap."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch
from scipy.optimize import LinearConstraint, minimize
from torch import Tensor

from torchbrdf.bootstrap import percentile_interval, resample_counts
from torchbrdf.losses.base import Loss
from torchbrdf.losses.metric_file import CONSTANTS
from torchbrdf.perception.agreement.scores import EvaluatedBrdfs, distances
from torchbrdf.perception.agreement.statistics import DistanceComparisons
from torchbrdf.perception.learning.training_set import Judgments, TrainingSet
from torchbrdf.precision import undisturbed

# What the mean likelihood of each part of the answers counts.
PART_WEIGHT = {"triplets": 1.0, "pairs": 1.0, "across": 0.5, "choices": 1.0}
# How often people answer at random; keeps one answer from counting without limit.
LAPSE = 0.02
# Slopes at the start, of triplets and of all else, for distances whose mean is 1; and the bounds of their logarithms.
SLOPES = (3.0, 6.0)
LOG_SLOPES = (-3.0, 6.0)


@dataclass(frozen=True)
class Split:
    """What is learned from: how often each material counts, `(K,)`, and the places of methods that are left out."""

    name: str
    materials: Tensor
    without: tuple[int, ...] = ()


@dataclass(frozen=True)
class Training:
    """What a training found, float64.

    constants: `(T,)`, in units of the mean distance of two materials; slopes: `(2,)`, of triplets and of all else, for
    distances in that unit; mismatch: mean negative log-likelihood of what was learned from, and of the rest, `(2,)`.
    """

    constants: Tensor
    slopes: Tensor
    mismatch: Tensor


def select_judgments(training_set: TrainingSet, own: Judgments, split: Split, *, seen: bool) -> Judgments:
    """Judgments that a split learns from, or those about nothing of what it learns from.

    Each counts as often as its materials do; where methods are left out, those are judged that need both of two.
    """
    times = split.materials if seen else split.materials == 0
    times = torch.cat([times.double(), times.new_ones(1, dtype=torch.float64)])[own.materials].prod(1)
    left_out = _left_out(training_set, own.first, own.second, split.without)
    chosen = (times > 0) & ((left_out == 0) if seen else (left_out >= len(split.without)))
    found = own.select(chosen)
    return Judgments(found.first, found.second, found.share, found.count * times[chosen], found.materials)


def _left_out(training_set: TrainingSet, first: Tensor, second: Tensor, without: tuple[int, ...]) -> Tensor:
    """How many of two distances are of methods that are left out."""
    chosen = torch.tensor(without, dtype=torch.int64, device="cpu")
    return torch.isin(training_set.method[torch.stack([first, second])], chosen).sum(0)


def negative_log_likelihood(
    training_set: TrainingSet, judgments: Mapping[str, Judgments], constants: Tensor, slopes: Tensor
) -> Tensor:
    """Mean negative log-likelihood of the votes, the parts weighted by `PART_WEIGHT`.

    P(first) = Phi(slope (d_second - d_first)). slopes: of triplets and of all else, `(2,)`. A part of which nothing was
    asked does not count.
    """
    distance = training_set.terms @ constants
    total = 0 * distance.sum()  # of no answers at all: nothing to learn, and a slope of 0
    for part, own in judgments.items():
        if len(own):
            slope = slopes[0 if part == "triplets" else 1]
            argument = (slope * (distance[own.second] - distance[own.first])).clamp(-6, 6)
            chance = LAPSE + (1 - 2 * LAPSE) * torch.special.ndtr(argument)
            likely = own.share * chance.log() + (1 - own.share) * (1 - chance).log()
            total = total - PART_WEIGHT[part] * (own.count * likely).sum() / own.count.sum()
    return total


@undisturbed()
def train(training_set: TrainingSet, split: Split, given: tuple[float, ...]) -> Training:
    """Train constants on what a split learns from, by sequential quadratic programming; the rest is judged.

    What is sought is the share of each term in the mean distance of two materials, at least 0; they add up to 1, and
    those of the last terms are given. There is nothing random in it.
    """
    scale = training_set.terms[training_set.usual].mean(0).clamp_min(1e-12)
    free, left = len(scale) - len(given), 1 - sum(given)
    fixed = torch.tensor(given, dtype=torch.float64, device="cpu")
    parts = [
        {name: select_judgments(training_set, own, split, seen=seen) for name, own in training_set.judgments.items()}
        for seen in (True, False)
    ]

    def unpacked(x: Tensor) -> tuple[Tensor, Tensor]:
        return torch.cat([x[:free], fixed]) / scale, x[free:].exp()

    def value(x: np.ndarray) -> tuple[float, np.ndarray]:
        point = torch.from_numpy(x.copy()).requires_grad_()
        mismatch = negative_log_likelihood(training_set, parts[0], *unpacked(point))
        (gradient,) = torch.autograd.grad(mismatch, point)
        return float(mismatch.detach()), gradient.numpy()

    best = minimize(
        value,
        np.array([left / free] * free + [math.log(slope) for slope in SLOPES]),
        jac=True,
        method="SLSQP",
        bounds=[(0, 1)] * free + [LOG_SLOPES] * 2,
        constraints=[LinearConstraint([[1.0] * free + [0.0] * 2], left, left)],
        options={"maxiter": 300, "ftol": 1e-10},
    ).x
    constants, slopes = unpacked(torch.from_numpy(best))
    constants = constants.clamp_min(0)  # rounding
    mismatch = [negative_log_likelihood(training_set, part, constants, slopes) for part in parts]
    return Training(constants, slopes, torch.stack(mismatch))


def splits(training_set: TrainingSet, repeats: int, seed: int) -> Iterator[Split]:
    """Repeated two-fold cross-validation over materials.

    In the first of them, every method and every two methods are left out as well.
    """
    generator = torch.Generator("cpu").manual_seed(seed)
    count, methods = len(training_set.names), range(len(training_set.methods))
    groups = [group for size in (1, 2) if len(methods) > size for group in combinations(methods, size)]
    for repeat in range(repeats):
        chosen = torch.zeros(count, dtype=torch.bool, device="cpu")
        chosen[torch.randperm(count, generator=generator, device="cpu")[: count // 2]] = True
        for fold, own in enumerate((chosen, ~chosen)):
            yield Split(f"half-{repeat}-{fold}", own)
            for group in groups if not repeat else ():
                yield Split(f"half-{repeat}-{fold}-without-{'-'.join(map(str, group))}", own, group)


def constants_by_name(constants: Tensor) -> dict[str, float]:
    """Constants `(T,)` as `metric.json` has them, to four digits."""
    return {name: float(f"{value:.4g}") for name, value in zip(CONSTANTS, constants.tolist(), strict=True)}


def constant_intervals(
    training_set: TrainingSet, given: tuple[float, ...], replicates: int, seed: int
) -> dict[str, tuple[float, float]]:
    """95 % intervals of the constants: trainings on materials drawn with replacement."""
    drawn = resample_counts(len(training_set.names), replicates, seed)
    found = [train(training_set, Split("drawn", times), given).constants for times in drawn]
    low, high = map(constants_by_name, percentile_interval(torch.stack(found)).unbind(1))
    return {name: (low[name], high[name]) for name in CONSTANTS}


def baseline_distances(
    training_set: TrainingSet, seen: EvaluatedBrdfs, losses: Mapping[str, Loss]
) -> dict[str, Tensor]:
    """Distances of a training set by other losses, `(E,)` each."""
    between = training_set.method < 0
    found = {}
    for name, loss in losses.items():
        distance = torch.empty(len(training_set.terms), dtype=torch.float64, device="cpu")
        for own, values in ((between, seen.materials), (~between, seen.approximations)):
            place = training_set.first[own], training_set.second[own]
            distance[own] = distances(loss, values, seen.materials, seen.pairs, *place)
        found[name] = distance
    return found


# Of a statistic and a metric: its share of comparisons ordered right, and how much more the learned one has; each with
# the ends of its 95 % interval.
HeldOut = dict[str, dict[str, dict[str, list[float]]]]


def held_out(
    training_set: TrainingSet,
    judged: list[tuple[Split, Tensor]],
    others: Mapping[str, Tensor],
    seed: int = 0,
    replicates: int = 1000,
) -> HeldOut:
    """Held-out agreement: how often distances are ordered right by constants learned without their materials.

    judged: splits, and the constants `(T,)` that were learned in them; others: distances to compare with, `(E,)` each.
    `{statistic: {"learned" or other: {"share": [value, low, high], "gain": [...]}}}`: 95 % intervals from materials
    resampled with replacement, the gain on the same comparisons and materials. A comparison is judged in every split in
    which nothing of it was seen (where one method is left out, it is of that one; where two are, of those alone), and
    counts as their mean.
    """
    draws = resample_counts(len(training_set.names), replicates, seed)
    learned = torch.stack([training_set.terms @ constants for _, constants in judged])
    found: HeldOut = {}
    for statistic, own in training_set.statistics.items():
        unseen = torch.stack([_unseen(training_set, own, split) for split, _ in judged]).double()
        tested = (unseen.sum(0) > 0).nonzero()[:, 0]
        if not len(tested):
            continue
        mine = (own.concordant(learned) * unseen).sum(0)[tested] / unseen.sum(0)[tested]
        part = DistanceComparisons(
            own.nearer[tested],
            own.farther[tested],
            own.materials[tested],
            own.weight[tested],
            own.group[tested].unique(return_inverse=True)[1],
        )
        rows = torch.cat([mine[None], part.concordant(torch.stack(list(others.values())))] if others else [mine[None]])
        share, resampled = part.agreement_rate(rows), part.agreement_rate(rows, draws)
        ends, gains = percentile_interval(resampled), percentile_interval(resampled[:, :1] - resampled)
        found[statistic] = {
            name: {
                "share": [float(share[k]), *ends[k].tolist()],
                "gain": [float(share[0] - share[k]), *gains[k].tolist()],
            }
            for k, name in enumerate(["learned", *others])
        }
    return found


def _unseen(training_set: TrainingSet, own: DistanceComparisons, split: Split) -> Tensor:
    about = ((split.materials == 0)[own.materials] | (own.materials < 0)).all(1)
    return about & (_left_out(training_set, own.nearer, own.farther, split.without) >= len(split.without))
