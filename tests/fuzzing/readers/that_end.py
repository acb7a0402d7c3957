"""Readers that end their process, or do not end: what the fuzzing has to survive."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

from fuzzing.readers import Reader


def _make(folder: Path) -> None:
    (folder / "x.txt").write_text("x")


def _busy() -> None:
    while True:
        pass


USES: dict[str, Callable[[], object]] = {
    "crash": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "exit": lambda: os._exit(3),
    "busy": _busy,
    "asleep": lambda: time.sleep(60),
    "fine": lambda: None,
}


def readers() -> dict[str, Reader]:
    """By name, as `fuzzing.readers.readers` gives them."""
    return {name: _reader(name) for name in USES}


def _reader(name: str) -> Reader:
    return Reader(name, "x.txt", _make, lambda path: USES[name]())
