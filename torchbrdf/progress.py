"""How work says how far it is: everything that takes long calls `progress(done, total)`."""

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Called with how many things are done, and how many there are to do."""


def quiet(done: int, total: int) -> None:
    """A progress that shows nothing."""


def part_of(progress: Progress, before: int, whole: int) -> Progress:
    """The progress of one part of some work.

    Args:
        progress: That of all of it.
        before: How many things were done when the part begins.
        whole: How many there are in all.

    Returns:
        What the part calls with its own numbers.

    Example:
        >>> part_of(lambda done, total: print(done, "of", total), 10, 30)(1, 20)
        11 of 30
    """
    return lambda done, total: progress(before + done, whole)
