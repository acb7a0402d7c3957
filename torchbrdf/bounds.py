"""Numbers between bounds, from text and from anywhere: what options and settings are checked with."""

import math

from torchbrdf.errors import UsageError

SEEDS = (0, 2**63 - 1)
"""What every generator of torch and NumPy takes as a seed."""


def whole(value: object, low: int, high: int) -> int:
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
        number = None if isinstance(value, bool | float) else int(value)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        number = None
    if number is None or not low <= number <= high:
        raise UsageError(f"expected a whole number from {low} to {high}, found {found(value)}")
    return int(number)


def number(value: object, low: float, high: float) -> float:
    """A finite number, given as such or as text: as `whole`.

    Example:
        >>> from torchbrdf.bounds import number
        >>> number("0.5", 0, 1)
        0.5
    """
    try:
        found_number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        found_number = math.nan
    if not low <= found_number <= high or math.isinf(found_number):
        raise UsageError(f"expected a number from {low:g} to {high:g}, found {found(value)}")
    return found_number


def found(value: object, most: int = 40) -> str:
    """What was found, as a message shows it: in one line, and shortened.

    Example:
        >>> from torchbrdf.bounds import found
        >>> found("9" * 60)
        "'9999999999999999999999999999999999999...'"
    """
    try:
        text = str(value)
    except ValueError:  # Python refuses to write whole numbers of thousands of digits
        text = f"a number of {type(value).__name__}"
    return repr(text if len(text) <= most else text[: most - 3] + "...")
