"""Learn the weights of `LearnedLoss` from answers: likelihood, early stopping, cross-validation."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchbrdf.losses.base import Loss
from torchbrdf.losses.learned import ROWS, pack_weights
from torchbrdf.perception.agreement.scores import Seen, distances
from torchbrdf.perception.agreement.statistics import Comparisons, interval, resample
from torchbrdf.perception.learning.training_set import Asked, Lesson

# What the mean likelihood of each part of the answers counts.
SHARE = {"triplets": 1.0, "pairs": 1.0, "across": 0.5, "choices": 1.0}
# The slope of the probit of each part at the start, on a scale where distances are 1.
SLOPE = {"triplets": 3.0, "pairs": 6.0, "across": 6.0, "choices": 6.0}
# How often people answer at random; keeps one answer from counting without limit.
LAPSE = 0.02
# The least share of pointwise terms in all weights: what people were asked about has hardly any spikes, and averages
# alone would let a fit hide them in a bin.
LEAST = 0.1
# What it costs roots of weights to leave the start, where all are equal.
PULL = 0.03


@dataclass(frozen=True)
class Split:
    """What is learned from: materials, `(K,)` bool, and the place of a method that is left out, -1 for none."""

    name: str
    materials: Tensor
    without: int = -1


@dataclass(frozen=True)
class Course:
    """The iterations of one training: mean negative log-likelihood seen and held out, `(I, 2)`; weights `(I, T)`."""

    curve: Tensor
    weights: Tensor


def within(lesson: Lesson, own: Asked, split: Split, *, seen: bool) -> Asked:
    """The answers that a split learns from, or those about nothing of what it learns from."""
    inside = split.materials[own.materials]
    if split.without < 0:
        return own.select(inside.all(1) if seen else ~inside.any(1))
    absent = (lesson.method[own.first] == split.without) | (lesson.method[own.second] == split.without)
    return own.select(inside.all(1) & ~absent if seen else ~inside.any(1) & absent)


def mismatch(lesson: Lesson, asked: Mapping[str, Asked], weights: Tensor, slopes: Tensor) -> Tensor:
    """Mean negative log-likelihood of the votes, the parts by `SHARE`: P(first) = Phi(slope (d_second - d_first)).

    slopes: logarithms, of triplets and of all else, `(2,)`. A part of which nothing was asked does not count.
    """
    distance = lesson.distances(weights)
    total = weights.new_zeros(())
    for part, own in asked.items():
        if len(own):
            slope = slopes[0 if part == "triplets" else 1].exp() * SLOPE[part]
            argument = (slope * (distance[own.second] - distance[own.first])).clamp(-6, 6)
            chance = LAPSE + (1 - 2 * LAPSE) * torch.special.ndtr(argument)
            likely = own.share * chance.log() + (1 - own.share) * (1 - chance).log()
            total = total - SHARE[part] * (own.count * likely).sum() / own.count.sum()
    return total


def train(lesson: Lesson, split: Split, iterations: int) -> Course:
    """L-BFGS from equal weights on what a split learns from; the rest judges.

    Weights are squares, so at least 0, and the pointwise ones have a share of `LEAST` of their sum; terms are taken in
    units of their means. There is nothing random in it; early stopping is the choice of an iteration.
    """
    unit = units(lesson)
    scaled = Lesson(**{**vars(lesson), "terms": lesson.terms / unit})
    start = torch.full_like(unit, len(unit) ** -0.5)
    roots = start.clone().requires_grad_()
    share = torch.zeros_like(unit)
    share[:ROWS] = LEAST / (1 - LEAST) / ROWS
    slopes = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    parts = [
        {name: within(lesson, own, split, seen=seen) for name, own in lesson.asked.items()} for seen in (True, False)
    ]
    optimizer = torch.optim.LBFGS(
        [roots, slopes], max_iter=1, max_eval=40, history_size=20, line_search_fn="strong_wolfe"
    )

    def weighing() -> Tensor:
        return roots.square() + share * roots.square().sum()

    def closure() -> Tensor:
        optimizer.zero_grad()
        value = mismatch(scaled, parts[0], weighing(), slopes) + PULL * (roots - start).square().sum()
        value.backward()
        return value

    curve, weights = [], []
    for _ in range(iterations):
        optimizer.step(closure)
        with torch.no_grad():
            now = weighing()
            curve.append(torch.stack([mismatch(scaled, part, now, slopes) for part in parts]))
            weights.append(now / unit)
    return Course(torch.stack(curve), torch.stack(weights))


def units(lesson: Lesson) -> Tensor:
    """The mean of each term over the distances of two materials, or over all if there are none, `(T,)`."""
    return lesson.terms[_usual(lesson)].mean(0).clamp_min(1e-12)


def _usual(lesson: Lesson) -> Tensor:
    between = lesson.method < 0
    return between if bool(between.any()) else ~between


def splits(lesson: Lesson, repeats: int, seed: int) -> Iterator[Split]:
    """Repeated two-fold cross-validation over materials; and in the first of them, one method after the other left out
    as well."""
    generator = torch.Generator().manual_seed(seed)
    count = len(lesson.names)
    for repeat in range(repeats):
        chosen = torch.zeros(count, dtype=torch.bool)
        chosen[torch.randperm(count, generator=generator)[: count // 2]] = True
        for fold, own in enumerate((chosen, ~chosen)):
            yield Split(f"half-{repeat}-{fold}", own)
            if not repeat and len(lesson.methods) > 1:
                for k in range(len(lesson.methods)):
                    yield Split(f"half-{repeat}-{fold}-without-{k}", own, k)


def best_iteration(courses: list[Course]) -> int:
    """The iteration at which held-out answers are likeliest, on average over the trainings."""
    return int(torch.stack([course.curve[:, 1] for course in courses]).mean(0).argmin())


def finished(lesson: Lesson, weights: Tensor) -> dict[str, Any]:
    """Weights by name, as `LearnedLoss` reads them, in units of the mean distance of two materials."""
    mean = lesson.distances(weights)[_usual(lesson)].mean()
    return pack_weights(weights / mean.square())


def formulas(lesson: Lesson, seen: Seen, losses: Mapping[str, Loss]) -> dict[str, Tensor]:
    """What other losses give for the distances of a lesson, `(E,)` each."""
    between = lesson.method < 0
    found = {}
    for name, loss in losses.items():
        distance = torch.empty(len(lesson.terms), dtype=torch.float64)
        for own, values in ((between, seen.materials), (~between, seen.approximations)):
            place = lesson.first[own], lesson.second[own]
            distance[own] = distances(loss, values, seen.materials, seen.pairs, *place)
        found[name] = distance
    return found


# Of a statistic and a metric: its share of comparisons ordered right, and how much more the learned one has; each with
# the ends of its 95 % interval.
HeldOut = dict[str, dict[str, dict[str, list[float]]]]


def held_out(
    lesson: Lesson,
    judged: list[tuple[Split, Tensor]],
    others: Mapping[str, Tensor],
    seed: int = 0,
    replicates: int = 1000,
) -> HeldOut:
    """How often distances are ordered as people order them, by weights learned without any of their materials.

    judged: splits, and the weights `(T,)` that were learned in them; others: distances to compare with, `(E,)` each.
    `{statistic: {"learned" or other: {"share": [value, low, high], "gain": [...]}}}`: 95 % intervals from materials
    resampled with replacement, the gain on the same comparisons and materials. A comparison is judged in every split in
    which nothing of it was seen (and, where a method is left out, is of that method), and counts as their mean.
    """
    draws = resample(len(lesson.names), replicates, seed)
    learned = torch.stack([lesson.distances(weights) for _, weights in judged])
    found: HeldOut = {}
    for statistic, own in lesson.statistics.items():
        unseen = torch.stack([_unseen(lesson, own, split) for split, _ in judged]).double()
        tested = (unseen.sum(0) > 0).nonzero()[:, 0]
        if not len(tested):
            continue
        mine = (own.right(learned) * unseen).sum(0)[tested] / unseen.sum(0)[tested]
        part = Comparisons(
            own.nearer[tested],
            own.farther[tested],
            own.materials[tested],
            own.weight[tested],
            own.group[tested].unique(return_inverse=True)[1],
        )
        rows = torch.cat([mine[None], part.right(torch.stack(list(others.values())))] if others else [mine[None]])
        share, spread = part.share(rows), part.share(rows, draws)
        ends, gains = interval(spread), interval(spread[:, :1] - spread)
        found[statistic] = {
            name: {
                "share": [float(share[k]), *ends[k].tolist()],
                "gain": [float(share[0] - share[k]), *gains[k].tolist()],
            }
            for k, name in enumerate(["learned", *others])
        }
    return found


def _unseen(lesson: Lesson, own: Comparisons, split: Split) -> Tensor:
    about = (~split.materials)[own.materials] | (own.materials < 0)
    if split.without < 0:
        return about.all(1)
    methods = lesson.method[torch.stack([own.nearer, own.farther], 1)]
    return about.all(1) & (methods == split.without).any(1)
