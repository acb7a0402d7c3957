"""Answers of observers, and the CSV files that hold them: one row an answer."""

import csv
import io
import logging
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from torchbrdf.errors import DataError, one_line, shown
from torchbrdf.files import quoted, unquoted, write_text
from torchbrdf.names import LONGEST_NAME, is_one_line
from torchbrdf.study.selection import LEFT, SELECTIONS, Shown, chosen_sides
from torchbrdf.study.tables import TextTable, column_key, read_table

Kind = Literal["trial", "repeat", "catch"]
KINDS: tuple[Kind, ...] = ("trial", "repeat", "catch")

# Observers whose names begin so are no people; every figure made with their answers says so.
SIMULATED = "simulated"

# Our columns, and other names for them. A session is an experiment, a scene a material, condition 1 stands on the left,
# and selection says which was chosen, 1 or 2.
COLUMNS: dict[str, tuple[str, ...]] = {
    "observer": ("participant", "subject"),
    "session": ("experiment",),
    "scene": ("material", "content"),
    "condition_1": ("left", "a", "condition_a"),
    "condition_2": ("right", "b", "condition_b"),
    "selection": tuple(name for name in SELECTIONS if name != "selection"),
    "response_time": (),
    "time_stamp": ("timestamp",),
    "seed": (),
    "kind": (),
}
# pwcmp's, and no experiment: it counts sittings.
_PASSED_OVER = "session_id"
# Columns of files that have one row for several answers.
_COUNTS = {"count", "counts", "weight", "weights", "n", "votes", "frequency"}
NEEDED = ("observer", "condition_1", "condition_2", "selection")
_OURS = {other: name for name, others in COLUMNS.items() for other in (name, *others)}
# Seconds; beyond, it is no time that somebody took.
LONGEST_TIME = 1e7
LARGEST_SEED = 10**38


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
        DataError: A name is empty, too long or of more than one line, `chosen` was not shown, or a number cannot be.

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
            if not is_one_line(name) or len(name) > LONGEST_NAME:
                raise DataError(f"answer: expected names of one line, up to {LONGEST_NAME} long, found {shown(name)}")
        for what, name in (("observer", self.observer), ("left", self.left), ("right", self.right)):
            if not name.strip():
                raise DataError(f"answer: {what}: expected a name, found nothing")
        if self.left == self.right:
            raise DataError(f"answer: expected two stimuli, found {shown(self.left)} twice")
        if self.chosen not in (self.left, self.right):
            named = f"{shown(self.left)} or {shown(self.right)}"
            raise DataError(f"answer: chosen: expected {named}, found {shown(self.chosen)}")
        if not (math.isnan(self.response_time) or 0 <= self.response_time <= LONGEST_TIME):
            raise DataError(f"answer: response_time: expected 0 to {LONGEST_TIME:g} s, found {self.response_time}")
        if self.seed is not None and abs(self.seed) >= LARGEST_SEED:
            raise DataError(f"answer: seed: expected less than 1e38, found {len(str(self.seed))} digits")
        if self.kind not in KINDS:
            raise DataError(f"answer: kind: expected one of {', '.join(KINDS)}, found {shown(self.kind)}")

    @property
    def rejected(self) -> str:
        """The stimulus that was not chosen."""
        return self.right if self.chosen == self.left else self.left


def simulated(answers: Iterable[Answer]) -> bool:
    """Whether any of the answers' observers is simulated, no person."""
    return any(answer.observer.casefold().startswith(SIMULATED) for answer in answers)


def write_answers(path: Path | str, answers: Iterable[Answer]) -> None:
    """Write observers' answers to a CSV file, whole or not at all; `read_answers` gives exactly them back.

    Names that a spreadsheet would take for formulas have an apostrophe before them.

    Raises:
        DataError: The file cannot be written.
    """
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    for answer in answers:
        names = (answer.observer, answer.experiment, answer.material, answer.left, answer.right)
        chosen = 1 if answer.chosen == answer.left else 2
        seed = "" if answer.seed is None else answer.seed
        stamp = quoted(answer.time_stamp)
        rows.writerow((*map(quoted, names), chosen, _seconds(answer.response_time), stamp, seed, answer.kind))
    write_text(path, text.getvalue())


def read_answers(path: Path | str) -> list[Answer]:
    """Read observers' answers from a CSV file: ours, pwcmp's, or one with observer, material, left, right, chosen.

    Only the observer, the two stimuli and which was chosen are needed; names of columns in any case. What selections
    mean is settled for a whole file, see `torchbrdf.study.selection.SELECTIONS`: places (1, 2, left, right), names, or
    pwcmp's 1 for the first and 0 for the second. In a file with exactly the columns of `write_answers` they are places.
    A response time, a time or a seed that cannot be read counts as missing, and the log says so. pwcmp's session_id,
    which counts an observer's sittings, is no experiment. Columns that are not read are named in the log; one that
    counts how often an answer was given is refused.

    Args:
        path: The file, in UTF-8 or UTF-16; separated by commas, semicolons, tabs, or as a line `sep=` says.

    Raises:
        DataError: Says file, line, column, what was expected and what was found.
    """
    table = read_table(path, lambda name: column_key(name) in _OURS, "answers")
    own = table.columns == tuple(COLUMNS)
    where = _columns(path, table)
    if not table.rows:
        raise DataError(f"{path}: expected answers, found none")
    if own:
        cells = [{name: unquoted(row[k]) for name, k in where.items()} for _, row in table.rows]
    else:
        cells = [{name: row[k].strip() for name, k in where.items()} for _, row in table.rows]
    lines = [f"{path}, line {line}" for line, _ in table.rows]
    for line, row in zip(lines, cells, strict=True):
        for name in ("observer", "condition_1", "condition_2"):
            if not row[name].strip():
                raise DataError(f"{line}: {name}: expected a name, found nothing")
    asked = [Shown(row["condition_1"], row["condition_2"], row["selection"]) for row in cells]
    column = "chosen_place" if own else column_key(table.columns[where["selection"]])
    sides = chosen_sides(asked, column, lines.__getitem__)
    optional = _Optional(table.separator)
    answers = [_answer(row, side, line, optional) for row, side, line in zip(cells, sides, lines, strict=True)]
    optional.log()
    return answers


def _columns(path: Path | str, table: TextTable) -> dict[str, int]:
    """Where each of our columns is; the log names the others."""
    found = [_OURS.get(column_key(name)) for name in table.columns]
    unread = [k for k, name in enumerate(found) if name is None and column_key(table.columns[k]) != _PASSED_OVER]
    for k in unread:
        if column_key(table.columns[k]) in _COUNTS and any(row[k].strip() not in ("", "1") for _, row in table.rows):
            said = f"a column {shown(table.columns[k])} that counts answers"
            raise DataError(f"{path}: expected a row an answer, found {said}")
    if unread:
        said = f"{path}: columns that are not read: {', '.join(table.columns[k].strip() for k in unread)}"
        logging.getLogger("torchbrdf").warning("torchbrdf: %s", one_line(said))
    where = {}
    for name, others in COLUMNS.items():
        places = [k for k, there in enumerate(found) if there == name]
        if len(places) > 1:
            named = ", ".join(table.columns[k].strip() for k in places)
            raise DataError(f"{path}: expected one column for {name}, found {named}")
        if places:
            where[name] = places[0]
        elif name in NEEDED:
            named = " or ".join((name, *others[:3]))
            raise DataError(f"{path}: expected a column {named}, found {shown(', '.join(table.columns))}")
    return where


T = TypeVar("T")


class _Optional:
    """Reads what an answer can do without; what cannot be read counts as missing, and is counted."""

    def __init__(self, separator: str) -> None:
        self.decimal_comma = separator != ","
        self.missing: dict[str, tuple[int, str]] = {}

    def read(self, line: str, name: str, text: str, parse: Callable[[str], T], missing: T) -> T:
        """What a text says, or `missing`."""
        if not text:
            return missing
        try:
            return parse(text)
        except ValueError:
            count, first = self.missing.get(name, (0, f"{line}: {shown(text)}"))
            self.missing[name] = count + 1, first
            return missing

    def seconds(self, text: str) -> float:
        """A response time; a ValueError if it is none."""
        found = float(text.replace(",", ".") if self.decimal_comma else text)
        if not (math.isnan(found) or 0 <= found <= LONGEST_TIME):
            raise ValueError
        return found

    def log(self) -> None:
        """Say how much was missing."""
        for name, (count, first) in self.missing.items():
            said = f"{name} that cannot be read counts as missing, in {count} answers; the first: {first}"
            logging.getLogger("torchbrdf").warning("torchbrdf: %s", one_line(said))


def _answer(cells: Mapping[str, str], side: str, line: str, optional: _Optional) -> Answer:
    left, right = cells["condition_1"], cells["condition_2"]
    kind: Any = cells.get("kind", "").strip().casefold() or "trial"  # checked there: not every kind counts
    try:
        return Answer(
            observer=cells["observer"],
            experiment=cells.get("session", ""),
            material=cells.get("scene", ""),
            left=left,
            right=right,
            chosen=left if side == LEFT else right,
            response_time=optional.read(
                line, "response_time", cells.get("response_time", ""), optional.seconds, math.nan
            ),
            time_stamp=optional.read(line, "time_stamp", cells.get("time_stamp", ""), _printable, ""),
            seed=optional.read(line, "seed", cells.get("seed", ""), _seed, None),
            kind=kind,
        )
    except DataError as error:
        raise DataError(f"{line}: {error}") from None


def _seconds(time: float) -> str:
    """A time to the millisecond, or as exactly as it is."""
    if math.isnan(time):
        return ""
    short = f"{time:.3f}"
    return short if float(short) == time else repr(time)


def _printable(text: str) -> str:
    if not is_one_line(text) or len(text) > LONGEST_NAME:
        raise ValueError
    return text


def _seed(text: str) -> int | None:
    if not re.fullmatch(r"-?\d{1,38}", text.strip(), re.ASCII):
        raise ValueError
    return int(text)


def by_observer(answers: Sequence[Answer]) -> dict[str, list[Answer]]:
    """The answers of each observer, in the order in which observers first appear."""
    found: dict[str, list[Answer]] = {}
    for answer in answers:
        found.setdefault(answer.observer, []).append(answer)
    return found
