"""Changes of CSV files: cells, columns, rows, separators, quotes."""

import csv
import io
from random import Random

from fuzzing.changes import Change
from fuzzing.changes.byte import NUMBERS, WORDS, encoded


def cell(source: Random, data: bytes) -> bytes:
    """A cell, or every cell of a column, says something else."""
    rows = parsed(data)
    row = source.choice(rows[1:] or rows)
    column = source.randrange(len(row)) if row else _refuse()
    new = source.choice((*WORDS, *NUMBERS, row[column] * 2, row[column].upper(), f" {row[column]}\u00a0", row[0]))
    for one in rows[1:] if source.random() < 0.2 else [row]:
        if column < len(one):
            one[column] = new
    return dumped(rows)


def column(source: Random, data: bytes) -> bytes:
    """A column is gone, comes twice, changes its place, or is called otherwise."""
    rows = parsed(data)
    place, other = (source.randrange(len(rows[0])) for _ in range(2)) if rows[0] else _refuse()
    kind = source.randrange(4)
    if kind == 3:
        rows[0][place] = source.choice((*WORDS, *rows[0], rows[0][place].upper(), f" {rows[0][place]} "))
        return dumped(rows)
    for row in rows:
        if place < len(row):
            if kind == 0:
                row.pop(place)
            elif kind == 1:
                row.insert(other, row[place])
            else:
                row.insert(other, row.pop(place))
    return dumped(rows)


def row(source: Random, data: bytes) -> bytes:
    """A row is gone, comes often, is too short, too long or empty; or there is none."""
    rows = parsed(data)
    place = source.randrange(len(rows))
    kind = source.randrange(6)
    if kind == 0:
        rows.pop(place)
    elif kind == 1:
        rows[place:place] = [rows[place]] * source.choice((1, 100))
    elif kind == 2:
        rows[place] = rows[place][: source.randrange(len(rows[place]) + 1)]
    elif kind == 3:
        rows[place] = rows[place] * source.choice((2, 3000))
    elif kind == 4:
        rows.insert(place, source.choice(([], [""], ["", ""], ["sep=;"], ["# a comment"])))
    else:
        del rows[source.choice((1, 2)) :]
    return dumped(rows)


def dialect(source: Random, data: bytes) -> bytes:
    """The same table with other separators, quotes or line ends."""
    text = io.StringIO(newline="")
    writer = csv.writer(
        text,
        delimiter=source.choice(";\t|, :"),
        quotechar=source.choice("\"'"),
        quoting=source.choice((csv.QUOTE_ALL, csv.QUOTE_MINIMAL)),
        lineterminator=source.choice(("\n", "\r\n", "\r", "\n\n")),
    )
    writer.writerows(parsed(data))
    head = source.choice(("", "", "sep=;\n", "\ufeff", "\n"))
    return (head + text.getvalue()).encode(source.choice(("utf-8", "utf-8", "utf-16", "utf-8-sig")), "surrogatepass")


def quotes(source: Random, data: bytes) -> bytes:
    """A quote that nothing closes, or one too many."""
    place = source.randrange(len(data) + 1)
    return data[:place] + source.choice((b'"', b'""', b'"\n"', b"'", b'","')) + data[place:]


TABLE: tuple[Change, ...] = (cell, cell, cell, column, row, dialect, quotes)


def parsed(data: bytes) -> list[list[str]]:
    """The rows; a ValueError where there are none any more."""
    try:
        rows = list(csv.reader(io.StringIO(data.decode("utf-8", "surrogatepass"), newline="")))
    except csv.Error:
        rows = []
    return rows or _refuse()


def dumped(rows: list[list[str]]) -> bytes:
    """As a file."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return encoded(text.getvalue())


def _refuse() -> list[list[str]]:
    raise ValueError("no table")
