"""Fit every candidate, judge the fits, and choose: for each material the simplest model that looks like it."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.experiment.matching.candidates import AND, PICTURES, Budget, Candidate, candidates_for
from torchbrdf.experiment.matching.judge import Figures, Judge, Means
from torchbrdf.experiment.matching.training import MAX_THETA, find_loss, seen_by, training_loss
from torchbrdf.fitting import Batches
from torchbrdf.fitting.known import KnownMaterials
from torchbrdf.lobes import FitRecord
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured
from torchbrdf.measured.scattered import NEIGHBOURS
from torchbrdf.measured.tables import measured_up_to
from torchbrdf.parallel import thread_map
from torchbrdf.progress import Progress, part_of, quiet
from torchbrdf.render import Scene, unseen_scenes

# Two pictures are taken for alike where so many observers, or fewer, would know in any scene which is the fit.
CANNOT_BE_TOLD = 0.1
# A simpler model is taken for as good as the best with so much more Delta E.
AS_GOOD = 1.05


@dataclass(frozen=True)
class Tried:
    """A fit of a candidate, and how its pictures are judged.

    Args:
        candidate: The model.
        record: The fit.
        figures: By scene.
    """

    candidate: Candidate
    record: FitRecord
    figures: Mapping[str, Figures]

    @property
    def means(self) -> Means:
        """Figures of all scenes as one."""
        return Means.of(self.figures)

    @property
    def cannot_be_told(self) -> bool:
        """Whether its pictures cannot be told from the measurement's, in any scene."""
        return all(one.told.value <= CANNOT_BE_TOLD for one in self.figures.values())


@dataclass
class Match:
    """The match of one material.

    Args:
        material: Its name.
        judge: Its pictures.
        tried: All fits, simplest first.
        reach: How far from the normal it is measured, in degrees.
        untried: Kinds of models that the budget had no time for.
    """

    material: str
    judge: Judge
    tried: list[Tried] = field(default_factory=list)
    reach: float = 90.0
    untried: int = 0

    @property
    def settled(self) -> bool:
        """Whether a fit cannot be told from the measurement."""
        return any(one.cannot_be_told for one in self.tried)

    @property
    def ranked(self) -> list[Tried]:
        """All fits, what is to be taken first: see `ranked`."""
        return ranked(self.tried)

    @property
    def chosen(self) -> Tried:
        """The match.

        Raises:
            DataError: No fit came to an end.
        """
        if not self.tried:
            raise DataError(f"{self.material}: expected a fit that comes to an end, found none")
        return self.ranked[0]

    @property
    def seconds(self) -> float:
        """Of all fits."""
        return sum(one.record.seconds for one in self.tried)


def ranked(tried: Sequence[Tried]) -> list[Tried]:
    """Fits, what is to be taken first.

    The simplest model that cannot be told from the measurement, or, where there is none, the simplest whose Delta E is
    at most 5 % above the least; of fits of one model the nearest. Then the others, nearest first.

    Args:
        tried: Of one material, simplest first.
    """
    if not tried:
        return []
    least = min(one.means.mean for one in tried)
    good = [one for one in tried if one.cannot_be_told] or [one for one in tried if one.means.mean <= AS_GOOD * least]
    first = min(
        (one for one in good if one.candidate == good[0].candidate),
        key=lambda one: one.means.mean,
    )
    return [first, *sorted((one for one in tried if one is not first), key=lambda one: one.means.mean)]


def find_matches(
    groups: Sequence[Measured],
    target: str,
    budget: Budget,
    *,
    out: Path | None = None,
    scenes: Mapping[str, Scene] | None = None,
    cache: Path | None = None,
    progress: Progress = quiet,
    bad: list[TorchbrdfError] | None = None,
) -> list[Match]:
    """Fit and judge every candidate that a target can show.

    Args:
        groups: Materials, each with a name of its own.
        target: The registered name of an exporter.
        budget: How much is tried.
        out: A folder for the fits, which are not made again; None keeps none.
        scenes: That judge; by default those of `unseen_scenes`.
        cache: A folder for transports.
        progress: Of the fits.
        bad: Gets what cannot be matched; without it that is raised.

    Returns:
        The matches, in the order of the materials.

    Raises:
        UsageError: There is no material, or no scene.
        DataError: The folder cannot be used; or, without `bad`, a material cannot be matched.
    """
    began = time.perf_counter()
    if scenes is not None and not scenes:
        raise UsageError("match: scenes: expected at least one, found none")
    candidates = candidates_for(target, budget)
    scenes = unseen_scenes(cache=cache) if scenes is None else scenes
    entries = _entries(groups, scenes, bad, out)
    pictures = training_loss(budget.size, budget.views, cache)
    total, done = len(entries) * sum(len(one.losses(budget)) for one in candidates), 0
    for number, candidate in enumerate(candidates):
        left = [entry for entry in entries if budget.all_of_them or not entry.match.settled]
        if number and time.perf_counter() - began > budget.seconds:
            for entry in left:
                entry.match.untried = len(candidates) - number
            break
        for name in candidate.losses(budget):
            place = None if out is None else out / f"{candidate.stem}-{name}{_tag(name, budget)}"
            own = part_of(progress, done + len(entries) - len(left), total)
            _try(candidate, find_loss(name, pictures), place, left, own)
            done += len(entries)
    if total:
        progress(total, total)
    found = []
    for entry in entries:
        if entry.match.tried:
            found.append(entry.match)
        else:
            _say(bad, DataError(f"{entry.match.material}: no fit came to an end: {entry.reason or 'none was begun'}"))
    return found


def _path(one: Measured) -> str:
    """The file of a material, if it has one."""
    paths = one.source.paths
    return str(paths[one.materials[0]]) if one.materials[0] < len(paths) else ""


@dataclass
class _Entry:
    """A material on its way: where it is, and what was found."""

    group: int
    row: int
    measured: Measured
    match: Match
    reason: str = ""


def _tag(loss: str, budget: Budget) -> str:
    """What tells apart the fits to pictures of different budgets."""
    return f"-{budget.size}-{budget.views}" if PICTURES in loss.split(AND) else ""


def _entries(
    groups: Sequence[Measured], scenes: Mapping[str, Scene], bad: list[TorchbrdfError] | None, out: Path | None
) -> list[_Entry]:
    """The materials, each with the pictures that judge its fits; what has none is said."""
    if not any(map(len, groups)):
        raise UsageError("match: expected at least one material, found none")
    known, taken = KnownMaterials(out), dict[str, object]()
    found = []
    for number, group in enumerate(groups):
        for row in range(len(group)):
            one = group.batch([row])
            name = group.names[row]
            try:
                if name in taken:
                    both = f"{taken[name]} and {_path(one) or 'another'}"
                    raise DataError(f"{name}: comes twice, in {both}; give each file a name of its own")
                taken[name] = _path(one) or "one measurement"
                one.check_rgb("match")
                if one.is_scattered and (count := int((one.weight > 0).sum())) < NEIGHBOURS:
                    raise DataError(f"{name}: expected {NEIGHBOURS} valid samples or more, found {count}")
                # Views of their own, as each keeps all of its pairs.
                known.check(name, one.batch())
                match = Match(name, Judge(one, scenes), reach=measured_up_to(one.batch()).both)
            except TorchbrdfError as error:
                _say(bad, error if str(error).startswith(name) else DataError(f"{name}: {error}"))
                continue
            found.append(_Entry(number, row, group, match))
    if found:
        known.save()
    return found


def _say(bad: list[TorchbrdfError] | None, error: TorchbrdfError) -> None:
    if bad is None:
        raise error
    bad.append(error)


def _try(candidate: Candidate, loss: Loss, place: Path | None, entries: list[_Entry], progress: Progress) -> None:
    """Fit a candidate to the materials that are left, and judge the fits."""
    groups: dict[int, list[_Entry]] = {}
    for entry in entries:
        groups.setdefault(entry.group, []).append(entry)
    parts = [own[0].measured.batch([one.row for one in own]) for own in groups.values()]
    if not parts:
        return
    parts = [seen_by(loss, part) for part in parts]
    batches = Batches(candidate.make(), loss, out=place, diffuse="fit", max_theta=MAX_THETA)
    records = batches.run(parts, progress)
    judged = list(zip([one for own in groups.values() for one in own], records, strict=True))
    for (entry, record), figures in zip(judged, thread_map(_judge, judged), strict=True):
        if record.error < math.inf and all(one.delta_e76 < math.inf for one in figures.values()):
            entry.match.tried.append(Tried(candidate, record, figures))
        else:
            entry.reason = record.reason or record.status


def _judge(one: tuple[_Entry, FitRecord]) -> Mapping[str, Figures]:
    """How far the pictures of a fit are from those of its material."""
    entry, record = one
    return entry.match.judge.figures(record)


def to_json(one: Tried, chosen: bool) -> dict[str, Any]:
    """A candidate that was tried, as `match.json` has it."""
    means = one.means
    return {
        "model": one.record.model,
        "lobes": one.record.lobes,
        "label": one.candidate.label,
        "loss": one.record.loss,
        "strategy": one.record.strategy,
        "status": one.record.status,
        "seconds": one.record.seconds,
        "delta_e76": {"mean": means.mean, "low": means.low, "high": means.high},
        "told_apart": means.told.value,
        "chosen": chosen,
        "scenes": {name: own.to_json() for name, own in one.figures.items()},
        "parameters": one.record.parameters,
    }
