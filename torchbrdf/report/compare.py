"""`compare`: two or more materials or fits beside each other, in numbers, in words and on a page."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.experiment.comparison import LEAST, MOST, Compared, Source, Subject, compared, find_subjects, scenes_of
from torchbrdf.experiment.labels import difference_label, loss_label
from torchbrdf.experiment.matching.judge import Judge
from torchbrdf.files import writable
from torchbrdf.perception.discrimination.words import said
from torchbrdf.progress import Progress, quiet
from torchbrdf.render import Scene, cache_folder
from torchbrdf.report.compare_page import write_compare_page

PAGE = "compare.html"


@dataclass(frozen=True)
class Comparison:
    """Materials beside a reference.

    Args:
        reference: In its scenes.
        subject: The reference.
        others: Each beside it.
        problems: What could not be compared, a line each.
    """

    reference: Judge
    subject: Subject
    others: list[Compared]
    problems: list[str]

    def lines(self) -> list[str]:
        """All of it in words."""
        found = [f"reference: {self.subject.label}"]
        for one in self.others:
            found += ["", one.subject.label, *(f"  {line}" for line in _lines(one))]
        return found

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain values."""
        return {
            "reference": self.subject.label,
            "others": [
                {
                    "label": one.subject.label,
                    "metrics": {
                        name: {
                            "distance": value,
                            "told_apart": None if (share := one.told(name)) is None else share.value,
                        }
                        for name, value in one.metrics.items()
                    },
                    "is_same": one.is_same,
                    "pairs_measured": one.pairs[0],
                    "pairs": one.pairs[1],
                    "scenes": {name: own.to_json() for name, own in one.figures.items()},
                    "where": [{**asdict(place), "words": place.words} for place in one.places],
                }
                for one in self.others
            ],
            "problems": self.problems,
        }

    def write(self, path: Path | str) -> Path:
        """Write the page, whole or not at all; gives its path."""
        return write_compare_page(Path(path), self.reference, self.subject, self.others, self.problems)


def compare(
    *sources: Source,
    out: str | os.PathLike[str] | None = None,
    scenes: Mapping[str, Scene] | None = None,
    size: int = 128,
    bad: list[TorchbrdfError] | None = None,
    settings: Mapping[str, str] | None = None,
    progress: Progress = quiet,
) -> Comparison:
    """Compare materials or fits with the first of them: metrics, pictures, slices, and where they differ most.

    Args:
        sources: Two or more: files with measured BRDFs or fits, folders, materials, fits, lobes. A file may hold
            several.
        out: A folder for `compare.html`, a page whose slices can be moved; None writes nothing.
        scenes: That are drawn, by name; by default the blob in the grove, and a sphere in the studio.
        size: Pixels of a side of the pictures of those.
        bad: Takes what cannot be compared, so that the others are; None raises the first.
        settings: What files do not say, as of `torchbrdf.load`.
        progress: Of the materials.

    Returns:
        The comparison: `lines()`, `to_dict()`, and `write(path)` for the page.

    Raises:
        UsageError: There are fewer than two materials, or more than 128.
        DataError: A file, or the folder, cannot be used; or, without `bad`, a material cannot be compared.

    Example:
        >>> import torchbrdf
        >>> from torchbrdf.lobes import GGX
        >>> found = torchbrdf.compare(GGX(roughness=0.2), GGX(roughness=0.25), size=24)
        >>> found.others[0].metrics["rms"] > 0, len(found.others[0].figures)
        (True, 2)
    """
    folder = None if out is None else writable(Path(out))
    problems: list[TorchbrdfError] = []
    subjects = find_subjects(sources, problems, settings)
    if problems and (bad is None or len(subjects) < 2):
        if bad is None:
            raise problems[0]
    elif not 2 <= len(subjects) <= MOST:
        raise UsageError(f"compare: expected 2 to {MOST} materials or fits, found {len(subjects)}")
    if len(subjects) < 2:
        bad = [] if bad is None else bad
        bad += problems
        raise DataError(f"compare: expected at least two that can be read, found {len(subjects)}")
    first, *others = subjects
    judge = Judge(first.brdf, dict(scenes or scenes_of(size, cache_folder())))
    done: list[Compared] = []
    for k, other in enumerate(others):
        progress(k, len(others))
        try:
            done.append(compared(judge, first.label, other))
        except TorchbrdfError as error:
            if bad is None:
                raise
            problems.append(error)
    progress(len(others), len(others))
    if bad is not None:
        bad += problems
    found = Comparison(judge, first, done, [str(error) for error in problems])
    if folder is not None and done:
        found.write(folder / PAGE)
    return found


def _lines(one: Compared) -> list[str]:
    """A material beside the reference, in words."""
    known, every = one.pairs
    over = "" if known == every else f", over the {known} of {every} pairs of directions that were measured"
    few = f"metrics: none, since only {known} of {every} pairs of directions were measured of both"
    lines = [few if known < LEAST else f"metrics{over}:"]
    for name, value in one.metrics.items() if known >= LEAST else ():
        share = one.told(name)
        told = "" if share is None else f"told apart by {share.text}"
        lines.append(f"  {loss_label(name):26s} {value:<10.4g} {told}".rstrip())
    for scene, figures in one.figures.items():
        parts = [f"{difference_label(name)} {value:.2f}" for name, value in figures.differences.items()]
        words = said("delta_e76", figures.delta_e76)
        lines.append(f"picture, {scene}: {', '.join(parts)}" + (f"; {words}" if words else ""))
    if one.where:
        lines += ["where they differ most:", *(f"  {words}" for words in one.where)]
    return lines
