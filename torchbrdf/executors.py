"""Work side by side: in threads or processes of this one, or on any `concurrent.futures.Executor`, such as Dask's."""

import builtins
import hashlib
import importlib.util
import logging
import os
import subprocess
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import torch

from torchbrdf import workers
from torchbrdf.errors import DataError, TorchbrdfError, UsageError, one_line, shown
from torchbrdf.parallel import Lost, process_map
from torchbrdf.workers import LARGEST_ITEM, CannotBeSentError, packed, packed_function

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item")
Result = TypeVar("Result")
Place = Executor | Literal["threads", "processes"] | None
"""Where work is done; None: in threads, and from 15 CPU seconds on in processes."""
# Items of each worker that are on their way, so that none waits for the next one.
AHEAD = 3
# Seconds between two looks at who is there to work, and until a scheduler has to have answered.
LOOK, PATIENCE = 5.0, 10.0
# A worker of Dask's that ends with its parent, however it ends.
_WORKER = """import sys
from torchbrdf.workers import end_with

end_with(int(sys.argv.pop(1)))
from distributed.cli.dask_worker import main

main()
"""

logger = logging.getLogger("torchbrdf")


def side_by_side(
    function: Callable[[Item], Result], items: Sequence[Item], place: Place = None
) -> Iterator[tuple[int, Result | Lost]]:
    """`function` of every item, each on one core and without gradients, and which item it is, as they are done.

    Args:
        function: Of an item; both are pickled by cloudpickle where they leave this process.
        items: What it is called with.
        place: Where.

    Yields:
        The index of an item, and the answer; `Lost`, where the process that worked on it died again and again.

    Raises:
        DataError: The executor, or its scheduler, is gone.

    Example:
        >>> from concurrent.futures import ThreadPoolExecutor
        >>> with ThreadPoolExecutor(2) as executor:
        ...     sorted(side_by_side(lambda k: k * k, [1, 2, 3], executor))
        [(0, 1), (1, 4), (2, 9)]
    """
    if isinstance(place, Executor):
        try:
            yield from _on(place, function, items)
        except CannotBeSentError as error:
            raise UsageError(f"executor: the work cannot be given to another process ({error})") from error
        return
    if place not in (None, "threads", "processes"):
        raise UsageError(f"executor: expected an Executor, threads, processes or None, found {shown(place)}")
    yield from enumerate(process_map(function, items, {"threads": "never", "processes": "always"}.get(place or "")))


def _on(executor: Executor, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[tuple[int, Any]]:
    """As `side_by_side`, on somebody's executor."""
    import cloudpickle

    threads = torch.get_num_threads()
    call = packed_function(function)
    key = hashlib.sha256(call).digest()
    guests = _Guests(executor)
    waiting = ((index, packed(item, LARGEST_ITEM)) for index, item in enumerate(items))
    running: dict[Future[Any], tuple[int, bytes]] = {}
    again: list[tuple[int, bytes]] = []
    left = len(items)
    try:
        while left:
            while again or len(running) < AHEAD * guests.count:
                entry = again.pop() if again else next(waiting, None)
                if entry is None:
                    break
                index, data = entry
                running[guests.submit(key, call, data)] = index, data
            done = wait(running, LOOK, FIRST_COMPLETED).done
            guests.look(bool(done))
            for future in done:
                index, data = running.pop(future)
                answer = guests.answer(future)
                if answer is None:
                    again.append((index, data))
                    continue
                left -= 1
                yield index, answer if isinstance(answer, Lost) else cloudpickle.loads(answer)
    finally:
        for future in running:
            future.cancel()
        torch.set_num_threads(threads)  # threads of the executor changed it for those that start later


class _Guests:
    """Those who work for an executor: how many they are, and which of them have no torchbrdf, or another one."""

    def __init__(self, executor: Executor) -> None:
        self.executor = executor
        self.client: Client | None = getattr(executor, "_client", None)
        self.unfit: set[str] = set()
        self._said = False

    @property
    def addresses(self) -> list[str]:
        """Of Dask's workers now: some may be gone, others have come."""
        return [] if self.client is None else list(self.client.scheduler_info(n_workers=-1).get("workers", ()))

    @property
    def count(self) -> int:
        """How many can work at once."""
        if self.client is not None:
            there = self.client.scheduler_info(n_workers=-1).get("workers", {})
            return max(sum(one["nthreads"] for name, one in there.items() if name not in self.unfit), 1)
        return int(getattr(self.executor, "_max_workers", 0)) or torch.get_num_threads()

    def submit(self, key: bytes, call: bytes, data: bytes) -> Future[Any]:
        """Have one of them do an item."""
        own: dict[str, Any] = {}
        if self.client is not None:
            own["pure"] = False
            if self.unfit:
                own["workers"] = [one for one in self.addresses if one not in self.unfit]
                if not own["workers"]:
                    raise DataError(f"{self._name}: expected workers with this torchbrdf, found none")
        work = packed((key, call, data, workers.settings(torch.get_num_threads())), 2 * LARGEST_ITEM)
        try:
            done_by: Any = _in_any_process if self.client is None else _guest
            return self.executor.submit(done_by, _versions(), work, **own)
        except (RuntimeError, OSError) as error:  # shut down; dead; a client that was closed
            raise self._gone(error) from error

    def answer(self, future: Future[Any]) -> Any:
        """The answer, packed; None: it is to be asked of another."""
        try:
            answer = future.result()
        except TorchbrdfError:
            raise
        except (BrokenExecutor, CancelledError, OSError) as error:
            raise self._gone(error) from error
        except Exception as error:
            if type(error).__name__ == "KilledWorker":  # Dask's, after the death of several that worked on it
                return Lost("its worker process ended again and again without an answer: out of memory?")
            raise
        if isinstance(answer, bytes):
            return answer
        address, reason = answer
        if not address:
            raise DataError(f"executor: {reason}")
        if address not in self.unfit:
            logger.warning("torchbrdf: worker %s: %s; it is left out", address, reason)
        self.unfit.add(address)
        return None

    def look(self, moved: bool) -> None:
        """Say once that nobody is there to work."""
        if moved:
            self._said = False
        elif self.client is not None and not self._said and not self.addresses:
            logger.warning("torchbrdf: %s: no worker is there; waiting for one", self._name)
            self._said = True

    @property
    def _name(self) -> str:
        if self.client is None:
            return type(self.executor).__name__
        return str(self.client.scheduler.addr if self.client.scheduler else "the scheduler")

    def _gone(self, error: BaseException) -> DataError:
        said = one_line(str(error), 80)
        found = f"{type(error).__name__}{f': {said}' if said else ''}"
        rest = "what is written is kept: run it again to go on"
        return DataError(f"{self._name}: the executor is gone ({found}); {rest}")


def _versions() -> tuple[str, str]:
    from torchbrdf import __version__

    return __version__, torch.__version__


def _in_any_process(versions: tuple[str, str], work: bytes) -> Any:
    """An item where torchbrdf may be missing: who it is and why not, if it cannot be done."""
    import pickle

    try:
        import torch

        import torchbrdf

        there = (torchbrdf.__version__, torch.__version__)
        if there == versions:
            from torchbrdf import workers

            return workers.work(*pickle.loads(work))
        found = "found torchbrdf {} and torch {}".format(*there)
    except ImportError as error:
        found = f"found {error}"
    try:
        from distributed import get_worker

        address = get_worker().address
    except (ImportError, ValueError):
        address = ""
    return address, "expected torchbrdf {} and torch {}, ".format(*versions) + found


# Dask pickles it by value, as the functions of a script: a worker without torchbrdf can say so.
_guest = types.FunctionType(_in_any_process.__code__, {"__builtins__": builtins, "__name__": "__main__"}, "_guest")
_guest.__module__ = "__main__"


@contextmanager
def executor_of(name: str | None, scheduler: str | None = None) -> Iterator[Place]:
    """What a command's options `--executor` and `--scheduler` name.

    Args:
        name: One of `torchbrdf.kinds.EXECUTORS`; None: the default.
        scheduler: Of Dask, such as `tcp://login:8786`; by default a cluster of processes on this machine.

    Raises:
        UsageError: It needs an extra that is not installed.
        DataError: No scheduler answers.
    """
    if name == "dask":
        if importlib.util.find_spec("distributed") is None:
            raise UsageError("--executor dask: expected the extra: pip install 'torchbrdf[dask]'")
        with _dask(scheduler) as executor:
            yield executor
        return
    yield name  # type: ignore[misc]  # one of its two names


@contextmanager
def _dask(scheduler: str | None) -> Iterator[Executor]:
    from distributed import Client, LocalCluster

    for part in ("distributed", "distributed.client", "tornado", "asyncio"):  # which print pages about who is gone
        logging.getLogger(part).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        if scheduler is None:
            scheduler = stack.enter_context(_workers_here(LocalCluster))
        try:
            client = stack.enter_context(Client(scheduler, timeout=PATIENCE))
        except (OSError, ValueError, TypeError) as error:
            reason = one_line(str(error), 120)
            raise DataError(f"{scheduler}: expected a Dask scheduler, found none ({reason})") from None
        yield client.get_executor(pure=False)


@contextmanager
def _workers_here(cluster: Any) -> Iterator[str]:
    """The address of a scheduler in this process, with a worker for each core.

    They are programs of their own: those that Dask starts import the user's `__main__`, which may fit again.
    """
    own = {"n_workers": 0, "processes": False, "dashboard_address": "127.0.0.1:0", "silence_logs": logging.CRITICAL}
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    with cluster(**own, protocol="tcp://", host="127.0.0.1") as made:
        command = [sys.executable, "-c", _WORKER, str(os.getpid()), made.scheduler_address, "--nthreads", "1"]
        command += ["--no-nanny", "--no-dashboard", "--memory-limit", "0", "--death-timeout", "60"]
        workers = [
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
            for _ in range(torch.get_num_threads())
        ]
        try:
            yield made.scheduler_address
        finally:
            for worker in workers:
                worker.terminate()
            for worker in workers:
                worker.wait()
