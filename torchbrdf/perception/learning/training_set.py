"""What a metric can learn from: the terms of distances, and how often people found which of two smaller."""

from collections.abc import Collection
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError
from torchbrdf.losses.learned import encode, features, soft_bins
from torchbrdf.perception.agreement.scores import Seen, Subjects
from torchbrdf.perception.agreement.statistics import Comparisons, across_materials, majorities, same_material
from torchbrdf.perception.datasets.opinions import Opinions
from torchbrdf.perception.datasets.triplets import Triplets

# How far, beside their standard errors, mean opinions may be from what a distance can know.
UNKNOWN = 0.03
# Distances whose values are held at once.
_HELD = 64


@dataclass(frozen=True)
class Asked:
    """C comparisons of two distances, each a place among E: which share of votes found `first` smaller.

    first, second: `(C,)` long; share, count (how much each counts): `(C,)` float64; materials: the places of those it
    is about, `(C, k)` long.
    """

    first: Tensor
    second: Tensor
    share: Tensor
    count: Tensor
    materials: Tensor

    def __len__(self) -> int:
        return len(self.first)

    def select(self, keep: Tensor) -> "Asked":
        """Some of them."""
        return Asked(*(getattr(self, one.name)[keep] for one in fields(self)))


@dataclass(frozen=True)
class Lesson:
    """E distances, by their terms, and what people were asked of them.

    names: of K materials. terms: `(E, T)`, what the weights of `LearnedLoss` multiply. first, second: `(E,)`, places in
    `Seen`: of the prediction, among its materials, or its approximations where `method` is at least 0, and of the
    target. method: `(E,)`, places in `methods`, -1 for a distance of two materials. asked: answers by part, to learn
    from; statistics: comparisons by name, to count how many are ordered right.
    """

    names: list[str]
    methods: list[str]
    terms: Tensor
    first: Tensor
    second: Tensor
    method: Tensor
    asked: dict[str, Asked]
    statistics: dict[str, Comparisons]

    def distances(self, weights: Tensor) -> Tensor:
        """sqrt(terms . weights), `(E,)`; 1e-12 keeps the slope finite."""
        return (self.terms @ weights + 1e-12).sqrt()


def lesson_of(subjects: Subjects, seen: Seen, leave_out: Collection[str] = ()) -> Lesson:
    """Triplets and opinions, without the opinions of some methods."""
    names, every = subjects.names, subjects.opinions
    kept = [row for row, method in enumerate(every.methods) if method not in leave_out]
    opinions, triplets = every.select(kept), subjects.triplets
    if not len(opinions) or not len(triplets):
        raise DataError("a lesson: expected questions and opinions, found none")
    methods = sorted(set(opinions.methods))
    rows = torch.tensor(kept, dtype=torch.long)
    target = seen.target[rows]
    reference, a, b = triplets.questions.unbind(1)
    count = len(names)
    numbers, entry = torch.cat([_number(reference, x, count) for x in (a, b)]).unique(return_inverse=True)
    between = len(numbers)
    one, other = numbers.div(count, rounding_mode="floor"), numbers % count
    own = [methods.index(name) for name in opinions.methods]
    votes = triplets.votes.double()
    first, second = entry.split(len(triplets))
    asked = {"triplets": Asked(first, second, votes[:, 0] / votes.sum(1), votes.sum(1), triplets.questions)}
    counted = {"pairs": same_material(opinions), "across": across_materials(opinions)}
    asked |= {name: _opined(opinions, part, target, between) for name, part in counted.items()}
    counted["apart"] = same_material(opinions, apart=True)
    return Lesson(
        names,
        methods,
        torch.cat([terms_of(seen, seen.materials, one, other), terms_of(seen, seen.approximations, rows, target)]),
        torch.cat([one, rows]),
        torch.cat([other, target]),
        torch.tensor([-1] * between + own, dtype=torch.long),
        asked,
        {"majority": _majorities(triplets, numbers, count)}
        | {name: _placed(part, target, between) for name, part in counted.items()},
    )


def lesson_of_choices(names: list[str], stimuli: list[str], seen: Seen, pairs: Tensor, votes: Tensor) -> Lesson:
    """Which of two approximations of a material observers found closer to it.

    names: of the materials that `seen` has; stimuli: the name of each of its R approximations. pairs: places of two of
    these, `(C, 2)` long; votes: how many chose either, `(C, 2)`.
    """
    if not len(pairs):
        raise DataError("a lesson: expected choices, found none")
    methods = sorted(set(stimuli))
    rows = torch.arange(len(stimuli))
    first, second = pairs.unbind(1)
    cast = votes.double()
    material = seen.target[first][:, None]
    swap = votes[:, 1] > votes[:, 0]
    decided = votes[:, 0] != votes[:, 1]
    near, far = torch.where(swap, second, first)[decided], torch.where(swap, first, second)[decided]
    plain = torch.ones(len(near), dtype=torch.float64), torch.zeros_like(near)
    return Lesson(
        names,
        methods,
        terms_of(seen, seen.approximations, rows, seen.target),
        rows,
        seen.target,
        torch.tensor([methods.index(name) for name in stimuli], dtype=torch.long),
        {"choices": Asked(first, second, cast[:, 0] / cast.sum(1), cast.sum(1), material)},
        {"choices": Comparisons(near, far, material[decided], *plain)},
    )


def terms_of(seen: Seen, values: Tensor, first: Tensor, second: Tensor) -> Tensor:
    """The terms of the distances of values `(R, n, 3)`, at these places, from materials, `(E, T)`, float64."""
    if seen.pairs is None:
        raise UsageError("a lesson: expected values on pairs")
    one, other = encode(values, seen.pairs), encode(seen.materials, seen.pairs)
    bins = soft_bins(seen.pairs).to(one)
    parts = zip(first.split(_HELD), second.split(_HELD), strict=True)
    found = [features(one[i] - other[j], bins).double() for i, j in parts]
    return torch.cat(found)


def joined(lessons: list[Lesson]) -> Lesson:
    """All of several lessons as one to learn from; parts of one name become one. Materials of one name are the same.

    first and second are places in each lesson's own `Seen`.
    """
    names = list(dict.fromkeys(name for lesson in lessons for name in lesson.names))
    methods = list(dict.fromkeys(method for lesson in lessons for method in lesson.methods))
    asked: dict[str, list[Asked]] = {}
    statistics: dict[str, list[Comparisons]] = {}
    method, start = [], 0
    for lesson in lessons:
        # One more place at the end stands for none, as -1 does.
        place = torch.tensor([*(names.index(name) for name in lesson.names), -1])
        kind = torch.tensor([*(methods.index(name) for name in lesson.methods), -1])
        method.append(kind[lesson.method])
        for name, part in lesson.asked.items():
            moved = Asked(part.first + start, part.second + start, part.share, part.count, place[part.materials])
            asked.setdefault(name, []).append(moved)
        for name, own in lesson.statistics.items():
            there = Comparisons(own.nearer + start, own.farther + start, place[own.materials], own.weight, own.group)
            statistics.setdefault(name, []).append(there)
        start += len(lesson.terms)
    return Lesson(
        names,
        methods,
        torch.cat([lesson.terms for lesson in lessons]),
        torch.cat([lesson.first for lesson in lessons]),
        torch.cat([lesson.second for lesson in lessons]),
        torch.cat(method),
        {name: Asked(*map(torch.cat, zip(*map(_values, parts), strict=True))) for name, parts in asked.items()},
        {name: Comparisons(*map(torch.cat, zip(*map(_values, x), strict=True))) for name, x in statistics.items()},
    )


def _values(part: Asked | Comparisons) -> list[Tensor]:
    return [getattr(part, one.name) for one in fields(part)]


def _number(one: Tensor, other: Tensor, count: int) -> Tensor:
    """One number for two materials, in either order."""
    return torch.minimum(one, other) * count + torch.maximum(one, other)


def _opined(opinions: Opinions, own: Comparisons, target: Tensor, shift: int) -> Asked:
    """Opinions as votes: how often such means would come out in this order."""
    error = opinions.standard_error
    spread = (error[own.nearer].square() + error[own.farther].square() + UNKNOWN**2).sqrt()
    share = torch.special.ndtr((opinions.distance[own.farther] - opinions.distance[own.nearer]) / spread)
    materials = torch.stack([target[own.nearer], target[own.farther]], 1)
    return Asked(own.nearer + shift, own.farther + shift, share, torch.ones_like(share), materials)


def _placed(own: Comparisons, target: Tensor, shift: int) -> Comparisons:
    one, other = target[own.nearer], target[own.farther]
    materials = torch.stack([one, torch.where(one == other, -1, other)], 1)
    return Comparisons(own.nearer + shift, own.farther + shift, materials, own.weight, own.group)


def _majorities(triplets: Triplets, numbers: Tensor, count: int) -> Comparisons:
    own = majorities(triplets)
    near, far = (
        torch.searchsorted(numbers, _number(x.div(count, rounding_mode="floor"), x % count, count))
        for x in (own.nearer, own.farther)
    )
    return Comparisons(near, far, own.materials, own.weight, own.group)
