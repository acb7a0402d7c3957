"""Numbers between bounds, from text and from anywhere: what options and settings are checked with."""

import math

from torchbrdf.errors import UsageError, shown

SEEDS = (0, 2**63 - 1)
"""What every generator of torch and NumPy takes as a seed."""
WHOLE = (-(2**63), 2**63 - 1)
"""The bounds of a whole number that says none: what a tensor holds."""
FINITE = (-math.inf, math.inf)
"""The bounds of a number that says none; it is finite all the same."""
MOST_SHARES = 1_000_000
"""Jobs that a fit may be shared by."""


def whole(value: object, low: int = WHOLE[0], high: int = WHOLE[1]) -> int:
    """A whole number, given as such or as text.

    Args:
        value: the number.
        low: the least that it may be.
        high: the largest.

    Returns:
        The number.

    Raises:
        UsageError: it is none, or out of bounds.

    Example:
        >>> from torchbrdf.bounds import whole
        >>> whole("3", 1, 8)
        3
    """
    try:
        made = None if isinstance(value, bool | float) else int(value)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        made = None
    if made is None or not low <= made <= high:
        within = "" if (low, high) == WHOLE else f" from {low} to {high}"
        raise UsageError(f"expected a whole number{within}, found {shown(value, 40)}")
    return int(made)


def number(value: object, low: float = FINITE[0], high: float = FINITE[1]) -> float:
    """A finite number, given as such or as text.

    Args:
        value: the number.
        low: the least that it may be.
        high: the largest.

    Returns:
        The number.

    Raises:
        UsageError: it is none, not finite, or out of bounds.

    Example:
        >>> from torchbrdf.bounds import number
        >>> number("0.5", 0, 1)
        0.5
    """
    try:
        made = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        made = math.nan
    if not math.isfinite(made) or not low <= made <= high:
        within = " number" if (low, high) != FINITE else " finite number"
        within += "" if (low, high) == FINITE else f" from {low:g} to {high:g}"
        raise UsageError(f"expected a{within}, found {shown(value, 40)}")
    return made


def share(text: str) -> tuple[int, int]:
    """Which of how many shares, from what is written `3/8`.

    Args:
        text: What is written.

    Raises:
        UsageError: It is none.

    Example:
        >>> share("3/8")
        (3, 8)
    """
    first, _, second = text.partition("/")
    if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second) <= MOST_SHARES:
        return int(first), int(second)
    raise UsageError(f"--shard: expected I/N, such as 3/8, with I from 1 to N, found {shown(text)}")
