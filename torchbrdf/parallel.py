"""Map a function over items in threads or in processes, each on one core."""

import ctypes
import logging
import multiprocessing
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import torch

Item = TypeVar("Item")
Result = TypeVar("Result")


def thread_map(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
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


def process_map(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """As `thread_map`, in processes where that is possible: threads of one process wait for Python's lock.

    For seconds of work on the CPU, of which a small result comes back (it is pickled). The processes are forks, as
    those of torch's DataLoader are, so that nothing has to be sent to them. What is raised in one is raised here, with
    its traceback there as the cause. Without fork, with CUDA in use, which a fork cannot share, or with one item or
    one thread, it is `thread_map`; with CUDA the log says so.

    Raises:
        RuntimeError: A process ended without an answer, as it does when memory runs out.
    """
    count = min(torch.get_num_threads(), len(items))
    if count < 2 or not sys.platform.startswith("linux") or _is_cuda_in_use():
        yield from thread_map(function, items)
        return
    _release_buffers()()
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(count, context, initializer=_start, initargs=(function, items))
    try:
        with warnings.catch_warnings():
            # Python 3.12 warns of threads at a fork; the child uses nothing that they may hold.
            warnings.simplefilter("ignore", DeprecationWarning)
            answers = pool.map(_run, range(len(items)))
        yield from answers
    except BrokenProcessPool:
        raise RuntimeError("a worker process ended without an answer: out of memory?") from None
    finally:
        pool.shutdown(cancel_futures=True)


def _is_cuda_in_use() -> bool:
    if not torch.cuda.is_initialized():
        return False
    logging.getLogger("torchbrdf").info("torchbrdf: CUDA is in use, which processes cannot share; working in threads")
    return True


@cache
def _release_buffers() -> Callable[[], object]:
    """What has MKL give back the buffers of all threads.

    Where threads that are gone have left some, a forked process waits in MKL's allocator for ever.
    """
    path = Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"
    if torch.backends.mkl.is_available() and path.exists():
        return getattr(ctypes.CDLL(str(path)), "mkl_serv_free_buffers", int)
    return int  # no MKL, nothing to do


# In a worker process: the function and the items, which came with the fork and so need not be picklable.
_work: tuple[Callable[[Any], Any], Sequence[Any]]


def _start(function: Callable[[Item], Result], items: Sequence[Item]) -> None:
    global _work
    _work = function, items
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)


def _run(index: int) -> Any:
    function, items = _work
    return function(items[index])
