"""Trials of an observer: which pairs, in which order, and what stands on the left."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from torchbrdf.study.answers import Kind
from torchbrdf.study.plan import Experiment, Plan, catch_pair

Pair = tuple[str, str]


@dataclass(frozen=True)
class Trial:
    """Trial of a study: what is shown, the material's reference above, and two stimuli below."""

    material: str
    left: str
    right: str
    kind: Kind = "trial"


def observer_seed(plan: Plan, index: int) -> int:
    """The seed of the order of observer number `index`."""
    return plan.seed * 100_003 + index


def trials(plan: Plan, experiment: Experiment, index: int) -> list[Trial]:
    """Trials of an observer, in the order in which they are shown; the same whenever it is asked for.

    All pairs of all materials in one random order. Every stimulus stands on the left as often as on the right, give or
    take one, and what one observer sees on the left, the next one sees on the right. With `compare`, two such
    observers share one choice of pairs, the next two have another, and each can be scaled alone. A repeat comes at
    least a quarter of all trials after the trial that it repeats, where that is possible.

    Args:
        plan: The study.
        experiment: One of its experiments.
        index: The observer's number, from 0.

    Example:
        >>> from torchbrdf.study import Experiment, Material, Plan, Stimulus
        >>> names = ("ward", "cook", "abc")
        >>> nickel = Material("nickel", "nickel.png", {name: Stimulus(f"{name}.png") for name in names})
        >>> gloss = Experiment("gloss", "Which is closer?", names)
        >>> len(trials(Plan((nickel,), (gloss,)), gloss, 0))
        3
    """
    couple = random.Random(f"{plan.seed}/{experiment.name}/{index // 2}")
    own = random.Random(observer_seed(plan, index))
    shown = []
    for material in plan.materials:
        pairs = chosen_pairs(experiment, couple)
        shown += [Trial(material.name, left, right) for left, right in oriented(pairs, couple)]
    if index % 2:
        shown = [mirrored(trial) for trial in shown]
    own.shuffle(shown)
    shown = _with_repeats(shown, experiment.repeats, own)
    for material in own.choices(plan.materials, k=experiment.catch):
        pair = catch_pair(material, experiment)
        if pair is not None:  # a plan makes sure of it
            left, right = own.sample(pair, 2)
            shown.insert(own.randint(0, len(shown)), Trial(material.name, left, right, "catch"))
    return shown


def mirrored(trial: Trial) -> Trial:
    """A trial with its sides changed."""
    return replace(trial, left=trial.right, right=trial.left)


def chosen_pairs(experiment: Experiment, source: random.Random) -> list[Pair]:
    """The pairs of an experiment; with `compare`, a random choice in which each stimulus meets so many others."""
    if experiment.pairs is not None:
        return list(experiment.pairs)
    if experiment.compare is None:
        return list(combinations(experiment.stimuli, 2))
    ring = source.sample(experiment.stimuli, len(experiment.stimuli))
    return circulant_pairs(ring, experiment.compare)


def circulant_pairs(ring: Sequence[str], compare: int) -> list[Pair]:
    """Pairs of a circulant graph: neighbours on a ring, then second neighbours, ..., until each meets `compare` others.

    Connected, because neighbours are among them. If the ring and `compare` are odd, one meets one more.
    """
    count = len(ring)
    places = [(k, (k + step) % count) for step in range(1, compare // 2 + 1) for k in range(count)]
    if compare % 2:  # those opposite each other
        places += [(k, (k + count // 2) % count) for k in range((count + 1) // 2)]
    return [(ring[a], ring[b]) for a, b in dict.fromkeys((min(pair), max(pair)) for pair in places)]


def oriented(pairs: Sequence[Pair], source: random.Random) -> list[Pair]:
    """The pairs, each left and right, so that every name is on the left as often as on the right, give or take one.

    An Eulerian orientation: names that are in an odd number of pairs are joined with one that stands for nobody, then
    each closed walk through pairs not yet used leads from left to right.
    """
    joined: dict[str | None, list[str | None]] = {None: []}
    for pair in source.sample(pairs, len(pairs)):
        a, b = source.sample(pair, 2)
        joined.setdefault(a, []).append(b)
        joined.setdefault(b, []).append(a)
    for name, others in joined.items():
        if name is not None and len(others) % 2:
            others.append(None)
            joined[None].append(name)
    found = []
    for start in joined:
        here = start
        while joined[here]:
            there = joined[here].pop()
            joined[there].remove(here)
            if here is not None and there is not None:
                found.append((here, there))
            here = there
    return found


def _with_repeats(shown: list[Trial], repeats: int, source: random.Random) -> list[Trial]:
    """Some trials once more, sides changed, and not soon."""
    apart = len(shown) // 4
    again = source.sample(range(len(shown)), min(repeats, len(shown)))
    placed = [(place, trial) for place, trial in enumerate(shown)]
    late = [(source.uniform(min(k + apart, len(shown)), len(shown)), k) for k in again]
    placed += [(place, replace(mirrored(shown[k]), kind="repeat")) for place, k in late]  # type: ignore[misc]
    return [trial for _, trial in sorted(placed, key=lambda both: both[0])]
