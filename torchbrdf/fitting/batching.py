"""Materials in batches, each worked on by one core."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from functools import partial
from typing import TypeVar

import torch

from torchbrdf.executors import side_by_side
from torchbrdf.measured import Measured
from torchbrdf.parallel import Lost, process_map, thread_map

# Pairs times materials that a thread holds at a time, at about 30 bytes each; the work on them is done in small parts.
MEMORY = 16_000_000
# The same on a GPU, where one batch at a time is best.
GPU_MEMORY = 400_000_000
# Pairs times materials above which processes are worth their start.
PROCESS_THRESHOLD = 500_000

Result = TypeVar("Result")


def material_batches(measured: Measured, pairs: int) -> Iterator[list[int]]:
    """Materials in batches: as many for each thread, and no more than the memory budget allows.

    pairs: how many the work on a material holds.
    """
    materials, pairs = len(measured), max(pairs, 1)
    if measured.device.type == "cuda":
        size = max(1, GPU_MEMORY // pairs)
    else:
        threads = torch.get_num_threads()
        rounds = max(1, -(-materials // (max(1, MEMORY // pairs) * threads)))
        size = max(1, -(-materials // (rounds * threads)))
    for first in range(0, materials, size):
        yield list(range(first, min(first + size, materials)))


def parallel_map(
    function: Callable[[list[int], Measured], Result],
    measured: Measured,
    pairs: int | None = None,
    executor: Executor | None = None,
) -> Iterator[tuple[list[int], Result | Lost]]:
    """`function` of batches of materials, their indices and what was measured of them, on all cores.

    pairs: how many the work on a material holds; by default all of its own. executor: in the place of this machine's
    threads and processes.
    """
    pairs = len(measured.pairs) if pairs is None else pairs
    batches = list(material_batches(measured, pairs))
    large = len(measured) * pairs > PROCESS_THRESHOLD and measured.device.type == "cpu"
    parts, work = [(rows, measured.batch(rows)) for rows in batches], partial(_apply, function)
    if executor is None:
        yield from zip(batches, (process_map if large else thread_map)(work, parts), strict=True)
        return
    done = dict(side_by_side(work, parts, executor))
    yield from ((rows, done[k]) for k, rows in enumerate(batches))


def _apply(function: Callable[[list[int], Measured], Result], batch: tuple[list[int], Measured]) -> Result:
    rows, part = batch
    return function(rows, part.batch())  # a view of its own: what it has read goes when the function ends
