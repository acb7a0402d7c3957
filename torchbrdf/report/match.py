"""`match`: from measured files to materials of a renderer, with a page that shows how near they are."""

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import torch

from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.experiment.matching import Budget, Match, Tried, find_budget, find_matches
from torchbrdf.experiment.matching.judge import ALSO, DECIDES, Brdf
from torchbrdf.experiment.matching.search import to_json
from torchbrdf.experiment.matching.shortfall import angles, in_words, parts
from torchbrdf.export import EXPORTERS, Exported
from torchbrdf.export.api import find_exporter, material_of, write
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import FitRecord, Lobe, model_of
from torchbrdf.measured import Measured, check, load_all
from torchbrdf.parallel import thread_map
from torchbrdf.progress import Progress, quiet
from torchbrdf.render import Scene, cache_folder
from torchbrdf.report.match_folder import FITS, LIST, PAGE, add, prepared, read_entries, stems
from torchbrdf.report.match_page import Finished, block_of

__all__ = ["FITS", "LIST", "PAGE", "match"]

JOD = "jod"

Source = Measured | str | os.PathLike[str]


def match(
    source: Source | Sequence[Source],
    target: str = "mitsuba",
    out: str | os.PathLike[str] | None = None,
    *,
    budget: str | Budget = "default",
    scenes: dict[str, Scene] | None = None,
    progress: Progress = quiet,
    bad: list[TorchbrdfError] | None = None,
    settings: Mapping[str, str] | None = None,
) -> list[Finished]:
    """Find the simplest model that looks like each material, and write it for a renderer.

    Candidates that the target can show are fitted under the perceptual metric and to pictures, and judged in three
    scenes that no fit saw. The simplest whose pictures cannot be told from the measurement's is the match; where there
    is none, the simplest that is as good as the best.

    Args:
        source: Measured materials, or paths of files or folders; or several of those.
        target: For what: a registered exporter, such as "mitsuba" or "gltf".
        out: A folder for the materials, `match.html` and `match.json`; fits are kept in `fits/` there and not made
            again. None writes nothing.
        budget: "quick", "default", "thorough", or so many seconds; or a `Budget`.
        scenes: That judge, by name; by default those of `torchbrdf.render.unseen_scenes`.
        progress: Of the fits.
        bad: Gets what cannot be matched, so that the others are; without it that is raised.
        settings: What files do not say, as of `torchbrdf.load`.

    Returns:
        A finished match a material; its `sentence` says how near it is.

    Raises:
        UsageError: There is no such target or budget, or no material.
        DataError: A file or the folder cannot be used; or, without `bad`, a material cannot be matched.

    Example:
        >>> import torchbrdf
        >>> from torchbrdf.measured import load, standins
        >>> nickel = load(standins()).batch([6])
        >>> (found,) = torchbrdf.match(nickel, budget="quick")  # doctest: +SKIP
        >>> print(found.sentence)  # doctest: +SKIP
        nickel as one GGX lobe: Delta E 0.9 (0.7 to 1.1 over three scenes); about 12 % of observers would ...
    """
    EXPORTERS.check(target)
    budget = find_budget(budget) if isinstance(budget, str) else budget
    with nullcontext() if out is None else prepared(Path(out)) as folder:
        if folder is not None:
            read_entries(folder)  # a list that is none is said before the work
        groups = _groups(source, bad, settings)
        if not groups:  # all are bad, which is said
            return []
        fits = None if folder is None else folder / FITS
        matches = find_matches(
            groups, target, budget, out=fits, scenes=scenes, cache=cache_folder(), progress=progress, bad=bad
        )
        return _finish_all(matches, target, folder, bad)


def _finish_all(
    matches: list[Match], target: str, folder: Path | None, bad: list[TorchbrdfError] | None
) -> list[Finished]:
    """Write all matches, and the list and the page of the folder."""
    names = [one.material for one in matches]
    own = names if folder is None else stems(folder, names)
    unwritten: list[TorchbrdfError] = []
    finished = [*thread_map(lambda one: _finish(*one, target, folder, unwritten), list(zip(matches, own, strict=True)))]
    if bad is not None:
        bad += unwritten
    if folder is not None and finished:  # what an earlier match left stays where this one finds nothing
        entries = [entry(one, target) for one in finished]
        blocks = [*thread_map(partial(block_of, target=target), finished)]
        add(folder, entries, blocks, [str(error) for error in bad or []])
    if unwritten and bad is None:
        raise unwritten[0]
    return finished


def entry(one: Finished, target: str) -> dict[str, Any]:
    """What `match.json` has of a material."""
    means, record = one.means, one.chosen.record
    return {
        "material": one.match.material,
        "target": target,
        "model": record.model,
        "lobes": record.lobes,
        "parameters": record.parameters,
        "read_from": record.reading,
        "loss": record.loss,
        "strategy": record.strategy,
        "label": one.chosen.candidate.label,
        "sentence": one.sentence,
        "cannot_be_told": one.chosen.cannot_be_told,
        "delta_e76": {"mean": means.mean, "low": means.low, "high": means.high},
        "told_apart": asdict(means.told),
        "scenes": {name: own.to_json() for name, own in one.figures.items()},
        "candidates": [to_json(tried, tried is one.chosen) for tried in one.match.tried],
        "files": [path.name for path in one.files],
        "exact": one.exact,
        "notes": one.notes,
        "warnings": one.warnings,
        "where": one.words,
        "parts": [asdict(part) for part in one.parts],
        "angles": [asdict(own) for own in one.angles],
        "reach": one.match.reach,
        "seconds": one.match.seconds,
    }


def _groups(
    source: Source | Sequence[Source], bad: list[TorchbrdfError] | None, settings: Mapping[str, str] | None
) -> list[Measured]:
    """What is given, files of one format as one group, so that their fits are made side by side."""
    several = list(source) if isinstance(source, Sequence) and not isinstance(source, str) else [source]
    found = [one for one in several if isinstance(one, Measured)]
    paths = [one for one in several if not isinstance(one, Measured)]
    wrong: list[DataError] = []
    found += load_all(paths, bad=wrong, settings=settings) if paths else []
    if wrong and bad is None:
        raise wrong[0]
    if bad is not None:
        bad += wrong
    if not found and not wrong:
        raise UsageError("match: expected at least one material, found none")
    return found


def _finish(one: Match, stem: str, target: str, folder: Path | None, bad: list[TorchbrdfError]) -> Finished:
    """Write a match for the target, and say where it is bad."""
    notes: list[str] = []
    chosen, done = _written(one, stem, target, folder, bad)
    exact = done is None or done.exact
    shown: Brdf = chosen.record if done is None or done.exact else done.shown
    figures = one.judge.figures(shown, _differences())
    if done is not None:
        notes += done.notes
    if not exact:
        notes.append(f"Delta E of the fit itself: {chosen.means}")
    if one.untried:
        kinds = "kind of model was" if one.untried == 1 else "kinds of models were"
        notes.append(f"{one.untried} more {kinds} not tried, as the time of --budget was over")
    found, by_angle = parts(one.judge, shown), angles(one.judge, shown)
    files = [] if done is None else done.files
    warnings = [f"the measurement {line}" for line in check(_as_lobe(one.judge.measured))[0].warnings()]
    warnings += [f"the match {line}" for line in check(_as_lobe(shown))[0].warnings()]
    words = in_words(found, by_angle)
    return Finished(one, chosen, shown, figures, files, exact, notes, warnings, found, by_angle, words)


def _as_lobe(brdf: Brdf) -> Lobe | Measured:
    return model_of([brdf], torch.float32) if isinstance(brdf, FitRecord) else brdf


def _written(
    one: Match, stem: str, target: str, folder: Path | None, bad: list[TorchbrdfError]
) -> tuple[Tried, Exported | None]:
    """The first of the fits that the target can show, and what was written of it; nothing if it can show none."""
    refused: TorchbrdfError | None = None
    for tried in one.ranked if folder is not None else ():
        try:
            return tried, write(find_exporter(target), material_of(tried.record, stem), folder or Path())
        except TorchbrdfError as error:
            refused = refused or error
    if refused is not None:
        bad.append(DataError(f"{one.material}: not written for {target}: {refused}"))
    return one.chosen, None


def _differences() -> list[str]:
    """Those that are shown: also just-objectionable differences, where the library that foretells them is installed."""
    try:
        DIFFERENCES[JOD]()
    except UsageError:
        return [DECIDES, ALSO]
    return [DECIDES, ALSO, JOD]
