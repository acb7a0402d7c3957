"""Tables as spreadsheets and scripts write them: whatever the encoding, the separator and the line ends."""

import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from torchbrdf.errors import DataError
from torchbrdf.reading import read_bytes

SEPARATORS = (",", ";", "\t", "|")
_BYTE_ORDER_MARKS = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"", "utf-8-sig"))


@dataclass(frozen=True)
class TextTable:
    """A table of text: the names of its columns as they stand there, and rows with the lines that they end on.

    separator: between its cells; where it is no comma, a comma may stand in numbers.
    """

    columns: tuple[str, ...]
    rows: list[tuple[int, list[str]]]
    separator: str


def read_table(path: Path | str, recognised: Callable[[str], bool], expected: str) -> TextTable:
    """Read a CSV file: UTF-8, or UTF-16 with a mark, any line ends, empty lines, a first line `sep=;` as Excel has it.

    The separator is the one of `SEPARATORS` that parts the first row, quotes heeded, into most of the columns that
    are looked for. Empty cells beyond the last column are left out.

    Args:
        path: The file.
        recognised: Whether a name of a column is one that is looked for.
        expected: What the file holds, for messages.

    Raises:
        DataError: Says line, what was expected and what was found.
    """
    text = _decoded(path, read_bytes(path, expected), expected)
    stated = re.match(r"\s*\"?sep=(.)\"?[,;\t]*(\r\n|\r|\n|$)", text, re.IGNORECASE)
    skipped = len(text[: stated.end()].splitlines()) if stated else 0
    text = text[stated.end() :] if stated else text
    separator = stated[1] if stated and stated[1] not in '"\r\n' else _separator(text, recognised)
    found = [(skipped + line, row) for line, row in _rows(path, text, separator, skipped) if any(map(str.strip, row))]
    if not found:
        raise DataError(f"{path}: expected {expected}, found an empty file")
    head = _trimmed(found[0][1])
    rows = []
    for line, row in found[1:]:
        cells = row if len(row) == len(head) else _trimmed(row)
        cells += [""] * (len(head) - len(cells)) if len(row) >= len(head) else []
        if len(cells) != len(head):
            raise DataError(f"{path}, line {line}: expected {len(head)} columns, found {len(row)}")
        rows.append((line, cells))
    return TextTable(tuple(head), rows, separator)


def column_key(name: str) -> str:
    """The name of a column without what writers differ in: capitals, spaces, hyphens, points.

    Example:
        >>> column_key(" Condition-1 ")
        'condition_1'
    """
    return re.sub(r"[\s.\-]+", "_", name.strip()).casefold()


def _decoded(path: Path | str, data: bytes, expected: str) -> str:
    encoding = next(name for mark, name in _BYTE_ORDER_MARKS if data.startswith(mark))
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        said = "text in UTF-8 (in Excel: save as CSV UTF-8)"
        raise DataError(f"{path}: expected {expected} as {said}, found other bytes at {error.start}") from None


def _separator(text: str, recognised: Callable[[str], bool]) -> str:
    """The separator that parts the first row into most columns that are known; then into most."""

    def worth(separator: str) -> tuple[int, int]:
        rows = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
        try:
            head = next((row for row in rows if any(map(str.strip, row))), [])
        except csv.Error:
            return 0, 0
        return sum(map(recognised, head)), len(head)

    return max(SEPARATORS, key=worth)


def _rows(path: Path | str, text: str, separator: str, skipped: int) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        for row in reader:
            yield reader.line_num, row
    except csv.Error as error:
        raise DataError(f"{path}, line {skipped + reader.line_num}: expected CSV ({error})") from None


def _trimmed(row: Sequence[str]) -> list[str]:
    """A row without empty cells at its end."""
    cells = list(row)
    while cells and not cells[-1].strip():
        cells.pop()
    return cells
