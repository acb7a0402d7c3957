"""Changed files are accepted with values that can be, or refused in one line; and the fuzzing itself sees what is not.

The long form: `python -m tests.fuzzing --help`.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from fuzzing.campaign import tasks
from fuzzing.judge import ACCEPTED, LONGEST_MESSAGE, MOST_MEMORY, Outcome, judge
from fuzzing.readers import NAMES, Reader, readers
from fuzzing.sane import InsaneError, LaterError
from fuzzing.worker import Worker, made
from torchbrdf.errors import DataError

COUNT = 2000
SEED = 0


@pytest.fixture(scope="session")
def worker() -> Iterator[Worker]:
    with Worker() as found:
        yield found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def test_every_reader_is_listed() -> None:
    assert set(NAMES) == set(readers())


@pytest.mark.parametrize("name", NAMES)
def test_no_changed_file_is_met_with_anything_but_sense_or_one_line(name: str, worker: Worker) -> None:
    """The valid file is accepted; a failure says how the same input is made again."""
    faults = []
    for task in [task for task in tasks(COUNT, SEED) if task.reader == name]:
        found = worker.judge(task.reader, task.seed, task.number)
        if found.is_fault or (not task.number and found.kind != ACCEPTED):
            faults.append(f"python -m tests.fuzzing {task}: {found.kind}: {found.said}")
    assert not faults, "\n".join(faults)


def test_as_many_as_are_promised() -> None:
    assert COUNT <= len(tasks(COUNT + len(NAMES), SEED)) < COUNT + 2 * len(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_the_same_number_makes_the_same_input(name: str, folder: Path, tmp_path: Path) -> None:
    one = made(readers(), name, folder, 1, 2)
    (tmp_path / "valid").symlink_to(folder / "valid")  # made once: some of it holds the time
    other = made(readers(), name, tmp_path, 1, 2)
    assert one.name == other.name and _kind(one) == _kind(other)
    if one.is_file():
        assert one.read_bytes() == other.read_bytes()


def _kind(path: Path) -> tuple[bool, bool, bool]:
    return path.is_symlink(), path.is_dir(), path.is_file()


class SaidError(DataError):
    """Says what it is told to, as errors of the package cannot."""

    def __init__(self, said: str) -> None:
        super().__init__("x")
        self.said = said

    def __str__(self) -> str:
        return self.said


def refuse(said: str) -> None:
    raise SaidError(said)


def unnamed() -> None:
    raise LaterError(DataError("no file"))


def insane() -> None:
    raise InsaneError("nan")


def recurse() -> None:
    recurse()


def fill() -> None:
    assert len(bytearray(int(MOST_MEMORY) + (1 << 29)))


KINDS = {
    "accepted": lambda: None,
    "refused": lambda: refuse("/tmp/x.txt: expected text, found none"),
    "message": lambda: refuse("expected text, found none"),
    "insane": insane,
    "exception": lambda: {}["a"],
    "memory": fill,
}


def reader(use) -> Reader:
    return Reader("x", "x.txt", lambda folder: None, lambda path: use())


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_told(kind: str) -> None:
    assert judge(reader(KINDS[kind]), Path("x.txt")).kind == kind


@pytest.mark.parametrize("said", ["x.txt: a\nb", "x.txt: \x1b[31m", "x.txt: " + "a" * LONGEST_MESSAGE, ""])
def test_messages_are_judged(said: str) -> None:
    assert judge(reader(lambda: refuse(said)), Path("x.txt")).kind == "message"


def test_what_no_longer_knows_the_file_need_not_name_it() -> None:
    assert judge(reader(unnamed), Path("x.txt")) == Outcome("refused", "no file")


def test_even_the_deepest_exception_is_one() -> None:
    assert judge(reader(recurse), Path("x.txt")).kind == "exception"


@pytest.mark.parametrize("end", ["crash", "exit", "busy", "asleep"])
def test_a_process_that_ends_or_hangs_is_replaced(end: str) -> None:
    """The next input is judged all the same."""
    with Worker(seconds=1, patience=5.0, table="fuzzing.readers.that_end") as found:
        assert found.judge(end, 0, 0).kind == {"crash": "crash", "exit": "crash"}.get(end, "hang")
        assert found.judge("fine", 0, 0).kind == ACCEPTED
