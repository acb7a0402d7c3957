"""What a path may be other than the file that was meant."""

import os
from collections.abc import Callable
from pathlib import Path
from random import Random


def missing(path: Path) -> None:
    """No such file."""
    path.unlink()


def folder(path: Path) -> None:
    """A folder."""
    path.unlink()
    path.mkdir()


def fifo(path: Path) -> None:
    """A pipe, which nobody writes into."""
    path.unlink()
    os.mkfifo(path)


def dangling(path: Path) -> None:
    """A link to nothing."""
    path.unlink()
    path.symlink_to("nothing")


def loop(path: Path) -> None:
    """A link to itself."""
    path.unlink()
    path.symlink_to(path.name)


def endless(path: Path) -> None:
    """A link to a device that never ends."""
    path.unlink()
    path.symlink_to("/dev/zero")


def null(path: Path) -> None:
    """A link to a device that is empty."""
    path.unlink()
    path.symlink_to(os.devnull)


def closed(path: Path) -> None:
    """A file that nobody may read, but who may read everything."""
    path.chmod(0)


def link(path: Path) -> None:
    """A link to the file, which is as good as it."""
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


FILES: tuple[Callable[[Path], None], ...] = (missing, folder, fifo, dangling, loop, endless, null, closed, link)

STEMS = (
    "fuzzed a b", "fuzzed\nb", "\x1b[31mfuzzed", "fuzzed$\\bad{", "=fuzzed", "-fuzzed", "fuzzed..", "..fuzzed",
    "fuzzed\udce9",
    "fuzzed\u202egnp", "fuzzedé日本", "fuzzed" + "x" * 180, "fuzzed,b", 'fuzzed"', "fuzzed'", "fuzzed<img>",
    "fuzzed%s{0}", "fuzzed\\b",
)  # fmt: skip
"""Names that a file may have on Linux; each holds "fuzzed", which messages have to say."""


def renamed(source: Random, path: Path) -> Path:
    """The same file under an odd name."""
    return path.rename(path.with_name(source.choice(STEMS) + path.suffix))
