"""Writing files whole or not at all: text, JSON, CSV."""

import csv
import io
import json
import math
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, that takes its place when the block ends without an error."""
    path = Path(path)
    temporary = path.with_name(f".{os.getpid()}-{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        if path.parent.is_dir():
            temporary.unlink(missing_ok=True)


def writable(folder: Path | str) -> Path:
    """The folder, made if need be; a DataError now rather than after the work if nothing can be written there."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise DataError(f"{folder}: cannot be written ({error.strerror})") from None


def write_text(path: Path | str, text: str) -> None:
    """Write a text file whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a file whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: Path | str, value: object) -> None:
    """Write a value as indented JSON, whole or not at all; a number that is not finite is null."""
    write_text(path, json.dumps(_finite(value), indent=1, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    """A value with None for every number in it that is not finite."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def csv_text(rows: Iterable[Mapping[str, Any]]) -> str:
    r"""Rows as CSV: a line a row, a column for each key that any row has, in the order in which they first appear.

    A text that a spreadsheet would take for a formula gets an apostrophe before it, as `quoted` has it.

    Example:
        >>> csv_text([{"name": "nickel", "error": 0.5}, {"name": "nylon"}])
        'name,error\nnickel,0.5\nnylon,\n'
    """
    rows = list(rows)
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: quoted(value) for key, value in row.items()} for row in rows)
    return text.getvalue()


# What spreadsheets take for a formula, and what was written for one: so `unquoted` always finds the same text.
_FORMULA = re.compile(r"'*[=+\-@\t\r]")


def quoted(value: Any) -> Any:
    """A cell of a CSV file: a text that spreadsheets would run as a formula with an apostrophe before it.

    Source: OWASP, CSV Injection, https://owasp.org/www-community/attacks/CSV_Injection.

    Example:
        >>> quoted("=1+1"), quoted("nickel"), quoted(-1.5)
        ("'=1+1", 'nickel', -1.5)
    """
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def unquoted(text: str) -> str:
    """The text that `quoted` made a cell of.

    Example:
        >>> unquoted("'=1+1"), unquoted("nickel"), unquoted(quoted("'=1"))
        ('=1+1', 'nickel', "'=1")
    """
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


def write_csv(path: Path | str, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows as CSV, as `csv_text` has them, whole or not at all."""
    write_text(path, csv_text(rows))
