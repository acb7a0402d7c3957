"""CSV files of published answers: rows with the line that each is in, and what a cell holds."""

import csv
import difflib
import io
import math
from collections.abc import Collection
from pathlib import Path

from torchbrdf.errors import DataError, shown
from torchbrdf.reading import exists, read_text


def read_rows(path: Path, what: str, source: str) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of a CSV file; row k is in line k + 2.

    Args:
        path: The file.
        what: What its rows are.
        source: Where the file comes from.

    Raises:
        DataError: There is no such file, or it is no CSV.
    """
    if not exists(path):
        raise DataError(f"{path}: no such file; expected {source}")
    text = read_text(path, what)
    try:
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except csv.Error as error:
        raise DataError(f"{path}: expected CSV: {error}") from None
    return (rows[0], rows[1:]) if rows else ([], [])


def check_head(path: Path, head: list[str], expected: list[str]) -> None:
    """A DataError for a head that is not as expected."""
    if head != expected:
        found = shown(",".join(head)) if head else "nothing"
        raise DataError(f"{path}: line 1: expected {','.join(expected)}, found {found}")


def check_rows(path: Path, rows: list[list[str]], what: str) -> None:
    """A DataError where there is no row."""
    if not rows:
        raise DataError(f"{path}: expected {what}, found no row")


def number(text: str, low: float, high: float, where: str, what: str) -> float:
    """The number in a cell; a DataError if it is none from `low` to `high`.

    Example:
        >>> number("0.5", 0, 1, "opinions.csv: line 2", "a distance")
        0.5
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise DataError(f"{where}: expected {what} from {low:g} to {high:g}, found {shown(text)}")
    return value


def near(name: str, known: Collection[str]) -> str:
    """The end of a message about an unknown name: the nearest known one, if any is near.

    Example:
        >>> near("nickle", ["brass", "nickel"])
        "; did you mean 'nickel'?"
    """
    found = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {found[0]!r}?" if found else ""
