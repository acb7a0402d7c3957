"""Tables of reports: rows of anything, columns that say what they show of a row and which value is the best."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Row = TypeVar("Row")


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, whether it is the best (bold), and whether it is framed."""

    text: str
    best: bool = False
    outlier: bool = False


@dataclass(frozen=True)
class Table:
    """A table as `tables.html` shows it."""

    title: str
    note: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]


def no(row: object) -> bool:
    """No."""
    return False


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A column of a table.

    Args:
        head: What stands above it.
        value: The value of a row; None leaves the cell empty.
        show: A format specification, or a function from value to text.
        best: `min` or `max`: the best value of the column is bold.
        among: Columns of one such name are compared with each other in each row, instead of each down its rows.
        key: What `best` compares of a value; nan is not compared.
        bold: Whether the cell of a row is bold by itself.
        outlier: Whether the cell of a row is framed.
    """

    head: str
    value: Callable[[Row], Any]
    show: str | Callable[[Any], str] = ""
    best: Callable[[Iterable[Any]], Any] | None = None
    among: str = ""
    key: Callable[[Any], Any] = lambda value: value
    bold: Callable[[Row], bool] = no
    outlier: Callable[[Row], bool] = no

    def text(self, value: Any) -> str:
        """What a cell shows."""
        if value is None:
            return ""
        return self.show(value) if callable(self.show) else format(value, self.show)


def table(title: str, note: str, rows: Iterable[Row], columns: Sequence[Column[Row]]) -> Table:
    """A table with a cell for each row and column, the best values marked."""
    rows = list(rows)
    values = [[column.value(row) for column in columns] for row in rows]
    cells: list[list[Cell]] = []
    for r, row in enumerate(rows):
        cells.append([])
        for c, column in enumerate(columns):
            others = [values[r][k] for k, other in enumerate(columns) if other.among == column.among]
            best = _is_best(values[r][c], others if column.among else [own[c] for own in values], column)
            cells[-1].append(Cell(column.text(values[r][c]), best or column.bold(row), column.outlier(row)))
    return Table(title, note, [column.head for column in columns], cells)


def _is_best(value: Any, others: Sequence[Any], column: Column[Row]) -> bool:
    """Whether a value is the best of those that it is compared with, itself among them."""
    if column.best is None or value is None:
        return False
    keys = [key for key in (column.key(other) for other in others if other is not None) if key == key]
    return bool(keys) and bool(column.key(value) == column.best(keys))
