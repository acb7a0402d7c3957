"""Two cores for many small steps."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

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
