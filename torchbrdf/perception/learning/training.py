"""Learn the weights of `LearnedLoss` from answers: likelihood, early stopping, cross-validation."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchbrdf.bootstrap import percentile_interval, resample_counts
from torchbrdf.losses.base import Loss
from torchbrdf.losses.former import THETA_H_BINS, pack_weights
from torchbrdf.perception.agreement.scores import EvaluatedBrdfs, distances
from torchbrdf.perception.agreement.statistics import DistanceComparisons
from torchbrdf.perception.learning.training_set import Judgments, TrainingSet
from torchbrdf.precision import undisturbed

# What the mean likelihood of each part of the answers counts.
PART_WEIGHT = {"triplets": 1.0, "pairs": 1.0, "across": 0.5, "choices": 1.0}
# The slope of the probit of each part at the start, on a scale where distances are 1.
PART_SLOPE = {"triplets": 3.0, "pairs": 6.0, "across": 6.0, "choices": 6.0}
# How often people answer at random; keeps one answer from counting without limit.
LAPSE = 0.02
# The least share of pointwise terms in all weights: what people were asked about has hardly any spikes, and averages
# alone would let a fit hide them in a bin.
MIN_POINTWISE_SHARE = 0.1
# What it costs roots of weights to leave the start, where all are equal.
L2_PRIOR = 0.03


@dataclass(frozen=True)
class Split:
    """What is learned from: materials, `(K,)` bool, and the place of a method that is left out, -1 for none."""

    name: str
    materials: Tensor
    without: int = -1


@dataclass(frozen=True)
class History:
    """The iterations of one training: mean negative log-likelihood seen and held out, `(I, 2)`; weights `(I, T)`."""

    curve: Tensor
    weights: Tensor


def select_judgments(training_set: TrainingSet, own: Judgments, split: Split, *, seen: bool) -> Judgments:
    """Judgments that a split learns from, or those about nothing of what it learns from."""
    inside = split.materials[own.materials]
    if split.without < 0:
        return own.select(inside.all(1) if seen else ~inside.any(1))
    absent = (training_set.method[own.first] == split.without) | (training_set.method[own.second] == split.without)
    return own.select(inside.all(1) & ~absent if seen else ~inside.any(1) & absent)


def negative_log_likelihood(
    training_set: TrainingSet, judgments: Mapping[str, Judgments], weights: Tensor, slopes: Tensor
) -> Tensor:
    """Mean negative log-likelihood of the votes, the parts weighted by `PART_WEIGHT`.

    P(first) = Phi(slope (d_second - d_first)). slopes: logarithms, of triplets and of all else, `(2,)`. A part of which
    nothing was asked does not count.
    """
    distance = training_set.distances(weights)
    total = weights.new_zeros(())
    for part, own in judgments.items():
        if len(own):
            slope = slopes[0 if part == "triplets" else 1].exp() * PART_SLOPE[part]
            argument = (slope * (distance[own.second] - distance[own.first])).clamp(-6, 6)
            chance = LAPSE + (1 - 2 * LAPSE) * torch.special.ndtr(argument)
            likely = own.share * chance.log() + (1 - own.share) * (1 - chance).log()
            total = total - PART_WEIGHT[part] * (own.count * likely).sum() / own.count.sum()
    return total


@undisturbed()
def train(training_set: TrainingSet, split: Split, iterations: int) -> History:
    """Train weights on what a split learns from, by L-BFGS from equal weights; the rest judges.

    Weights are squares, so at least 0, and the pointwise ones have a share of `MIN_POINTWISE_SHARE` of their sum; terms
    are taken in units of their means. There is nothing random in it; early stopping is the choice of an iteration.
    """
    unit = feature_scales(training_set)
    scaled = TrainingSet(**{**vars(training_set), "features": training_set.features / unit})
    start = torch.full_like(unit, len(unit) ** -0.5)
    roots = start.clone().requires_grad_()
    share = torch.zeros_like(unit)
    share[:THETA_H_BINS] = MIN_POINTWISE_SHARE / (1 - MIN_POINTWISE_SHARE) / THETA_H_BINS
    slopes = torch.zeros(2, dtype=torch.float64, requires_grad=True, device="cpu")
    parts = [
        {name: select_judgments(training_set, own, split, seen=seen) for name, own in training_set.judgments.items()}
        for seen in (True, False)
    ]
    optimizer = torch.optim.LBFGS(
        [roots, slopes], max_iter=1, max_eval=40, history_size=20, line_search_fn="strong_wolfe"
    )

    def weighing() -> Tensor:
        return roots.square() + share * roots.square().sum()

    def closure() -> Tensor:
        optimizer.zero_grad()
        value = (
            negative_log_likelihood(scaled, parts[0], weighing(), slopes) + L2_PRIOR * (roots - start).square().sum()
        )
        value.backward()
        return value

    curve, weights = [], []
    for _ in range(iterations):
        optimizer.step(closure)
        with torch.no_grad():
            now = weighing()
            curve.append(torch.stack([negative_log_likelihood(scaled, part, now, slopes) for part in parts]))
            weights.append(now / unit)
    return History(torch.stack(curve), torch.stack(weights))


def feature_scales(training_set: TrainingSet) -> Tensor:
    """Scale of the features `(T,)`: the mean of each over the distances of two materials, else over all."""
    return training_set.features[_usual(training_set)].mean(0).clamp_min(1e-12)


def _usual(training_set: TrainingSet) -> Tensor:
    between = training_set.method < 0
    return between if bool(between.any()) else ~between


def splits(training_set: TrainingSet, repeats: int, seed: int) -> Iterator[Split]:
    """Repeated two-fold cross-validation over materials.

    In the first of them, one method after the other is left out as well.
    """
    generator = torch.Generator("cpu").manual_seed(seed)
    count = len(training_set.names)
    for repeat in range(repeats):
        chosen = torch.zeros(count, dtype=torch.bool, device="cpu")
        chosen[torch.randperm(count, generator=generator, device="cpu")[: count // 2]] = True
        for fold, own in enumerate((chosen, ~chosen)):
            yield Split(f"half-{repeat}-{fold}", own)
            if not repeat and len(training_set.methods) > 1:
                for k in range(len(training_set.methods)):
                    yield Split(f"half-{repeat}-{fold}-without-{k}", own, k)


def best_iteration(histories: list[History]) -> int:
    """Early stopping: the iteration at which held-out answers are likeliest, on average over the trainings."""
    return int(torch.stack([history.curve[:, 1] for history in histories]).mean(0).argmin())


def normalized_weights(training_set: TrainingSet, weights: Tensor) -> dict[str, Any]:
    """Finished weights by name, as `LearnedLoss` reads them, in units of the mean distance of two materials."""
    mean = training_set.distances(weights)[_usual(training_set)].mean()
    return pack_weights(weights / mean.square())


def baseline_distances(
    training_set: TrainingSet, seen: EvaluatedBrdfs, losses: Mapping[str, Loss]
) -> dict[str, Tensor]:
    """Distances of a training set by other losses, `(E,)` each."""
    between = training_set.method < 0
    found = {}
    for name, loss in losses.items():
        distance = torch.empty(len(training_set.features), dtype=torch.float64, device="cpu")
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
    """Held-out agreement: how often distances are ordered right by weights learned without their materials.

    judged: splits, and the weights `(T,)` that were learned in them; others: distances to compare with, `(E,)` each.
    `{statistic: {"learned" or other: {"share": [value, low, high], "gain": [...]}}}`: 95 % intervals from materials
    resampled with replacement, the gain on the same comparisons and materials. A comparison is judged in every split in
    which nothing of it was seen (and, where a method is left out, is of that method), and counts as their mean.
    """
    draws = resample_counts(len(training_set.names), replicates, seed)
    learned = torch.stack([training_set.distances(weights) for _, weights in judged])
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
    about = (~split.materials)[own.materials] | (own.materials < 0)
    if split.without < 0:
        return about.all(1)
    methods = training_set.method[torch.stack([own.nearer, own.farther], 1)]
    return about.all(1) & (methods == split.without).any(1)
