"""Processes that work for this one: kept between calls, ended with it, replaced when they die.

They are loky's: started by exec, so that neither threads, nor CUDA, nor the user's `__main__` gets into them, and given
functions and items by value (cloudpickle), so that lambdas and what a script or a notebook defines come along.
"""

import atexit
import hashlib
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from torchbrdf import memory

Item = TypeVar("Item")
Result = TypeVar("Result")

# Seconds after which idle workers end, which hold 160 MB each.
_IDLE = 300.0
# Seconds between two looks of a worker at whether its parent is there.
_WATCH = 0.2
# Bytes of a function, which goes with every item, and of an item.
LARGEST_FUNCTION, LARGEST_ITEM = 32 << 20, 256 << 20

logger = logging.getLogger("torchbrdf")


@dataclass(frozen=True)
class Lost:
    """Stands in the place of an answer: the process that worked on an item died, and the one that did it again too."""

    reason: str


class CannotBeSentError(Exception):
    """A function or an item cannot be pickled, or is too large to be."""


class Workers:
    """Worker processes, for one caller at a time, each on one core and without gradients.

    Whoever uses them holds `reserved`. An abrupt end of a map (an error, Ctrl-C, a closed iterator) kills them; the
    next one starts others.
    """

    def __init__(self) -> None:
        self._reserved = threading.Lock()
        self._executor: Any = None
        self._starting: list[Future[None]] = []
        self._used = 0.0
        self._owner = 0

    @contextmanager
    def reserved(self) -> Iterator[bool]:
        """Whether this caller has them: not while another does, nor where a process may have no children."""
        if multiprocessing.current_process().daemon or not self._reserved.acquire(blocking=False):
            yield False
            return
        try:
            yield True
        finally:
            self._reserved.release()

    def begin(self, count: int, call: bytes) -> None:
        """Start so many, if they do not run yet, without waiting for them.

        Args:
            count: How many.
            call: A function that they will be given, packed: they import what it needs.
        """
        if self._owner != os.getpid():  # a fork of the process whose workers they are
            self._executor, self._owner = None, os.getpid()
        idle = time.monotonic() - self._used > _IDLE / 2
        if self._executor is not None and (idle or len(self._starting) != count or self._are_broken()):
            self.kill()
        if self._executor is None:
            self._start(count, call)
        self._used = time.monotonic()

    def _start(self, count: int, call: bytes) -> None:
        from loky import ProcessPoolExecutor
        from loky.backend import get_context

        # loky would end a worker whose memory grows by 300 MB; tables are mapped, and grow it by more.
        environment = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e12"}
        with _without_ctrl_c():
            self._executor = ProcessPoolExecutor(
                count,
                context=get_context("loky"),
                timeout=_IDLE,
                initializer=end_with,
                initargs=(os.getpid(),),
                env=environment,
            )
            # As many as there are workers, which take seconds each to import what the function needs.
            self._starting = [self._executor.submit(_unpack, call) for _ in range(count)]

    def _are_broken(self) -> bool:
        return any(one.done() and one.exception() is not None for one in self._starting)

    def are_ready(self, count: int) -> bool:
        """Whether so many have been begun and have started."""
        return (
            self._executor is not None
            and self._owner == os.getpid()
            and len(self._starting) == count
            and all(one.done() for one in self._starting)
            and not self._are_broken()
            and time.monotonic() - self._used < _IDLE / 2
        )

    def wait(self) -> None:
        """Until they have started.

        Raises:
            RuntimeError: Some have not.
        """
        wait(self._starting)
        if self._are_broken():
            raise RuntimeError("worker processes end as they start: out of memory?")

    def kill(self) -> None:
        """End them at once, also those that are stopped."""
        executor, self._executor, self._starting = self._executor, None, []
        if executor is not None and self._owner == os.getpid():
            executor.shutdown(wait=True, kill_workers=True)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item], count: int) -> Iterator[Result | Lost]:
        """`function` of every item, in their order, in `count` workers.

        The items in work when a worker dies are done again, alone, so that it shows which of them it was; one whose
        worker dies then too is lost.

        Raises:
            CannotBeSentError: The function or the next item cannot be pickled here, or unpickled there.
            RuntimeError: Workers die as they start.
        """
        import cloudpickle

        call = packed_function(function)
        key = hashlib.sha256(call).digest()
        waiting, again = deque(enumerate(items)), deque[tuple[int, Item]]()
        running: dict[Future[bytes], tuple[int, Item]] = {}
        done: dict[int, Future[bytes] | Lost] = {}
        following = 0

        def submit_from(queue: deque[tuple[int, Item]]) -> bool:
            """Whether the first of a queue could be given to a worker: not after the death of one."""
            data = packed(queue[0][1], LARGEST_ITEM)
            try:
                with _without_ctrl_c():  # it may start a worker in the place of one that was idle for long
                    running[self._executor.submit(work, key, call, data, settings(count))] = queue[0]
            except BrokenProcessPool:
                return False
            queue.popleft()
            return True

        try:
            self.begin(count, call)
            while waiting or again or running:
                alone = bool(again) and not running
                if alone:
                    submit_from(again)
                while waiting and not alone and not again and len(running) < count and submit_from(waiting):
                    pass
                if not running:
                    self._replace(count, call, "given to another")
                    continue
                finished = wait(running, return_when=FIRST_COMPLETED).done
                if any(_is_broken(future) for future in finished):
                    finished = wait(running).done  # loky gives up all of them
                    self._replace(count, call, "lost" if alone else "done again")
                for future in finished:
                    entry = running.pop(future)
                    if not _is_broken(future):
                        done[entry[0]] = future
                    elif alone:
                        done[entry[0]] = Lost("its worker process ended twice without an answer: out of memory?")
                    else:
                        again.append(entry)
                while following in done:
                    answer = done.pop(following)
                    yield answer if isinstance(answer, Lost) else cloudpickle.loads(answer.result())
                    following += 1
        except CannotBeSentError:
            wait(running)
            running.clear()
            done.clear()
            raise
        finally:
            self._used = time.monotonic()
            if running or done:
                self.kill()

    def _replace(self, count: int, call: bytes, fate: str) -> None:
        """Start others in the place of workers that died, and wait until they have started."""
        logger.warning("torchbrdf: a worker process died; its work is %s", fate)
        self.kill()
        self.begin(count, call)
        self.wait()


def _is_broken(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Processes that are started within never see Ctrl-C, which a terminal sends to all: their parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def settings(count: int) -> tuple[Any, ...]:
    """What one of `count` workers has to know, so that it computes what this process would, in its share of memory."""
    import torch

    gib = max(memory.limit() / 2**30 / count, memory.LEAST)
    return torch.get_default_dtype(), torch.get_default_device(), torch.get_float32_matmul_precision(), gib


def packed_function(function: object) -> bytes:
    """A function as bytes that go with every item.

    Raises:
        CannotBeSentError: It cannot be pickled, or is too large.
    """
    return packed(function, LARGEST_FUNCTION)


def packed(value: object, largest: int) -> bytes:
    """A value as bytes.

    Raises:
        CannotBeSentError: It cannot be pickled, or takes more than so many bytes.
    """
    import cloudpickle

    try:
        data: bytes = cloudpickle.dumps(value)
    except Exception as error:  # whatever somebody's __reduce__ raises
        raise CannotBeSentError(f"{type(error).__name__}: {error}") from error
    if len(data) > largest:
        raise CannotBeSentError(f"it takes {len(data) >> 20} MiB")
    return data


WORKERS = Workers()
"""Those of this process. They end before its threads are waited for, which loky's does: one may be stopped."""
getattr(threading, "_register_atexit", atexit.register)(WORKERS.kill)


# What follows runs in a worker.

_function: tuple[bytes, Callable[[Any], Any]] = (b"", int)


def end_with(parent: int) -> None:
    """End with the parent, however it ends, also while torch is being imported."""
    threading.Thread(target=_watch, args=(parent,), name="torchbrdf-parent", daemon=True).start()


def _watch(parent: int) -> None:
    if os.name == "posix":
        while os.getppid() == parent:
            time.sleep(_WATCH)
    else:
        import psutil

        with suppress(psutil.NoSuchProcess):
            psutil.Process(parent).wait()
    os._exit(1)


def _unpack(call: bytes) -> None:
    """Import what a function needs, by unpickling it; whether that can be done is seen when it is called."""
    with suppress(CannotBeSentError):
        _unpacked(call)


def _unpacked(data: bytes) -> Any:
    import cloudpickle

    try:
        return cloudpickle.loads(data)
    except Exception as error:  # a module that is not on this process's path, or whatever __setstate__ raises
        raise CannotBeSentError(f"{type(error).__name__}: {error}") from error


def work(key: bytes, call: bytes, item: bytes, told: tuple[Any, ...]) -> bytes:
    """A function of an item; both, and the answer, pickled, so that no tensor goes by shared memory."""
    import cloudpickle
    import torch

    global _function
    known = _function  # of this thread, while another may change it
    if known[0] != key:
        _function = known = key, _unpacked(call)
    dtype, device, precision, gib = told
    torch.set_default_dtype(dtype)
    torch.set_default_device(device)
    torch.set_float32_matmul_precision(precision)
    torch.set_num_threads(1)
    with memory.limited(gib), torch.no_grad():
        answer: bytes = cloudpickle.dumps(known[1](_unpacked(item)))
    return answer
