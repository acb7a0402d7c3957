"""The folder of `match`, to which others may add: match.json, match.html, and the parts of the page that are kept."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError
from torchbrdf.files import destination, locked, without_empty_folders, writable, write_json
from torchbrdf.names import distinct_stems
from torchbrdf.reading import read_json
from torchbrdf.report.match_page import Block, write_match_page

FITS, LIST, PAGE = "fits", "match.json", "match.html"
# In FITS: what the page shows of each match.
PAGES = "pages"
EXPECTED = "a list of matches, from match"
# Seconds that another process may take to write its matches.
WAIT = 60.0
# What tells a match from others of a folder.
KEY = ("material", "target")

Entry = dict[str, Any]


@contextmanager
def prepared(out: Path) -> Iterator[Path]:
    """The folder, made if need be, with no other thing in the place of its files; removed again if nothing comes of it.

    Raises:
        DataError: It cannot be written.
    """
    with without_empty_folders():
        folder = writable(out)
        for name in (LIST, PAGE):
            destination(folder / name)
        for part in (folder / FITS, folder / FITS / PAGES):
            writable(part)
        yield folder


def read_entries(folder: Path) -> list[Entry]:
    """The matches that a folder has.

    Raises:
        DataError: Its list is none.
    """
    if not (folder / LIST).exists():
        return []
    found: list[Entry] = read_json(folder / LIST, list[Entry], EXPECTED)
    for entry in found:
        if not isinstance(entry.get(KEY[0]), str):
            raise DataError(f"{folder / LIST}: expected {EXPECTED}, found one without a material")
    return found


def stems(folder: Path, names: Sequence[str]) -> list[str]:
    """Names for the files of materials, none of them that of another one's that the folder has."""
    every = list(dict.fromkeys([*(entry["material"] for entry in read_entries(folder)), *names]))
    found = dict(zip(every, distinct_stems(every), strict=True))
    return [found[name] for name in names]


def add(folder: Path, entries: Sequence[Entry], blocks: Sequence[Block], problems: Sequence[str]) -> None:
    """Add matches to a folder's list and page, or put them in the place of former ones for the same target.

    Args:
        folder: Where.
        entries: Of the list, each with its material and target.
        blocks: Of the page, one an entry.
        problems: What could not be matched.
    """
    with locked(folder, wait=WAIT):
        there = {_key(entry): entry for entry in read_entries(folder)} | {_key(entry): entry for entry in entries}
        places = _places(folder, list(there))
        for entry, block in zip(entries, blocks, strict=True):
            write_json(places[_key(entry)], asdict(block))
        write_json(folder / LIST, list(there.values()))
        shown: list[Block] = [
            read_json(place, Block, "a part of the page of match") for place in places.values() if place.exists()
        ]
        write_match_page(folder / PAGE, shown, problems)


def _key(entry: Entry) -> tuple[str, str]:
    material, target = (str(entry.get(name, "")) for name in KEY)
    return material, target


def _places(folder: Path, keys: Sequence[tuple[str, str]]) -> dict[tuple[str, str], Path]:
    """The file of each match's part of the page."""
    names = distinct_stems([f"{material}-{target}" for material, target in keys])
    return {key: folder / FITS / PAGES / f"{name}.json" for key, name in zip(keys, names, strict=True)}
