"""What the commands share."""

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from torchbrdf.errors import DataError

if TYPE_CHECKING:
    from torchbrdf.measured import Measured
    from torchbrdf.progress import Progress

Options = argparse.Namespace
Commands = Any
"""What argparse adds commands to; its type has no public name."""


def progress_bar(label: str) -> "Progress":
    """A progress bar on a terminal; nothing where there is none, or nothing to do."""
    from tqdm import tqdm

    shown: list[tqdm[Any]] = []

    def progress(done: int, total: int) -> None:
        if not shown:
            shown.append(tqdm(total=total, desc=label, unit="", disable=None if total else True, leave=True))
        shown[0].update(done - shown[0].n)
        if done >= total:
            shown[0].close()

    return progress


def load_files(files: Sequence[str]) -> tuple[list["Measured"], bool]:
    """What could be loaded, and whether that is all; the rest is said."""
    from torchbrdf.measured import load_all

    bad: list[DataError] = []
    groups = load_all(files, bad=bad)
    for error in bad:
        print(f"torchbrdf: left out: {error}", file=sys.stderr)
    return groups, not bad


def short(value: object) -> str:
    """A value in few characters: numbers to four digits, lists to six items."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        shown = [short(item) for item in value[:6]]
        return "(" + ", ".join(shown) + (", ..." if len(value) > 6 else "") + ")"
    return str(value)


def described(parser: argparse.ArgumentParser, description: str) -> argparse.ArgumentParser:
    """The parser with a description whose lines stay as they are."""
    parser.description = description
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    return parser
