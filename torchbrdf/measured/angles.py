"""Angles of directions as files give them: in which unit, and what they are as pairs of directions."""

import math
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError
from torchbrdf.measured.notices import notice

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
    other = " (are they degrees? a setting, angles=degrees, says so)" if own == "radians" else ""
    if not largest <= half[own] * (1 + _TOLERANCE):
        raise DataError(
            f"{path}: expected angles from the normal up to {half[own]:.4g} {own}, found {largest:.6g}{other}"
        )
    if not turned <= 4 * half[own] * (1 + _TOLERANCE):
        raise DataError(f"{path}: expected azimuths up to {2 * half[own]:.4g} {own}, found {turned:.6g}{other}")
    if unit != "auto":
        said = own
    elif own == "degrees":
        said = f"degrees (the file does not say; one of {largest:.4g} from the normal cannot be radians)"
    else:
        said = f"radians (the file does not say; the largest from the normal is {largest:.4g})"
    doubt = _doubt(largest, turned, own, unit == "auto")
    if doubt:
        notice(path, f"angles: {doubt}")
        said = f"{said}; {doubt}"
    return (math.pi / 180 if own == "degrees" else 1.0), said


def _doubt(largest: float, turned: float, unit: str, is_guessed: bool) -> str:
    """What makes it likely that angles taken for degrees are radians, all or azimuths only; "" where nothing does."""
    if unit == "radians" or not 0 < turned <= 2 * math.pi + _TOLERANCE:
        return ""
    if not is_guessed and 0 < largest <= math.pi / 2 + _TOLERANCE:
        return f"taken for degrees, as said, but none from the normal is above {largest:.4g}: they may be radians"
    if largest > math.pi / 2 and turned > 3:
        return f"taken for degrees, but no azimuth is above {turned:.4g}: azimuths may be radians"
    return ""


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
