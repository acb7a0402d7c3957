"""The long form: many inputs, in a process a core, with what came of them."""

import argparse
import os
import sys
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from fuzzing.judge import Outcome
from fuzzing.readers import NAMES, readers
from fuzzing.worker import Worker

DESCRIPTION = """\
Read changed files with every reader. What is right: the file is accepted with values that can be, or refused in one
line of at most 300 characters that names it. Anything else is a fault: another exception, a crash, more than 5 s of
work, more than 1.5 GiB, values that cannot be, a bad message.

  python -m tests.fuzzing --count 20000
  python -m tests.fuzzing --reader exr --seed 3 --number 17 --keep out/faults
"""


@dataclass(frozen=True)
class Task:
    """An input: of a reader, by a seed and a number."""

    reader: str
    seed: int
    number: int

    def __str__(self) -> str:
        return f"--reader {self.reader} --seed {self.seed} --number {self.number}"


def tasks(count: int, seed: int, names: Sequence[str] = NAMES) -> list[Task]:
    """About `count` inputs, for each reader as many as its share, the valid file among them."""
    known = readers()
    whole = sum(known[name].share for name in names)
    return [Task(name, seed, k) for name in names for k in range(max(2, round(count * known[name].share / whole)))]


def outcomes(given: Sequence[Task], processes: int, keep: Path | None) -> Iterator[tuple[Task, Outcome]]:
    """What came of each, as they are judged."""
    own = threading.local()
    workers: list[Worker] = []

    def judge(task: Task) -> tuple[Task, Outcome]:
        if not hasattr(own, "worker"):
            own.worker = Worker(keep)
            workers.append(own.worker)
        return task, own.worker.judge(task.reader, task.seed, task.number)

    try:
        with ThreadPoolExecutor(processes) as pool:
            yield from pool.map(judge, given)
    finally:
        for worker in workers:
            worker.close()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; 1 where there was a fault."""
    parser = argparse.ArgumentParser(
        "python -m tests.fuzzing", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=20_000, help="inputs (default 20000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", nargs="+", default=NAMES, choices=NAMES, metavar="NAME", help=", ".join(NAMES))
    parser.add_argument("--number", type=int, help="this input only")
    parser.add_argument("--keep", type=Path, help="a folder for inputs that were faults")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    given = tasks(options.count, options.seed, options.reader)
    if options.number is not None:
        given = [Task(name, options.seed, options.number) for name in options.reader]
    found: dict[str, Counter[str]] = {name: Counter() for name in options.reader}
    faults = 0
    for task, outcome in tqdm(outcomes(given, options.processes, options.keep), total=len(given), disable=None):
        found[task.reader][outcome.kind] += 1
        if outcome.is_fault or options.number is not None:
            tqdm.write(
                f"{outcome.kind}: {task}: {outcome.said.encode('ascii', 'backslashreplace').decode()}", sys.stdout
            )
        faults += outcome.is_fault
    print(table(found))
    return int(faults > 0)


def table(found: dict[str, Counter[str]]) -> str:
    """Counts, a line a reader."""
    kinds = ["accepted", "refused"]
    kinds += sorted({kind for counts in found.values() for kind in counts} - set(kinds))
    every = {**found, "all": sum(found.values(), Counter())}
    rows = [["reader", *kinds], *([name, *(str(counts[kind]) for kind in kinds)] for name, counts in every.items())]
    return "\n".join("".join(f"{cell:>12s}" for cell in row) for row in rows)
