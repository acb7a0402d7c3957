"""What is said of files while they are read; nothing of those that we wrote ourselves and only read back."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

log = logging.getLogger("torchbrdf")
_silent: ContextVar[bool] = ContextVar("silent", default=False)


def notice(path: Path | str, said: str) -> None:
    """Warn of something about a file, unless it is one of ours.

    Args:
        path: The file.
        said: What there is to say.
    """
    if not _silent.get():
        log.warning("torchbrdf: %s: %s", path, said)


@contextmanager
def own_files() -> Iterator[None]:
    """Files that are read within are those that were just written: what there is to say was said of what they hold.

    Example:
        >>> with own_files():
        ...     notice("part", "repeated directions")
    """
    token = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(token)
