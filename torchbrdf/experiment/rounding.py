"""Numbers of bundled files in few digits."""

from typing import Any


def rounded(value: Any, digits: int) -> Any:
    """A value with all numbers in it, in lists and dictionaries too, to so many significant digits.

    Args:
        value: plain values, as JSON has them.
        digits: of each float; whole numbers stay.

    Example:
        >>> rounded({"specular": [0.123456, 2]}, 3)
        {'specular': [0.123, 2]}
    """
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, list):
        return [rounded(item, digits) for item in value]
    if isinstance(value, dict):
        return {key: rounded(item, digits) for key, item in value.items()}
    return value
