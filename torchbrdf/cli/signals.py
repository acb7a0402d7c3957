"""How the command line is ended by signals: as by Ctrl-C, and in two seconds whatever it does."""

import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Seconds from a signal to the end, where a long call of a library keeps Python from hearing of it.
GRACE = 1.5


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

    Those that are ignored, as by nohup, stay so. Outside the main thread nothing is changed.

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
    heard, told = socket.socketpair()
    told.setblocking(False)
    over = threading.Event()

    def listen() -> None:
        while (found := heard.recv(1)) and found[0] not in numbers:
            pass
        if found and not over.wait(grace):
            os._exit(128 + found[0])

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
