"""Colours in other primaries than those of ITU-R BT.709, which everything here is in."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown

# CIE x and y of red, green, blue and white, as headers of pictures have them.
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
BT2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)

# Where two matrices differ by less the primaries are the same, written with other digits.
_SAME = 1e-3
# Of a matrix between any two sets of primaries that are in use, the largest number is below 5.
_LARGEST = 20.0
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def to_rec709(path: Path | str, primaries: Sequence[float], neutral: Sequence[float] | None = None) -> np.ndarray:
    """The matrix from linear RGB in some primaries to linear RGB in those of ITU-R BT.709.

    White stays white: another one than D65 is adapted to it, as Bradford does. Of `XYZ` red, green and blue are
    tristimulus values, of which D65 is white; they are taken as they are.

    Args:
        path: What errors call the file.
        primaries: CIE x and y of red, green, blue and white, eight numbers.
        neutral: CIE x and y of what is to become white, if it is not the primaries' own white.

    Returns:
        `(3, 3)`, float64, for columns of red, green and blue; the identity where the primaries are those of BT.709.

    Raises:
        DataError: The numbers are no primaries.

    Source: SMPTE RP 177-1993; Bradford: ICC.1:2022, annex E.

    Example:
        >>> to_rec709("x.exr", REC709)[0].tolist()
        [1.0, 0.0, 0.0]
    """
    stored = _to_xyz(path, primaries)
    if neutral is None and not np.allclose(primaries, XYZ, atol=_SAME):
        neutral = primaries[6:]
    if neutral is not None:
        stored = _adaptation(_white(path, neutral), _white(path, REC709[6:])) @ stored
    matrix = np.linalg.solve(_to_xyz(path, REC709), stored)
    if not np.abs(matrix).max() < _LARGEST:
        raise DataError(f"{path}: expected chromaticities of primaries and a white, found {shown(tuple(primaries))}")
    return np.eye(3) if np.allclose(matrix, np.eye(3), rtol=0, atol=_SAME) else matrix


def luminance_weights(path: Path | str, primaries: Sequence[float]) -> np.ndarray:
    """What linear red, green and blue of some primaries count in luminance, `(3,)`; their sum is 1.

    Raises:
        DataError: The numbers are no primaries.
    """
    return _to_xyz(path, primaries)[1]


def converted(picture: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """A picture `(H, W, 3)`, float32, times a matrix. Pixels that are not finite stay: they have no colour."""
    if np.array_equal(matrix, np.eye(3)):
        return picture
    finite = np.isfinite(picture).all(-1, keepdims=True)
    return np.where(finite, np.where(finite, picture, 0) @ matrix.T.astype(np.float32), picture)


def _white(path: Path | str, place: Sequence[float]) -> np.ndarray:
    x, y = place
    if not (np.isfinite([x, y]).all() and 0 < x < 1 and 0 < y < 1):
        raise DataError(f"{path}: expected the chromaticity of a white, found {shown(tuple(place))}")
    return np.array([x, y, 1 - x - y]) / y


def _to_xyz(path: Path | str, primaries: Sequence[float]) -> np.ndarray:
    """The matrix from RGB to XYZ, where white has Y = 1."""
    white = _white(path, primaries[6:])
    places = np.array(primaries[:6], dtype=np.float64).reshape(3, 2)
    columns = np.column_stack([places, 1 - places.sum(1)]).T
    if not np.isfinite(columns).all() or not abs(np.linalg.det(columns)) > _SAME:
        raise DataError(f"{path}: expected chromaticities of three primaries, found {shown(tuple(primaries))}")
    return columns * np.linalg.solve(columns, white)


def _adaptation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Bradford's matrix from XYZ under one white to XYZ under another."""
    ratio = (_BRADFORD @ target) / (_BRADFORD @ source)
    return np.linalg.solve(_BRADFORD, ratio[:, None] * _BRADFORD)
