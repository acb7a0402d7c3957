"""How much memory pictures may take: what is kept of light transports, and what is drawn at a time."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from torchbrdf import bounds
from torchbrdf.errors import UsageError

DEFAULT, LEAST, MOST = 2.0, 0.01, 65536.0
"""In GiB: the limit where none is set, and what it may be."""

_lock = threading.Lock()
_gib: list[float] = [DEFAULT]


def limit() -> int:
    """The bytes that transports and pictures in work may take together, each of both half of it."""
    return int(_gib[-1] * 2**30)


@contextmanager
def limited(gib: float | None) -> Iterator[None]:
    """Let pictures take so much memory within: `torchbrdf render --memory` for one's own code.

    It bounds what is kept of the transports of scenes, and the blocks of pictures that are drawn at a time; the tables
    themselves, torch and the finished pictures come beside. A transport that is larger than half of the limit is not
    kept, but made anew in parts for each block: slower, and the same pictures. It is one limit for all threads, and
    worker processes share it evenly.

    Args:
        gib: In GiB, 0.01 to 65536; None leaves it as it is.

    Raises:
        UsageError: It is none.

    Example:
        >>> from torchbrdf import memory
        >>> with memory.limited(0.5):
        ...     memory.limit() == 2**29
        True
    """
    if gib is None:
        yield
        return
    try:
        value = bounds.number(gib, LEAST, MOST)
    except UsageError as error:
        raise UsageError(f"memory: {error} (GiB)") from None
    with _lock:
        _gib.append(value)
    try:
        yield
    finally:
        with _lock:
            _gib.remove(value)
