"""What the commands share."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from torchbrdf import bounds, memory
from torchbrdf.errors import LONGEST_MESSAGE, DataError, UsageError, one_line, printable, shown
from torchbrdf.kinds import BANDS, check_word

if TYPE_CHECKING:
    from torchbrdf.measured import Measured

# What names of the zoo begin with, which are no files; `lobes.zoo` has them, and is not imported for this.
ZOO = "zoo:"
Options = argparse.Namespace
Commands = Any
"""What argparse adds commands to; its type has no public name."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, and whose words may stand behind options, too.

    `words` is the argument, of nargs "*" or "+", that takes words behind options; argparse itself takes only those that
    stand together.
    """

    words: str = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """As argparse, but what is left over is an error here, of the command that it was given to."""
        found, rest = super().parse_known_args(args, namespace)
        wrong = [word for word in rest if not self.words or (word.startswith("-") and word != "-")]
        if wrong:
            self.error(f"unknown option or word {shown(wrong[0])}")
        if rest:
            setattr(found, self.words, [*getattr(found, self.words), *rest])
        return found, []

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, and exit with 2."""
        said = one_line(f"{self.prog}: {message.removeprefix('argument ')}", LONGEST_MESSAGE - len(self.prog) - 14)
        self.exit(2, f"{said}; see {self.prog} --help\n")


def whole(low: int, high: int) -> Callable[[str], int]:
    """The type of an option that is a whole number from `low` to `high`.

    Example:
        >>> whole(1, 8)("3")
        3
    """

    def convert(text: str) -> int:
        try:
            return bounds.whole(text, low, high)
        except UsageError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return convert


def number(low: float, high: float) -> Callable[[str], float]:
    """The type of an option that is a finite number from `low` to `high`.

    Example:
        >>> number(0, 1)("0.5")
        0.5
    """

    def convert(text: str) -> float:
        try:
            return bounds.number(text, low, high)
        except UsageError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return convert


def add_memory(parser: argparse.ArgumentParser) -> None:
    """Add the option of commands that draw."""
    said = (
        f"GiB that pictures and what is kept for them may take, {memory.LEAST:g} or more (default {memory.DEFAULT:g})"
    )
    kind = number(memory.LEAST, memory.MOST)
    parser.add_argument("--memory", type=kind, default=memory.DEFAULT, metavar="GIB", help=said)


def add_backend(parser: argparse.ArgumentParser) -> None:
    """Add the option of commands whose pictures are first rasterised."""
    said = "what finds the triangle of each pixel: software, pyrender (OpenGL), or auto (default): the faster one here"
    parser.add_argument("--backend", default="auto", help=said)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """The option for what files do not say."""
    parser.add_argument(
        "--read",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="what files do not say: angles=degrees or radians, illuminant=D65 (default) or E, quantity=brdf, "
        "brdf_cosine or reflectance_factor; may come again",
    )


def add_bands(parser: argparse.ArgumentParser) -> None:
    """The option for what becomes of bands of wavelengths."""
    said = "bands of wavelengths: rgb (default), made linear RGB by the CIE 1931 observer; keep, as they are"
    parser.add_argument("--bands", default="rgb", help=said)


def read_settings(options: Options) -> dict[str, str]:
    """What `--read` and `--bands` say, by name."""
    found = {}
    for text in options.read:
        name, mark, value = text.partition("=")
        if not mark:
            raise UsageError(f"--read: expected NAME=VALUE, found {shown(text)}")
        if name == "bands":
            raise UsageError("--read: expected angles, illuminant or quantity, found bands: fit and info have --bands")
        found[name] = value
    bands = getattr(options, "bands", BANDS[0])
    check_word("--bands", bands, BANDS)
    return found if bands == BANDS[0] else {**found, "bands": bands}


def check_files(files: Sequence[str]) -> None:
    """Refuse files of which none is there, before torch is imported; what is wrong with some is said later.

    Raises:
        DataError: Names the first.
    """
    if files and not any(file.startswith(ZOO) or os.path.lexists(file) for file in files):
        rest = f", nor any of {len(files) - 1} others" if len(files) > 1 else ""
        raise DataError(f"{shown(files[0])[1:-1] or 'an empty path'}: no such file or folder{rest}")


def load_files(files: Sequence[str], settings: dict[str, str] | None = None) -> tuple[list["Measured"], bool]:
    """What could be loaded, and whether that is all; the rest is said."""
    from torchbrdf.measured import load_all

    bad: list[DataError] = []
    groups = load_all(files, bad=bad, settings=settings)
    for error in bad:
        print(f"torchbrdf: left out: {error}", file=sys.stderr)
    return groups, not bad


def say(*texts: object, to: TextIO | None = None) -> None:
    """Print lines; what a terminal would take for a command, such as in the name of a file, is written out."""
    for text in texts:
        print(printable(str(text)), file=to)


def short(value: object) -> str:
    """A value in few characters: numbers to four digits, lists to six items."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        shown = [short(item) for item in value[:6]]
        return "(" + ", ".join(shown) + (", ..." if len(value) > 6 else "") + ")"
    return str(value)


def described(parser: Parser, description: str, words: str = "") -> Parser:
    """The parser with a description whose lines stay as they are; `words` as `Parser` has it."""
    parser.description, parser.words = description, words
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    return parser
