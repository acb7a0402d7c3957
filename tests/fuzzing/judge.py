"""One input: how it is made from its number, and what came of it."""

import logging
import os
import resource
import shutil
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

from fuzzing.changes import Change
from fuzzing.changes.byte import BYTES, splice
from fuzzing.changes.of_files import FILES, renamed
from fuzzing.readers import Reader

LONGEST_MESSAGE = 300
LONGEST_WARNING = 1000
MOST_MEMORY = 1.5 * 2**30
"""Bytes that one input may need more than all before it; files that would unpack to more than 1 GiB are refused."""
ACCEPTED, REFUSED = "accepted", "refused"


@dataclass(frozen=True)
class Outcome:
    """What came of an input: accepted, refused, or a kind of fault; with the message."""

    kind: str
    said: str = ""

    @property
    def is_fault(self) -> bool:
        return self.kind not in (ACCEPTED, REFUSED)


def make_input(
    reader: Reader, valid: Path, folder: Path, seed: int, number: int, other: Callable[[Random], bytes]
) -> Path:
    """Changed files in a new folder, the same for the same seed and number; gives the path to read.

    Number 0 is the valid file; `other` gives that of another reader.
    """
    shutil.copytree(valid, folder)
    path = folder / reader.file
    if not number:
        return path
    source = Random(f"{seed}/{reader.name}/{number}")
    if reader.is_file and source.random() < 0.04:
        source.choice(FILES)(path)
        return path
    if reader.renamed and source.random() < 0.06:
        path = renamed(source, path)
        if source.random() < 0.5:
            return path
    data = path.read_bytes()
    for _ in range(source.choice((1, 1, 1, 2, 3))):
        data = changed(source, reader, data, other)
    path.write_bytes(data)
    return path


def changed(source: Random, reader: Reader, data: bytes, other: Callable[[Random], bytes]) -> bytes:
    """Bytes after one change that applies to them."""
    general: tuple[Change, ...] = BYTES if reader.is_file else reader.changes
    for _ in range(20):
        if reader.is_file and source.random() < 0.02:
            foreign = other(source)
            return foreign if source.random() < 0.5 else splice(source, data, foreign)
        change = source.choice(reader.changes if reader.changes and source.random() < 0.75 else general)
        try:
            return change(source, data)
        except ValueError:  # it does not apply to these
            continue
    return data + b"\0"


class _Warnings(logging.Handler):
    """Keeps what torchbrdf warns of."""

    def __init__(self) -> None:
        super().__init__()
        self.said: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.said.append(record.getMessage())


def judge(reader: Reader, path: Path) -> Outcome:
    """Read a file and say what came of it; a crash or a hang is for who waits."""
    from fuzzing.sane import InsaneError, LaterError
    from torchbrdf.errors import TorchbrdfError

    warned = _Warnings()
    log = logging.getLogger("torchbrdf")
    log.addHandler(warned)
    before = _peak()
    try:
        reader.use(path)
        found = Outcome(ACCEPTED)
    except InsaneError as error:
        found = Outcome("insane", str(error))
    except LaterError as error:
        found = _refusal(str(error), "")
    except TorchbrdfError as error:
        named = reader.named or ("fuzzed" if reader.renamed else path.name)
        found = _refusal(str(error), named)
    except BaseException as error:  # whatever it is, it is what is looked for
        found = Outcome("exception", f"{type(error).__name__} {_where(error)}: {error}"[:500])
    finally:
        log.removeHandler(warned)
    used = _peak() - before
    if used > MOST_MEMORY:
        return Outcome("memory", f"{used / 2**30:.1f} GiB; {found.kind} {found.said}"[:300])
    bad = [text for text in warned.said if not text.isprintable() or len(text) > LONGEST_WARNING]
    if bad and not found.is_fault:
        return Outcome("warning", repr(bad[0][:300]))
    return found


def _refusal(said: str, named: str) -> Outcome:
    if not said.isprintable():
        return Outcome("message", f"not one printable line: {said[:300]!r}")
    if len(said) > LONGEST_MESSAGE:
        return Outcome("message", f"{len(said)} characters: {said[:300]}")
    if named not in said:
        return Outcome("message", f"does not name {named}: {said}")
    return Outcome(REFUSED, said)


def _where(error: BaseException) -> str:
    """The deepest line of the package, and the deepest of all."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "torchbrdf" in Path(frame.filename).parts]
    places = [f"{Path(frame.filename).name}:{frame.lineno}" for frame in (own or frames)[-1:] + frames[-1:]]
    return " <- ".join(dict.fromkeys(places))


def _peak() -> int:
    """The most memory that this process had, in bytes."""
    found = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return found if sys.platform == "darwin" else found * 1024


def limit_time(seconds: int) -> None:
    """End this process, by SIGXCPU, when it has worked for so many seconds more, whatever else the machine does."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime) + 1 + seconds, hard))


def limit_memory() -> None:
    """Refuse this process twice the memory that an input may need, so that the machine does not run out of it."""
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = int(pages * os.sysconf("SC_PAGE_SIZE") + 2 * MOST_MEMORY)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def quiet(log: Path) -> None:
    """Send what libraries print to a file."""
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for standard in (1, 2):
        os.dup2(file, standard)
    os.close(file)
