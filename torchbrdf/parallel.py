"""Map a function over items in threads or in processes, each on one core."""

import ctypes
import logging
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from functools import cache, partial
from itertools import islice
from types import TracebackType
from typing import TypeVar

import torch

from torchbrdf.errors import UsageError, shown
from torchbrdf.workers import WORKERS, CannotBeSentError, Lost, packed_function

Item = TypeVar("Item")
Result = TypeVar("Result")

__all__ = ["Lost", "process_map", "thread_map"]

VARIABLE = "TORCHBRDF_PROCESSES"
"""Of the environment: `always` or `never` in the place of the rule of `process_map`."""
# CPU seconds of work, done and foreseen, above which processes are started. Two threads take a third more of it than
# two processes, and a process takes 2.5 s to import torch and torchbrdf: so much work pays for two of them.
WORTH = 15.0
# Items that wait for a thread: more would only have to be looked through each time that one is done.
AHEAD = 16
THREADS = "torchbrdf: working in threads, as processes cannot be given the work: %s"

logger = logging.getLogger("torchbrdf")

_inside = threading.local()  # of a thread of a map: what it calls stays on it
_spent = 0.0  # CPU seconds of threads that were work for processes


def thread_map(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """`function` of every item, in their order, without gradients, on as many threads as torch may use.

    Each thread runs its own operations alone. torch would rather split every single operation over all threads and
    have them wait for each other at its end, which is slower for small operations, and many times slower on a machine
    that has something else to do. Who stops listening, by Ctrl-C too, stops the threads where they are.
    """
    yield from _in_threads(function, items, AHEAD)


def process_map(
    function: Callable[[Item], Result], items: Sequence[Item], rule: str | None = None
) -> Iterator[Result | Lost]:
    """As `thread_map`, in processes where that is quicker: threads of one process wait for Python's lock.

    For seconds of work on the CPU, of which a small result comes back. It is `thread_map` until this process has spent,
    or by the pace of the first items will spend, 15 CPU seconds on such work; then processes are started, which nothing
    waits for, and are kept for later calls.
    Function and items are pickled by cloudpickle. What is raised in a process is raised here, with its traceback there
    as the cause; an item whose process died twice gives `Lost`.

    It stays `thread_map` with one item or one thread, while another thread has the processes, in a process that may
    have no children, and for what cannot be pickled or takes too many bytes, which the log says. TORCHBRDF_PROCESSES in
    the environment, `always` or `never`, overrules the 15 seconds, and so does `rule`, which comes before it.

    Raises:
        RuntimeError: Processes die as they start.
        UsageError: TORCHBRDF_PROCESSES is something else.
    """
    rule = os.environ.get(VARIABLE, "") if rule is None else rule
    if rule not in ("", "always", "never"):
        raise UsageError(f"{VARIABLE}: expected always or never, found {shown(rule)}")
    count = min(torch.get_num_threads(), len(items))
    with WORKERS.reserved() if count > 1 and rule != "never" else nullcontext(False) as free:
        if not free:
            yield from thread_map(function, items)
            return
        left = iter(items)
        if rule != "always":
            yield from _in_threads(function, _until_processes(function, left, len(items), count), count)
        rest = list(left)
        given = 0
        try:
            for answer in WORKERS.map(function, rest, count) if rest else ():
                given += 1
                yield answer
        except CannotBeSentError as error:
            logger.info(THREADS, error)
            yield from thread_map(function, rest[given:])


def _until_processes(
    function: Callable[[Item], Result], items: Iterator[Item], total: int, count: int
) -> Iterator[Item]:
    """Items for threads until processes are ready, which start when there is work that makes them worth it."""
    global _spent
    began, tried, taken = time.perf_counter(), False, 0
    try:
        while not WORKERS.are_ready(count):
            # The first are taken in advance; each later one is taken when one is done, and others are half done.
            done = taken - 2 * count
            share = min(1, (done + count / 2) / total) if done > 0 else 1
            if not tried and _spent + count * (time.perf_counter() - began) / share > WORTH:
                tried = True
                try:
                    WORKERS.begin(count, packed_function(function))
                except CannotBeSentError as error:
                    logger.info(THREADS, error)
            try:
                item = next(items)
            except StopIteration:
                return
            taken += 1
            yield item
    finally:
        _spent += count * (time.perf_counter() - began)


class _StoppedError(BaseException):
    """Raised in threads whose answers nobody wants any more."""


class _Crew:
    """The threads that are at work, so that they can be stopped."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._members: set[int] = set()
        self._is_stopped = False

    def __enter__(self) -> None:
        with self._lock:
            if self._is_stopped:
                raise _StoppedError
            self._members.add(threading.get_ident())

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        with self._lock:
            self._members.discard(threading.get_ident())

    def stop(self) -> None:
        """Raise in each thread, between two of its operations."""
        with self._lock:
            self._is_stopped = True
            for thread in self._members:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(_StoppedError))


@cache
def _guard_forks() -> None:
    """Have forks of this process work on one thread: torch's threads are not there, and it would wait for them."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=partial(torch.set_num_threads, 1))


def _in_threads(function: Callable[[Item], Result], items: Iterable[Item], waiting: int) -> Iterator[Result]:
    """As `thread_map`; no more than `waiting` items wait for a thread. Within a thread of another map it is a loop."""
    if getattr(_inside, "map", False):
        yield from map(function, items)
        return
    threads, crew, left = torch.get_num_threads(), _Crew(), enumerate(items)
    running: dict[Future[Result], int] = {}
    done: dict[int, Future[Result]] = {}
    following = 0
    _guard_forks()

    def run(item: Item) -> Result:
        _inside.map = True  # the pool's threads are of this map only
        with crew, torch.no_grad():
            return function(item)

    pool = ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,))
    try:
        while True:
            for index, item in islice(left, max(threads + waiting - len(running), 0)):
                running[pool.submit(run, item)] = index
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                done[running.pop(future)] = future
            while following in done:
                yield done.pop(following).result()
                following += 1
    finally:
        crew.stop()
        pool.shutdown(cancel_futures=True)
        torch.set_num_threads(threads)  # the workers changed it for threads that start later
