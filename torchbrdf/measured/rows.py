"""Text files of measurements: lines, and rows of numbers, as programs of many kinds write them."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.reading import check_unpacked, read_bytes

# Of a cell while it is read: a text and a number of Python's.
_BYTES_A_CELL = 100
# How much of a file is looked at for what kind of file it is.
HEAD = 8192


class Rows(NamedTuple):
    """Rows of numbers, and what was mended to read them.

    Attributes:
        numbers: `(N, columns)`, float64.
        mended: In words; "" where nothing was.
    """

    numbers: np.ndarray
    mended: str


def head_lines(path: Path, head: bytes) -> list[str]:
    """The lines that a text file begins with, stripped, without empty ones; none of a file that is no text.

    Args:
        path: The file.
        head: Its first bytes, by which most files that are no text are told without opening them.
    """
    if not is_text(head):
        return []
    try:
        status = path.stat()
        return _lines_at_start(path, status.st_mtime_ns, status.st_size)
    except OSError:
        return []


@lru_cache(4)
def _lines_at_start(path: Path, *stamp: int) -> list[str]:
    """The same of a file that many formats look at, one after the other; stamp: tells it from what it was before."""
    with path.open("rb") as file:
        start = file.read(HEAD)
    if not is_text(start):
        return []
    text = start.decode("utf-8", "replace").removeprefix("\ufeff")
    return [line.strip() for line in text.splitlines() if line.strip()]


def is_text(data: bytes) -> bool:
    """Whether the first bytes of a file are those of a text."""
    return bool(data) and b"\0" not in data and not data.startswith((b"PK", b"\x1f\x8b"))


def text_lines(path: Path, expected: str) -> list[str]:
    """All lines of a text file, stripped, whatever ends them.

    Latin-1 stands in where it is no UTF-8, as in the names of operators and places in a header.

    Raises:
        DataError: It cannot be read, or is too large.
    """
    return lines_of(read_bytes(path, expected))


def lines_of(data: bytes) -> list[str]:
    """The same of the bytes of a file."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return [line.strip() for line in text.splitlines()]


def parse_rows(path: Path, lines: Sequence[str], columns: int, first: int) -> Rows:
    """Numbers of lines with a number for each column, which commas, semicolons, tabs or blanks part.

    Lines that are empty or begin with "#" are passed over. Decimal commas are read where something else than commas
    parts the numbers.

    Args:
        path: The file, for errors.
        lines: The lines.
        columns: How many numbers each has.
        first: The number of the first of the lines in the file, counted from 1, for errors.

    Raises:
        DataError: Names the first line that has another count of numbers, or something else.

    Example:
        >>> from pathlib import Path
        >>> from torchbrdf.measured.rows import parse_rows
        >>> parse_rows(Path("x"), ["1;2,5", "", "3;4"], 2, 1)
        Rows(numbers=array([[1. , 2.5],
               [3. , 4. ]]), mended='decimal commas')
    """
    own = [(k, line) for k, line in enumerate(lines, first) if line and line[0] != "#"]
    check_unpacked(path, _BYTES_A_CELL * columns * len(own))
    mark, decimal = _separator([line for _, line in own]) if own else (None, False)
    texts = [line.replace(",", ".") if decimal else line for _, line in own]
    numbers = _of_plain(texts, mark, columns)
    if numbers is None:
        numbers = _of_any(path, texts, mark, columns, [number for number, _ in own])
    return Rows(numbers.reshape(-1, columns), "decimal commas" if decimal else "")


def _of_plain(texts: Sequence[str], mark: str | None, columns: int) -> np.ndarray | None:
    """Numbers of rows that have them as JSON has, as nearly all do, which are read much faster; None of others."""
    import msgspec  # late: not every file is text

    if mark != ",":
        if any("," in text for text in texts):
            return None
        texts = [",".join(text.split(mark)) for text in texts]
    if any(text.count(",") != columns - 1 for text in texts):
        return None
    try:
        found: list[float] = msgspec.json.decode(f"[{','.join(texts)}]", type=list[float])
    except msgspec.MsgspecError:
        return None
    return np.array(found, dtype=np.float64)


def _of_any(path: Path, texts: Sequence[str], mark: str | None, columns: int, lines: Sequence[int]) -> np.ndarray:
    """The same of all that Python takes for numbers; an error names the first of the lines that is bad."""
    cells = [text.split(mark) for text in texts]
    if mark is not None:  # an empty cell behind the last one
        cells = [row[:-1] if len(row) == columns + 1 and not row[-1] else row for row in cells]
    for number, row in zip(lines, cells, strict=True):
        if len(row) != columns:
            raise DataError(f"{path}: line {number}: expected {columns} numbers, found {len(row)}")
    try:
        return np.array(list(map(_number, chain.from_iterable(cells))), dtype=np.float64)
    except ValueError:
        raise DataError(_first_bad(path, lines, cells)) from None


def _number(cell: str) -> float:
    found = float(cell)
    if "_" in cell:  # which Python allows
        raise ValueError
    return found


def _separator(lines: Sequence[str]) -> tuple[str | None, bool]:
    """What parts the numbers of a line, None for blanks, and whether they have decimal commas: by all lines."""
    first = lines[0]
    decimal = any("," in line for line in lines) and not any("." in line for line in lines)
    if ";" in first:
        return ";", decimal
    if "\t" in first:
        return None, decimal
    parts = first.split()
    if "," in first and not (decimal and len(parts) > 1 and not any(part.endswith(",") for part in parts)):
        return ",", False
    return None, decimal


def _first_bad(path: Path, numbers: Sequence[int], cells: Sequence[Sequence[str]]) -> str:
    for number, row in zip(numbers, cells, strict=True):
        for place, cell in enumerate(row, 1):
            try:
                _number(cell)
            except ValueError:
                return f"{path}: line {number}: expected a number in column {place}, found {shown(cell)}"
    raise AssertionError("every cell is a number")
