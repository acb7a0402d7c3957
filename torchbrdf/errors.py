"""What torchbrdf raises: every message says what, where, expected and found, in one line; and so does the log."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

# So that a message fits into a terminal's few lines whatever a file holds.
LONGEST_MESSAGE = 300
LONGEST_WARNING = 1000


class TorchbrdfError(Exception):
    """Base of everything that torchbrdf raises on purpose; the command line prints it without a traceback.

    A message is made one line of printable characters, and at most `LONGEST_MESSAGE` of them.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message)))


class ShapeError(TorchbrdfError, ValueError):
    """Tensors whose shapes, dtypes or contents do not fit together."""


class DataError(TorchbrdfError, ValueError):
    """A file or a folder that does not hold what it should."""


class UsageError(TorchbrdfError, ValueError):
    """A name, an option or a setting that does not exist or has a wrong type."""


def one_line(text: str, longest: int = LONGEST_MESSAGE) -> str:
    r"""Text as one line of printable characters, shortened in its middle.

    Args:
        text: What to say.
        longest: How many characters it may have.

    Example:
        >>> from torchbrdf.errors import one_line
        >>> one_line("red\x1b[31m\n  next line"), one_line("0123456789", 8)
        ('red\\x1b[31m next line', '01 ... 9')
    """
    line = printable(" ".join(text.split()))
    if len(line) <= longest:
        return line
    # The start says where, the end what was found.
    tail = (longest - 5) // 3
    return f"{line[: longest - 5 - tail]} ... {line[len(line) - tail :]}"


def printable(text: str) -> str:
    r"""Text with escapes in the place of characters that are not to be seen.

    Args:
        text: Anything.

    Example:
        >>> from torchbrdf.errors import printable
        >>> printable("red\x1b[31m")
        'red\\x1b[31m'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shown(value: object, longest: int = 60) -> str:
    """What was found, as an error says it: its repr in one short line.

    Args:
        value: Anything, also what a file held.
        longest: How many characters it may have.

    Example:
        >>> from torchbrdf.errors import shown
        >>> shown("nickel"), len(shown(list(range(1000))))
        ("'nickel'", 60)
    """
    if isinstance(value, str | bytes):
        value = value[: 2 * longest]  # a repr of all of it could take long
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # nested without end; a whole number of too many digits
        text = type(value).__name__
    return one_line(text, longest)


def _in_one_line(record: logging.LogRecord) -> bool:
    """Keep what a file or its name says from writing lines, or to the terminal, through the log."""
    record.msg, record.args = one_line(record.getMessage(), LONGEST_WARNING), ()
    return True


logging.getLogger("torchbrdf").addFilter(_in_one_line)


@contextmanager
def said_once() -> Iterator[None]:
    """Within, the log says the same line once.

    Example:
        >>> with said_once():
        ...     logging.getLogger("torchbrdf").warning("twice")
        ...     logging.getLogger("torchbrdf").warning("twice")
    """
    said: set[str] = set()

    def not_yet(record: logging.LogRecord) -> bool:
        line = one_line(record.getMessage(), LONGEST_WARNING)
        is_new = line not in said
        said.add(line)
        return is_new

    logger = logging.getLogger("torchbrdf")
    logger.addFilter(not_yet)
    try:
        yield
    finally:
        logger.removeFilter(not_yet)
