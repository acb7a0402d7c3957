"""A process that judges inputs one after another, and is replaced when it crashes or hangs."""

import os
import shutil
import signal
import tempfile
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import TracebackType
from typing import Self

from fuzzing.judge import ACCEPTED, Outcome, judge, limit_memory, limit_time, make_input, quiet
from fuzzing.readers import Reader

SECONDS = 5
"""Of work that an input may take; of waiting, `PATIENCE`, which a busy machine needs."""
PATIENCE = 30.0
STARTING = 300.0
_READY = ("", 0, 0)
TABLE = "fuzzing.readers"
# Files of readers with a smaller share are too big to be read in the place of others.
BIG = 0.35


class Worker:
    """Judges inputs in a process of its own.

    Args:
        keep: Where inputs that were faults are kept; None: nowhere.
        seconds: Of work that an input may take.
        patience: Seconds that it may take in all.
        table: The module whose `readers()` are tried.
    """

    def __init__(
        self, keep: Path | None = None, seconds: int = SECONDS, patience: float = PATIENCE, table: str = TABLE
    ) -> None:
        self.keep, self.seconds, self.patience, self.table = keep, seconds, patience, table
        self.folder = Path(tempfile.mkdtemp(prefix="torchbrdf-fuzz-"))
        self._process = None
        self._pipe: Connection | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def judge(self, reader: str, seed: int, number: int) -> Outcome:
        """What came of an input; the process is ready for the next one after it, or is replaced."""
        if self._process is None:
            self._start()
        found = self._ask((reader, seed, number), self.patience)
        if found.is_fault and self.keep is not None and self._input.exists():
            kept = self.keep / f"{reader}-{seed}-{number}"
            shutil.rmtree(kept, ignore_errors=True)
            self.keep.mkdir(parents=True, exist_ok=True)
            shutil.copytree(self._input, kept, symlinks=True, ignore=_no_pipes)
        shutil.rmtree(self._input, ignore_errors=True)
        return found

    @property
    def _input(self) -> Path:
        return self.folder / "in"

    def _start(self) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self.folder, self.seconds, self.table), daemon=True)
        self._process.start()
        theirs.close()
        found = self._ask(_READY, STARTING)
        if found.is_fault:
            self.close()
            raise RuntimeError(f"the process does not start: {found.kind} {found.said}")

    def _ask(self, question: tuple[str, int, int], patience: float) -> Outcome:
        assert self._process is not None and self._pipe is not None
        self._pipe.send(question)
        if not wait([self._pipe, self._process.sentinel], patience):
            self._stop()
            return Outcome("hang", f"no end within {patience:g} s")
        try:
            return self._pipe.recv()
        except EOFError:
            self._process.join()
            code = self._process.exitcode
            self._stop()
            if code == -signal.SIGXCPU:
                return Outcome("hang", f"more than {self.seconds} s of work")
            return Outcome("crash", f"status {code}; {self._last_words()}")

    def _last_words(self) -> str:
        """The end of what the process printed."""
        said = (self.folder / "said.txt").read_text(errors="replace").split("\n")
        return " | ".join(said[-4:])[-300:]

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None

    def close(self) -> None:
        """End the process and remove its files."""
        self._stop()
        shutil.rmtree(self.folder, ignore_errors=True)


def _no_pipes(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if (Path(folder) / name).is_fifo()]


def _work(pipe: Connection, folder: Path, seconds: int, table: str) -> None:
    os.environ["OMP_NUM_THREADS"] = "1"
    quiet(folder / "said.txt")
    known: dict[str, Reader] = import_module(table).readers()
    import_module("fuzzing.sane")  # all of torch, which must not count as an input's work
    limit_memory()
    try:
        while True:
            name, seed, number = pipe.recv()
            pipe.send(_answer(known, name, folder, seed, number, seconds) if name else Outcome(ACCEPTED))
    except EOFError:  # nobody asks any more
        return


def _answer(known: dict[str, Reader], name: str, folder: Path, seed: int, number: int, seconds: int) -> Outcome:
    try:
        path = made(known, name, folder, seed, number)
    except Exception as error:  # the fault is in what makes the input, or in what writes a valid file
        return Outcome("broken", f"{type(error).__name__}: {error}")
    limit_time(seconds)
    try:
        return judge(known[name], path)
    finally:
        limit_time(3600)


def made(known: dict[str, Reader], name: str, folder: Path, seed: int, number: int) -> Path:
    """The file of an input in `folder/in`; valid files, from which it is made, are kept beside."""
    target = folder / "in"
    shutil.rmtree(target, ignore_errors=True)
    small = [one for one in known.values() if one.share > BIG]
    return make_input(
        known[name],
        _valid(known[name], folder),
        target,
        seed,
        number,
        lambda source: _file(source.choice(small), folder),
    )


def _file(reader: Reader, folder: Path) -> bytes:
    return (_valid(reader, folder) / reader.file).read_bytes()


def _valid(reader: Reader, folder: Path) -> Path:
    found = folder / "valid" / reader.name
    if not found.exists():
        making = found.with_name(f"{reader.name}-making")
        shutil.rmtree(making, ignore_errors=True)
        making.mkdir(parents=True)
        reader.make(making)
        making.rename(found)
    return found
