"""Angles of directions as files give them: in which unit, and what they are as pairs of directions."""

import math
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError

UNITS = ("auto", "radians", "degrees")
# Of rounding in a file.
_TOLERANCE = 1e-3


def in_radians(path: Path, polar: np.ndarray, azimuth: np.ndarray, unit: str) -> tuple[float, str]:
    """What angles are multiplied by to be in radians, and how that is known, in words.

    Args:
        path: The file, for errors.
        polar: Angles from the normal, as the file has them.
        azimuth: Angles about it.
        unit: "radians" or "degrees", as the file or the user says; "auto" where nobody does: radians, unless an angle
            from the normal is too large for that.

    Raises:
        DataError: No angle from the normal may be as large as one of these.
    """
    largest = float(np.abs(polar).max(initial=0))
    turned = float(np.abs(azimuth).max(initial=0))
    half = {"radians": math.pi, "degrees": 180.0}
    own = unit if unit != "auto" else "radians" if largest <= math.pi + _TOLERANCE else "degrees"
    if not largest <= half[own] * (1 + _TOLERANCE):
        raise DataError(f"{path}: expected angles from the normal up to {half[own]:.4g} {own}, found {largest:.6g}")
    if not turned <= 4 * half[own] * (1 + _TOLERANCE):
        raise DataError(f"{path}: expected azimuths up to {2 * half[own]:.4g} {own}, found {turned:.6g}")
    if unit != "auto":
        said = own
    elif own == "degrees":
        said = f"degrees (the file does not say; one of {largest:.4g} from the normal cannot be radians)"
    else:
        said = f"radians (the file does not say; the largest from the normal is {largest:.4g})"
    return (math.pi / 180 if own == "degrees" else 1.0), said


def direction(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Unit vectors of angles in radians, `(..., 3)`; an angle below 0 is one on the other side.

    Example:
        >>> import numpy as np
        >>> from torchbrdf.measured.angles import direction
        >>> direction(np.array(-np.pi / 2), np.array(0.5)).round(2).tolist()
        [-0.88, -0.48, 0.0]
    """
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar) + 0 * azimuth], -1)


def of_direction(direction: np.ndarray) -> np.ndarray:
    """The angle from the normal and the azimuth of vectors `(..., 3)`, radians, `(..., 2)`.

    Example:
        >>> import numpy as np
        >>> from torchbrdf.measured.angles import of_direction
        >>> of_direction(np.array([0.0, 1.0, 0.0])).round(2).tolist()
        [1.57, 1.57]
    """
    x, y, z = np.moveaxis(direction, -1, 0)
    return np.stack([np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)], -1)
