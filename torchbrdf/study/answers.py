"""Answers of observers, and the CSV files that hold them: one row an answer."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from torchbrdf.errors import DataError
from torchbrdf.files import write_text

Kind = Literal["trial", "repeat", "catch"]
KINDS: tuple[Kind, ...] = ("trial", "repeat", "catch")

# Observers whose names begin so are no people; every figure made with their answers says so.
SIMULATED = "simulated"

# Our column -> other names for it. The columns are those of pwcmp (https://github.com/mantiuk/pwcmp) and more: a
# session is an experiment, a scene a material, condition 1 stands on the left, selection says which was chosen, 1 or 2.
COLUMNS: dict[str, tuple[str, ...]] = {
    "observer": ("participant", "subject"),
    "session": ("experiment",),
    "scene": ("material", "content"),
    "condition_1": ("left", "a"),
    "condition_2": ("right", "b"),
    "selection": ("chosen", "winner", "choice"),
    "response_time": (),
    "time_stamp": ("timestamp",),
    "seed": (),
    "kind": (),
}
NEEDED = ("observer", "condition_1", "condition_2", "selection")
LARGEST_FILE = 256 * 2**20


@dataclass(frozen=True)
class Answer:
    """Answer of an observer to a paired comparison.

    Args:
        observer: A name.
        experiment: The name of the experiment.
        material: The name of the material.
        left: The stimulus on the left.
        right: The stimulus on the right.
        chosen: `left` or `right`, the names.
        response_time: Seconds since both pictures were visible, nan if not known.
        time_stamp: ISO 8601, UTC.
        seed: Of the observer's order of trials.
        kind: A "trial" counts for the scales; a "repeat" shows a trial again, and says how steady an observer is; a
            "catch" trial has an answer that is known.

    Raises:
        DataError: A name has more than one line, or `chosen` was not shown.

    Example:
        >>> Answer("ann", "gloss", "nickel", left="ward", right="cook", chosen="cook").rejected
        'ward'
    """

    observer: str
    experiment: str
    material: str
    left: str
    right: str
    chosen: str
    response_time: float = math.nan
    time_stamp: str = ""
    seed: int | None = None
    kind: Kind = "trial"

    def __post_init__(self) -> None:
        for name in (self.observer, self.experiment, self.material, self.left, self.right, self.time_stamp):
            if not name.isprintable():
                raise DataError(f"answer: expected names of one line, found {name!r}")
        if self.left == self.right:
            raise DataError(f"answer: expected two stimuli, found {self.left!r} twice")
        if self.chosen not in (self.left, self.right):
            raise DataError(f"answer: chosen: expected {self.left!r} or {self.right!r}, found {self.chosen!r}")
        if self.kind not in KINDS:
            raise DataError(f"answer: kind: expected one of {', '.join(KINDS)}, found {self.kind!r}")

    @property
    def rejected(self) -> str:
        """The stimulus that was not chosen."""
        return self.right if self.chosen == self.left else self.left


def simulated(answers: Iterable[Answer]) -> bool:
    """Whether any of the answers' observers is simulated, no person."""
    return any(answer.observer.startswith(SIMULATED) for answer in answers)


def write_answers(path: Path | str, answers: Iterable[Answer]) -> None:
    """Write observers' answers to a CSV file, whole or not at all.

    Raises:
        DataError: The file cannot be written.
    """
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    for answer in answers:
        time = "" if math.isnan(answer.response_time) else f"{answer.response_time:.3f}"
        chosen = 1 if answer.chosen == answer.left else 2
        seed = "" if answer.seed is None else answer.seed
        where = (answer.observer, answer.experiment, answer.material, answer.left, answer.right)
        rows.writerow((*where, chosen, time, answer.time_stamp, seed, answer.kind))
    write_text(path, text.getvalue())


def read_answers(path: Path | str) -> list[Answer]:
    """Read observers' answers from a CSV file: ours, pwcmp's, or one with observer, material, left, right, chosen.

    Only the observer, the two stimuli and which was chosen (1, 2, left, right, or its name) are needed. The separator
    may be a comma, a semicolon or a tab.

    Args:
        path: The file.

    Raises:
        DataError: Says file, line, column, what was expected and what was found.
    """
    path = Path(path)
    rows = _rows(path)
    where = _columns(path, rows[0])
    answers = []
    for line, row in rows[1:]:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(rows[0][1]):
            raise DataError(f"{path}, line {line}: expected {len(rows[0][1])} columns, found {len(row)}")
        cells = {name: row[k].strip() for name, k in where.items()}
        answers.append(_answer(cells, f"{path}, line {line}"))
    if not answers:
        raise DataError(f"{path}: expected answers, found none")
    return answers


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """The rows of a file with the lines that they end on; the first are the column's names."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise DataError(f"{path}: expected at most {LARGEST_FILE} bytes, found {path.stat().st_size}")
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: expected text in UTF-8, found other bytes at {error.start}") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    head = text.split("\n", 1)[0]
    separator = max(",;\t", key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise DataError(f"{path}, line {reader.line_num}: expected CSV ({error})") from None
    if not rows:
        raise DataError(f"{path}: expected answers, found an empty file")
    return rows


def _columns(path: Path, head: tuple[int, list[str]]) -> dict[str, int]:
    """Where each of our columns is."""
    found = [name.strip().lower().replace(" ", "_") for name in head[1]]
    where = {}
    for name, others in COLUMNS.items():
        places = [k for k, there in enumerate(found) if there in (name, *others)]
        if len(places) > 1:
            raise DataError(f"{path}: expected one column for {name}, found {', '.join(found[k] for k in places)}")
        if places:
            where[name] = places[0]
        elif name in NEEDED:
            named = " or ".join((name, *others))
            raise DataError(f"{path}: expected a column {named}, found {', '.join(found)}")
    return where


def _answer(cells: dict[str, str], where: str) -> Answer:
    left, right, selection = cells["condition_1"], cells["condition_2"], cells["selection"]
    for name in ("observer", "condition_1", "condition_2"):
        if not cells[name]:
            raise DataError(f"{where}: {name}: expected a name, found nothing")
    words = {left: left, right: right, "1": left, "2": right, "left": left, "right": right}
    # A stimulus may be called 2, or left: its name goes before.
    words |= {left: left, right: right}
    if selection not in words:
        raise DataError(f"{where}: selection: expected 1, 2, left, right, {left} or {right}, found {selection!r}")
    seed = cells.get("seed", "")
    if seed and not (seed.removeprefix("-").isascii() and seed.removeprefix("-").isdigit() and len(seed) < 30):
        raise DataError(f"{where}: seed: expected a whole number, found {seed!r}")
    try:
        time = float(cells.get("response_time") or "nan")
    except ValueError:
        found = cells["response_time"]
        raise DataError(f"{where}: response_time: expected seconds, found {found!r}") from None
    try:
        return Answer(
            observer=cells["observer"],
            experiment=cells.get("session", ""),
            material=cells.get("scene", ""),
            left=left,
            right=right,
            chosen=words[selection],
            response_time=time,
            time_stamp=cells.get("time_stamp", ""),
            seed=int(seed) if seed else None,
            kind=cells.get("kind") or "trial",  # type: ignore[arg-type]  # checked there
        )
    except DataError as error:
        raise DataError(f"{where}: {error}") from None


def by_observer(answers: Sequence[Answer]) -> dict[str, list[Answer]]:
    """The answers of each observer, in the order in which observers first appear."""
    found: dict[str, list[Answer]] = {}
    for answer in answers:
        found.setdefault(answer.observer, []).append(answer)
    return found
