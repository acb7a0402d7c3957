"""What the selections of a file mean: one meaning for all rows, or none."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

from torchbrdf.errors import DataError, shown

Meaning = Literal["places", "names", "first_or_not"]
LEFT, RIGHT = "left", "right"

# Column of selections -> what may stand in it. Where several meanings fit all rows, they must choose the same.
SELECTIONS: Mapping[str, tuple[Meaning, ...]] = {
    "selection": ("places", "names", "first_or_not"),
    "selected": ("places", "names", "first_or_not"),
    "chosen": ("places", "names"),
    "winner": ("places", "names"),
    "choice": ("places", "names"),
    "chosen_place": ("places",),
    "chosen_name": ("names",),
    "is_a_selected": ("first_or_not",),
    "selected_a": ("first_or_not",),
}
_WORDS: Mapping[Meaning, str] = {
    "places": "1, 2, left or right",
    "names": "the name of one of the two",
    "first_or_not": "1 for the first or 0 for the second",
}
_PLACES: Mapping[int | None, str] = {1: LEFT, 2: RIGHT}
_SIDES = {"left": LEFT, "right": RIGHT}
_FLAGS: Mapping[int | None, str] = {1: LEFT, 0: RIGHT}
_TRUTHS = {"true": LEFT, "false": RIGHT}
# 1, and what tables make of it where another row has none: 1.0, or 1,0.
_WHOLE = re.compile(r"[+-]?\d{1,15}(?=(?:[.,]0*)?$)", re.ASCII)


class Shown(NamedTuple):
    """A row's two stimuli, and what stands in its column of selections."""

    left: str
    right: str
    selection: str


def chosen_sides(rows: Sequence[Shown], column: str, where: Callable[[int], str]) -> list[str]:
    """Which side each row chose, "left" or "right", under the one meaning that fits all rows.

    Places are 1 and 2, or left and right; first_or_not, as pwcmp has it, is 1 for the first and 0 for the second; a
    name is one of the row's two. A row alone decides nothing: stimuli may be called 1 and 2.

    Args:
        rows: Of a file.
        column: Its column of selections, of `SELECTIONS`.
        where: The place of a row, for messages.

    Raises:
        DataError: No meaning fits all rows, or several do and choose otherwise.

    Example:
        >>> rows = [Shown("1", "2", "2"), Shown("3", "1", "1")]
        >>> chosen_sides(rows, "chosen_name", str), chosen_sides(rows, "chosen_place", str)
        (['right', 'right'], ['right', 'left'])
    """
    meanings = SELECTIONS[column]
    readings = {meaning: [_READERS[meaning](row) for row in rows] for meaning in meanings}
    fits = {meaning: sides for meaning, sides in readings.items() if None not in sides}
    if not fits:
        best = max(meanings, key=lambda meaning: _until(readings[meaning]))
        row = _until(readings[best])
        said = f"{_WORDS[best]}, as in the rows before" if row else "; or ".join(_WORDS[one] for one in meanings)
        raise DataError(f"{where(row)}: {column}: expected {said}, found {shown(rows[row].selection)}")
    (first, sides), *others = fits.items()
    for other, also in others:
        if also != sides:
            row = next(k for k, pair in enumerate(zip(sides, also, strict=True)) if pair[0] != pair[1])
            raise DataError(
                f"{where(row)}: {column}: {shown(rows[row].selection, 20)} may be {_WORDS[first]}, or {_WORDS[other]}, "
                "and no row settles it; call the column chosen_place, chosen_name or is_A_selected"
            )
    return [side for side in sides if side is not None]


def _until(sides: Sequence[str | None]) -> int:
    """How many rows a meaning fits before the first that it does not."""
    return next((k for k, side in enumerate(sides) if side is None), len(sides))


def _place(row: Shown) -> str | None:
    return _PLACES.get(_whole(row.selection)) or _SIDES.get(row.selection.casefold())


def _first_or_not(row: Shown) -> str | None:
    return _FLAGS.get(_whole(row.selection)) or _TRUTHS.get(row.selection.casefold())


def _name(row: Shown) -> str | None:
    """The side with the selection's name; else that with its number."""
    sides = ((LEFT, row.left), (RIGHT, row.right))
    same = [side for side, name in sides if name == row.selection]
    if not same and (number := _whole(row.selection)) is not None:
        same = [side for side, name in sides if _whole(name) == number]
    return same[0] if len(same) == 1 else None


def _whole(text: str) -> int | None:
    """A whole number in digits, with or without zeros behind a point or a comma."""
    found = _WHOLE.match(text)
    return int(found[0]) if found else None


_READERS: Mapping[Meaning, Callable[[Shown], str | None]] = {
    "places": _place,
    "names": _name,
    "first_or_not": _first_or_not,
}
