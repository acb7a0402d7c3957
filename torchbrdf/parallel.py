"""Two cores for many small steps."""

import ctypes
import multiprocessing
import pickle
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, TypeVar, cast

import torch

Item = TypeVar("Item")
Result = TypeVar("Result")


def each(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """`function` of every item, in their order, without gradients, on as many threads as torch may use.

    Each thread runs its own operations alone. torch would rather split every single operation over all threads and
    have them wait for each other at its end, which is slower for small operations, and many times slower on a machine
    that has something else to do.
    """
    threads = torch.get_num_threads()

    def run(item: Item) -> Result:
        with torch.no_grad():
            return function(item)

    try:
        with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            yield from pool.map(run, items)
    finally:
        torch.set_num_threads(threads)  # the workers changed it for threads that start later


def each_apart(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """As `each`, in processes where that is possible: threads of one process wait for Python's lock at every operation.

    For seconds of work on the CPU, of which a small result comes back (it is pickled). The processes are forks, as
    those of torch's DataLoader are, so that nothing has to be sent to them; without fork, with a GPU in use or with
    one item, it is `each`.
    """
    count = min(torch.get_num_threads(), len(items))
    if count < 2 or not sys.platform.startswith("linux") or torch.cuda.is_initialized():
        yield from each(function, items)
        return
    _release_buffers()()
    context = multiprocessing.get_context("fork")
    idle: list[Connection] = []
    workers = []
    try:
        for _ in range(count):
            here, there = context.Pipe()
            worker = context.Process(target=_serve, args=(function, items, there), daemon=True)
            with warnings.catch_warnings():
                # Python 3.12 warns of threads at a fork; the child uses nothing that they may hold.
                warnings.simplefilter("ignore", DeprecationWarning)
                worker.start()
            there.close()
            workers.append(worker)
            idle.append(here)
        yield from _share_out(idle, len(items))
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()


@cache
def _release_buffers() -> Callable[[], object]:
    """What has MKL give back the buffers of all threads.

    Where threads that are gone have left some, a forked process waits in MKL's allocator for ever.
    """
    path = Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"
    if torch.backends.mkl.is_available() and path.exists():
        return getattr(ctypes.CDLL(str(path)), "mkl_serv_free_buffers", int)
    return int  # no MKL, nothing to do


def _serve(function: Callable[[Item], Result], items: Sequence[Item], parent: Connection) -> None:
    """In a worker process: do the items that the parent names, until it is gone."""
    torch.set_num_threads(1)
    while True:
        try:
            index = parent.recv()
        except EOFError:
            return
        try:
            with torch.no_grad():
                answer = pickle.dumps((True, function(items[index])))
        except Exception as error:
            answer = pickle.dumps((False, error))
        parent.send_bytes(answer)


def _share_out(idle: list[Connection], count: int) -> Iterator[Any]:
    """Give each idle worker the next item, and yield the answers in the items' order."""
    busy: dict[Connection, int] = {}
    answers: dict[int, Any] = {}
    given = yielded = 0
    while yielded < count:
        while idle and given < count:
            worker = idle.pop(0)
            worker.send(given)
            busy[worker] = given
            given += 1
        for worker in cast(list[Connection], wait(list(busy))):
            try:
                fine, answer = pickle.loads(worker.recv_bytes())
            except EOFError:
                raise RuntimeError("a worker process ended without an answer: out of memory?") from None
            if not fine:
                raise answer
            answers[busy.pop(worker)] = answer
            idle.append(worker)
        while yielded in answers:
            yield answers.pop(yielded)
            yielded += 1
