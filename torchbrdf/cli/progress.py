"""How a command says how far it is: bars on a terminal, elsewhere a line every ten seconds."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from torchbrdf.progress import Progress, quiet

# Between two lines, and before the first: shorter work says nothing.
SECONDS = 10.0


class Stages:
    """A command's work, one stage after the other, in words.

    Args:
        clock: Seconds, such as those of `time.monotonic`.

    Example:
        >>> now = [0.0]
        >>> stages = Stages(lambda: now[0])
        >>> stages.tell("fits", 0, 4)
        >>> now[0] = 20.0
        >>> stages.tell("fits", 1, 4)
        >>> stages.line()
        'fits: 25 % done, 1 min left'
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._label, self._done, self._total, self._first = "", 0, 0, 0
        self._began = self._told = clock()

    def tell(self, label: str, done: int, total: int) -> None:
        """Say that of a stage so many things are done, of so many."""
        now = self._clock()
        if label != self._label or done < self._done or total != self._total:
            # What was done before, as by an earlier run, says nothing of how long the rest takes.
            self._label, self._total, self._first, self._began = label, total, done, now
        self._done, self._told = done, now

    def line(self) -> str:
        """Stage, share done and time left; or for how long there has been nothing to say."""
        now = self._clock()
        if not self._label:
            return f"starting, {duration(now - self._began)} so far"
        if self._done >= self._total:
            return f"{self._label}: done; what follows has taken {duration(now - self._told)} so far"
        share = f"{self._label}: {100 * self._done // self._total} % done"
        if self._done == self._first:
            return f"{share}, {duration(now - self._began)} so far"
        each = (self._told - self._began) / (self._done - self._first)
        left = each * (self._total - self._done) - (now - self._told)
        if left <= 0:  # what is left takes longer than what is done did, nobody knows how long
            return f"{share}, slower now, {duration(now - self._told)} since the last"
        return f"{share}, {duration(left)} left"


def duration(seconds: float) -> str:
    """A time for people, to a few percent.

    Example:
        >>> duration(9.6), duration(80), duration(600), duration(4000)
        ('10 s', '1 min 20 s', '10 min', '1 h 7 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 10:
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    hours, minutes = divmod(round(whole / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def _is_terminal() -> bool:
    """Whether somebody may see a bar; stderr may be closed, or none."""
    with suppress(ValueError, AttributeError):
        return sys.stderr.isatty()
    return False


# Of the command that is at work, where lines are said.
_stages: list[Stages] = []


@contextmanager
def reporting() -> Iterator[None]:
    """Say every ten seconds how far the work within is, where stderr is no terminal, by what `progress_bar` is told."""
    if _is_terminal():
        yield
        return
    stages, over = Stages(), threading.Event()

    def report() -> None:
        while not over.wait(SECONDS):
            with suppress(OSError, ValueError, AttributeError):  # nobody reads it, or it is closed
                sys.stderr.write(f"torchbrdf: {stages.line()}\n")
                sys.stderr.flush()

    thread = threading.Thread(target=report, name="torchbrdf-progress", daemon=True)
    _stages.append(stages)
    thread.start()
    try:
        yield
    finally:
        _stages.remove(stages)
        over.set()
        thread.join()


def progress_bar(label: str) -> Progress:
    """A progress bar on a terminal, elsewhere lines; nothing where there is nothing to do."""
    if not _is_terminal():
        return partial(_stages[-1].tell, label) if _stages else quiet
    from tqdm import tqdm

    shown: list[tqdm[Any]] = []

    def progress(done: int, total: int) -> None:
        if not shown:
            shown.append(tqdm(total=total, desc=label, unit="", disable=None if total else True, leave=True))
        shown[0].update(done - shown[0].n)
        if done >= total:
            shown[0].close()

    return progress
