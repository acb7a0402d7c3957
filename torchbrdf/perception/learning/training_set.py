"""What a metric can learn from: the terms of distances, and how often people found which of two smaller."""

from collections.abc import Collection
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError
from torchbrdf.losses import LearnedLoss
from torchbrdf.perception.agreement.scores import BenchmarkData, EvaluatedBrdfs
from torchbrdf.perception.agreement.statistics import DistanceComparisons, across_materials, majorities, same_material
from torchbrdf.perception.datasets.opinions import Opinions
from torchbrdf.perception.datasets.triplets import Triplets
from torchbrdf.precision import undisturbed

# How far, beside their standard errors, mean opinions may be from what a distance can know.
UNKNOWN = 0.03
# Distances whose values are held at once.
_HELD = 64


@dataclass(frozen=True)
class Judgments:
    """Judgments of C pairs of distances, each a place among E: which share of votes found `first` smaller.

    first, second: `(C,)` long; share, count (how much each counts): `(C,)` float64; materials: the places of those it
    is about, each once, `(C, k)` long, -1 where it is about fewer.
    """

    first: Tensor
    second: Tensor
    share: Tensor
    count: Tensor
    materials: Tensor

    def __len__(self) -> int:
        return len(self.first)

    def select(self, index: Tensor) -> "Judgments":
        """Some of the judgments, by index or by mask."""
        return Judgments(*(getattr(self, one.name)[index] for one in fields(self)))


@dataclass(frozen=True)
class TrainingSet:
    """Training set: E distances, by their terms, and what people judged of them.

    names: of K materials. terms: `(E, T)` float64, what the constants of `LearnedLoss` multiply. first, second: `(E,)`,
    places in `EvaluatedBrdfs`: of the prediction, among its materials, or its approximations where `method` is at least
    0, and of the target. method: `(E,)`, places in `methods`, -1 for a distance of two materials. judgments: answers by
    part, to learn from; statistics: comparisons by name, to count how many are ordered right.
    """

    names: list[str]
    methods: list[str]
    terms: Tensor
    first: Tensor
    second: Tensor
    method: Tensor
    judgments: dict[str, Judgments]
    statistics: dict[str, DistanceComparisons]

    @property
    def usual(self) -> Tensor:
        """Which distances make the unit, `(E,)`: those of two materials, or all if there are none."""
        between = self.method < 0
        return between if bool(between.any()) else ~between


@undisturbed()
def make_training_set(data: BenchmarkData, brdfs: EvaluatedBrdfs, leave_out: Collection[str] = ()) -> TrainingSet:
    """Make a training set of triplets and opinions, without the opinions of some methods."""
    names, every = data.names, data.opinions
    kept = [row for row, method in enumerate(every.methods) if method not in leave_out]
    opinions, triplets = every.select(kept), data.triplets
    if not len(opinions) or not len(triplets):
        raise DataError("a training set: expected questions and opinions, found none")
    methods = sorted(set(opinions.methods))
    rows = torch.tensor(kept, dtype=torch.long, device="cpu")
    target = brdfs.target[rows]
    reference, a, b = triplets.questions.unbind(1)
    count = len(names)
    numbers, entry = torch.cat([_number(reference, x, count) for x in (a, b)]).unique(return_inverse=True)
    between = len(numbers)
    one, other = numbers.div(count, rounding_mode="floor"), numbers % count
    own = [methods.index(name) for name in opinions.methods]
    votes = triplets.votes.double()
    first, second = entry.split(len(triplets))
    judgments = {"triplets": Judgments(first, second, votes[:, 0] / votes.sum(1), votes.sum(1), triplets.questions)}
    counted = {"pairs": same_material(opinions), "across": across_materials(opinions)}
    judgments |= {name: _opined(opinions, part, target, between) for name, part in counted.items()}
    counted["apart"] = same_material(opinions, well_separated=True)
    return TrainingSet(
        names,
        methods,
        torch.cat([terms_of(brdfs, brdfs.materials, one, other), terms_of(brdfs, brdfs.approximations, rows, target)]),
        torch.cat([one, rows]),
        torch.cat([other, target]),
        torch.tensor([-1] * between + own, dtype=torch.long, device="cpu"),
        judgments,
        {"majority": _majorities(triplets, numbers, count)}
        | {name: _placed(part, target, between) for name, part in counted.items()},
    )


@undisturbed()
def training_set_from_choices(
    names: list[str], stimuli: list[str], brdfs: EvaluatedBrdfs, pairs: Tensor, votes: Tensor
) -> TrainingSet:
    """Training set of observers' choices: which of two approximations they found closer to a material.

    names: of the materials that `brdfs` has; stimuli: the name of each of its R approximations. pairs: places of two of
    these, `(C, 2)` long; votes: how many chose either, `(C, 2)`.
    """
    if not len(pairs):
        raise DataError("a training set: expected choices, found none")
    methods = sorted(set(stimuli))
    rows = torch.arange(len(stimuli), dtype=torch.int64, device="cpu")
    first, second = pairs.unbind(1)
    cast = votes.double()
    material = brdfs.target[first][:, None]
    swap = votes[:, 1] > votes[:, 0]
    decided = votes[:, 0] != votes[:, 1]
    near, far = torch.where(swap, second, first)[decided], torch.where(swap, first, second)[decided]
    plain = torch.ones(len(near), dtype=torch.float64, device="cpu"), torch.zeros_like(near)
    return TrainingSet(
        names,
        methods,
        terms_of(brdfs, brdfs.approximations, rows, brdfs.target),
        rows,
        brdfs.target,
        torch.tensor([methods.index(name) for name in stimuli], dtype=torch.long, device="cpu"),
        {"choices": Judgments(first, second, cast[:, 0] / cast.sum(1), cast.sum(1), material)},
        {"choices": DistanceComparisons(near, far, material[decided], *plain)},
    )


def terms_of(brdfs: EvaluatedBrdfs, values: Tensor, first: Tensor, second: Tensor) -> Tensor:
    """The terms of the distances of values `(R, n, 3)`, at these places, from materials, `(E, T)`, float64."""
    if brdfs.pairs is None:
        raise UsageError("a training set: expected values on pairs")
    loss, parts = LearnedLoss("none"), zip(first.split(_HELD), second.split(_HELD), strict=True)
    with torch.no_grad():
        return torch.cat([loss.terms(values[i], brdfs.materials[j], brdfs.pairs) for i, j in parts])


@undisturbed()
def merge_training_sets(training_sets: list[TrainingSet]) -> TrainingSet:
    """Merge training sets into one; parts of one name become one, and materials of one name are the same.

    first and second are places in each one's own `EvaluatedBrdfs`.
    """
    names = list(dict.fromkeys(name for training_set in training_sets for name in training_set.names))
    methods = list(dict.fromkeys(method for training_set in training_sets for method in training_set.methods))
    judgments: dict[str, list[Judgments]] = {}
    statistics: dict[str, list[DistanceComparisons]] = {}
    method, start = [], 0
    for training_set in training_sets:
        # One more place at the end stands for none, as -1 does.
        place = torch.tensor([*(names.index(name) for name in training_set.names), -1], dtype=torch.int64, device="cpu")
        kind = torch.tensor(
            [*(methods.index(name) for name in training_set.methods), -1], dtype=torch.int64, device="cpu"
        )
        method.append(kind[training_set.method])
        for name, part in training_set.judgments.items():
            shifted = Judgments(part.first + start, part.second + start, part.share, part.count, place[part.materials])
            judgments.setdefault(name, []).append(shifted)
        for name, own in training_set.statistics.items():
            there = DistanceComparisons(
                own.nearer + start, own.farther + start, place[own.materials], own.weight, own.group
            )
            statistics.setdefault(name, []).append(there)
        start += len(training_set.terms)
    return TrainingSet(
        names,
        methods,
        torch.cat([training_set.terms for training_set in training_sets]),
        torch.cat([training_set.first for training_set in training_sets]),
        torch.cat([training_set.second for training_set in training_sets]),
        torch.cat(method),
        {name: Judgments(*map(torch.cat, zip(*map(_values, parts), strict=True))) for name, parts in judgments.items()},
        {
            name: DistanceComparisons(*map(torch.cat, zip(*map(_values, x), strict=True)))
            for name, x in statistics.items()
        },
    )


def _values(part: Judgments | DistanceComparisons) -> list[Tensor]:
    return [getattr(part, one.name) for one in fields(part)]


def _number(one: Tensor, other: Tensor, count: int) -> Tensor:
    """One number for two materials, in either order."""
    return torch.minimum(one, other) * count + torch.maximum(one, other)


def _opined(opinions: Opinions, own: DistanceComparisons, target: Tensor, shift: int) -> Judgments:
    """Opinions as votes: how often such means would come out in this order."""
    error = opinions.standard_error
    standard_error = (error[own.nearer].square() + error[own.farther].square() + UNKNOWN**2).sqrt()
    share = torch.special.ndtr((opinions.distance[own.farther] - opinions.distance[own.nearer]) / standard_error)
    materials = _placed(own, target, shift).materials
    return Judgments(own.nearer + shift, own.farther + shift, share, torch.ones_like(share), materials)


def _placed(own: DistanceComparisons, target: Tensor, shift: int) -> DistanceComparisons:
    one, other = target[own.nearer], target[own.farther]
    materials = torch.stack([one, torch.where(one == other, -1, other)], 1)
    return DistanceComparisons(own.nearer + shift, own.farther + shift, materials, own.weight, own.group)


def _majorities(triplets: Triplets, numbers: Tensor, count: int) -> DistanceComparisons:
    own = majorities(triplets)
    near, far = (
        torch.searchsorted(numbers, _number(x.div(count, rounding_mode="floor"), x % count, count))
        for x in (own.nearer, own.farther)
    )
    return DistanceComparisons(near, far, own.materials, own.weight, own.group)
