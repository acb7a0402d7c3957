"""How the command line is ended by signals: as by Ctrl-C, and in two seconds whatever it does."""

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

# Seconds from a signal to the end, where a long call of a library keeps Python from hearing of it.
GRACE = 1.5
# Seconds from one look whether an import has ended to the next.
LOOK = 0.02


class EndedError(KeyboardInterrupt):
    """What a signal raises in the main thread.

    Args:
        number: Of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def ending(grace: float | None = GRACE) -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP raise an `EndedError` within; a second signal ends the process at once.

    Where a module is being imported, the process ends at once instead, or after the import if a file is being written:
    an exception would leave half a module, or be lost, and what comes next would fail in its own ways.

    Signals that are ignored, as by nohup, stay so. Outside the main thread nothing is changed.

    Args:
        grace: Seconds until the process is ended in any case; None: never.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = ("SIGINT", "SIGTERM", "SIGHUP")
    numbers = [number for name in names if (number := getattr(signal, name, None))]
    before = {number: signal.getsignal(number) for number in numbers}
    heard = [number for number, handler in before.items() if handler not in (signal.SIG_IGN, None)]

    def end(number: int, frame: FrameType | None) -> None:
        if _importing(frame):
            if not _writing():
                _end_now(number)
            _thread.start_new_thread(_raise_again, (number,))  # threading's own locks may be held here
            return
        for other in heard:
            signal.signal(other, signal.SIG_DFL)
        raise EndedError(number)

    for number in heard:
        signal.signal(number, end)
    try:
        with _no_later_than(grace, heard):
            yield
    finally:
        for number in heard:
            signal.signal(number, before[number])


@contextmanager
def _no_later_than(grace: float | None, numbers: list[int]) -> Iterator[None]:
    """End the process so long after a signal, unless the block ends before: a thread hears of signals at once."""
    if grace is None:
        yield
        return
    import socket  # here, where signals are heard already

    heard, told = socket.socketpair()
    told.setblocking(False)
    over = threading.Event()

    def listen() -> None:
        while (found := heard.recv(1)) and found[0] not in numbers:
            pass
        if found and not over.wait(grace):
            _end_now(found[0])

    before = signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
    listener = threading.Thread(target=listen, name="torchbrdf-signals", daemon=True)
    listener.start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        told.close()
        listener.join()
        heard.close()


def _importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported where a signal came."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib._bootstrap"):
            return True
        frame = frame.f_back
    return False


def _writing() -> bool:
    """Whether there is a file or a lock to be removed; what writes them may not be imported yet, or half."""
    is_writing = getattr(sys.modules.get("torchbrdf.files"), "is_writing", None)
    return is_writing is not None and is_writing()


def _raise_again(number: int) -> None:
    time.sleep(LOOK)
    signal.raise_signal(number)


def _end_now(number: int) -> NoReturn:
    """End the process, wherever it is, with nothing of Python's that could fail there."""
    try:
        os.write(2, b"torchbrdf: stopped\n")
    finally:
        os._exit(128 + number)
