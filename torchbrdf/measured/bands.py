"""Colours of what was measured in bands of wavelengths: CIE 1931 and linear RGB with the primaries of ITU-R BT.709."""

import re
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from torchbrdf.color import LUMINANCE
from torchbrdf.errors import DataError, ShapeError, shown
from torchbrdf.kinds import BANDS as BANDS
from torchbrdf.registry import unknown

Illuminant = Literal["D65", "E"]
ILLUMINANTS: tuple[str, ...] = get_args(Illuminant)
DEFAULT_ILLUMINANT = "D65"

RGB, KEEP = BANDS
"""What may become of bands: linear RGB, or what they are."""

VISIBLE = (380.0, 780.0)
"""Wavelengths, in nm, that colours are sums over."""
SHORTEST, LONGEST = 10.0, 1e6
"""No wavelength of a reflectance, in nm, is as short, or as long: such numbers are micrometres or metres."""
_STEP = 5.0
# What columns of values are called.
_PRIMARIES = (("r", "g", "b"), ("red", "green", "blue"))
_BAND = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*(?:nm)?")
# Spectral power at 380, 390, ..., 780 nm. Source: CIE 015:2018, Colorimetry, table 1.
_D65 = (
    49.9755, 54.6482, 82.7549, 91.4860, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861, 115.923, 108.811,
    109.354, 107.802, 104.790, 107.689, 104.405, 104.046, 100.000, 96.3342, 95.7880, 88.6856, 90.0062, 89.5991,
    87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778, 78.2842, 69.7213, 71.6091, 74.3490, 61.6040, 69.8856,
    75.0870, 63.5927, 46.4182, 66.8054, 63.3828,
)  # fmt: skip
# Of linear RGB with the primaries of ITU-R BT.709, from CIE XYZ: IEC 61966-2-1.
_RGB_OF_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
# Lobes of the colour matching functions: height, middle, and the inverse widths below and above it, in nm.
_LOBES = (
    ((0.362, 442.0, 0.0624, 0.0374), (1.056, 599.8, 0.0264, 0.0323), (-0.065, 501.1, 0.0490, 0.0382)),
    ((0.821, 568.8, 0.0213, 0.0247), (0.286, 530.9, 0.0613, 0.0322)),
    ((1.217, 437.0, 0.0845, 0.0278), (0.681, 459.0, 0.0385, 0.0725)),
)


def color_matching(wavelength: np.ndarray) -> np.ndarray:
    """The colour matching functions of the CIE 1931 standard observer, by a fit of Gaussian lobes.

    Args:
        wavelength: In nm, of any shape `(...)`.

    Returns:
        x, y and z, `(..., 3)`, off from the tables by less than 1 % of their peaks, as a root mean square.

    Source: C. Wyman, P.-P. Sloan, P. Shirley, Simple Analytic Approximations to the CIE XYZ Color Matching Functions,
    2013, Journal of Computer Graphics Techniques 2 (2), the fit of several lobes.

    Example:
        >>> import numpy as np
        >>> from torchbrdf.measured.bands import color_matching
        >>> color_matching(np.array(555.0)).round(2).tolist()
        [0.52, 1.0, 0.01]
    """
    wavelength = np.asarray(wavelength, dtype=np.float64)

    def lobe(height: float, middle: float, below: float, above: float) -> np.ndarray:
        place = (wavelength - middle) * np.where(wavelength < middle, below, above)
        found: np.ndarray = height * np.exp(-place * place / 2)
        return found

    return np.stack([np.sum([lobe(*one) for one in lobes], 0) for lobes in _LOBES], -1)


def checked_wavelengths(wavelengths: Sequence[float], channels: int) -> tuple[float, ...]:
    """Wavelengths that are some: finite numbers above 10 that grow, one for each of so many channels.

    Args:
        wavelengths: Of the bands, nm.
        channels: How many there must be.

    Raises:
        ShapeError: They are not.

    Example:
        >>> from torchbrdf.measured.bands import checked_wavelengths
        >>> checked_wavelengths([465, 525, 630], 3)
        (465.0, 525.0, 630.0)
    """
    try:
        found = tuple(map(float, wavelengths))
    except (TypeError, ValueError):
        raise ShapeError(f"wavelengths: expected {channels} numbers, in nm, found {shown(wavelengths)}") from None
    if len(found) != channels:
        raise ShapeError(f"wavelengths: expected {channels}, one for each channel, found {len(found)}")
    if not all(SHORTEST < one < other for one, other in zip(found, (*found[1:], LONGEST), strict=True)):
        raise ShapeError(f"wavelengths: expected numbers that grow, in nm, found {shown(found)}")
    return found


def columns_of_bands(names: Sequence[str]) -> tuple[list[int], list[float] | None] | None:
    """Which columns of a table are bands, by the names of all, in the order of their wavelengths.

    They are red, green and blue, `r`, `g`, `b` in any order; or wavelengths, such as `465nm`; or one column of any
    other name, grey.

    Args:
        names: Of the columns of values, in lower case.

    Returns:
        The columns' places in their order, and their wavelengths, nm; None in the place of these for linear RGB and
        grey. None for names of neither kind.

    Example:
        >>> from torchbrdf.measured.bands import columns_of_bands
        >>> columns_of_bands(["630nm", "465 nm"]), columns_of_bands(["b", "g", "r"]), columns_of_bands(["x", "y"])
        (([1, 0], [465.0, 630.0]), ([2, 1, 0], None), None)
    """
    for primaries in _PRIMARIES:
        if sorted(names) == sorted(primaries):
            return [list(names).index(name) for name in primaries], None
    found = [_BAND.fullmatch(name) for name in names]
    if names and all(found):
        by_length = sorted((float(one[1]), k) for k, one in enumerate(found) if one)
        lengths = [length for length, _ in by_length]
        if len(set(lengths)) == len(lengths) and lengths[0] > SHORTEST and lengths[-1] < LONGEST:
            return [k for _, k in by_length], lengths
    return ([0], None) if len(names) == 1 else None


def rgb_weights(wavelengths: Sequence[float], illuminant: str = DEFAULT_ILLUMINANT) -> np.ndarray:
    """What each band counts in linear red, green and blue.

    Between bands reflectance is linear, and beyond the first and the last one it is as it is there. What reflects
    all wavelengths alike is white: (1, 1, 1) under either illuminant. One band, or bands of which none is visible,
    make grey: their mean.

    Args:
        wavelengths: Of the bands, in nm, growing, W.
        illuminant: "D65", daylight, or "E", equal power at all wavelengths.

    Returns:
        `(W, 3)`; values in bands, times this, are linear RGB with the primaries of ITU-R BT.709.

    Raises:
        ShapeError: The wavelengths do not grow.
        UsageError: There is no such illuminant.

    Example:
        >>> from torchbrdf.measured.bands import rgb_weights
        >>> rgb_weights([465, 525, 630]).sum(0).round(6).tolist()
        [1.0, 1.0, 1.0]
    """
    if illuminant not in ILLUMINANTS:
        raise unknown("illuminant", illuminant, ILLUMINANTS)
    bands = np.asarray(wavelengths, dtype=np.float64)
    if bands.ndim != 1 or not len(bands) or not (np.diff(bands) > 0).all():
        raise ShapeError(f"bands: expected wavelengths that grow, found {[*wavelengths][:8]}")
    if is_grey(wavelengths):
        return np.full((len(bands), 3), 1 / len(bands))
    grid = np.arange(VISIBLE[0], VISIBLE[1] + _STEP / 2, _STEP)
    power = np.interp(grid, np.linspace(*VISIBLE, len(_D65)), _D65) if illuminant == "D65" else np.ones_like(grid)
    seen = color_matching(grid) * power[:, None] @ _RGB_OF_XYZ.T
    shares = np.stack([np.interp(grid, bands, unit) for unit in np.eye(len(bands))])
    weights = shares @ seen
    found: np.ndarray = weights / weights.sum(0)
    return found


def luminance_shares(wavelengths: Sequence[float], illuminant: str = DEFAULT_ILLUMINANT) -> tuple[float, ...]:
    """What each band counts in luminance; bands without colour count alike.

    Args:
        wavelengths: Of the bands, in nm, growing.
        illuminant: As of `rgb_weights`.

    Example:
        >>> from torchbrdf.measured.bands import luminance_shares
        >>> [round(share, 3) for share in luminance_shares([465, 525, 630])]
        [0.079, 0.577, 0.344]
    """
    found = np.clip(rgb_weights(wavelengths, illuminant) @ np.array(LUMINANCE), 0, None)  # Y, but for rounding
    return tuple((found / found.sum()).tolist())


def bands_in_words(channels: int, wavelengths: Sequence[float] | None) -> str:
    """What channels are that are not linear RGB.

    Example:
        >>> from torchbrdf.measured.bands import bands_in_words
        >>> bands_in_words(31, range(400, 710, 10)), bands_in_words(2, None)
        ('31 bands from 400 to 700 nm', '2 bands whose wavelengths nobody said')
    """
    if channels == 3 and wavelengths is None:
        return "linear RGB"
    count = "1 band" if channels == 1 else f"{channels} bands"
    if wavelengths is None:
        return f"{count} whose wavelength{'s' * (channels > 1)} nobody said"
    if channels <= 4:
        return f"{count} of {', '.join(f'{one:g}' for one in wavelengths)} nm"
    return f"{count} from {wavelengths[0]:g} to {wavelengths[-1]:g} nm"


def check_same_bands(paths: Sequence[object], bands: Sequence[tuple[int, Sequence[float] | None]]) -> None:
    """Refuse files of one format whose bands differ, which cannot be one measurement.

    Args:
        paths: The files.
        bands: Of each how many channels, and their wavelengths.

    Raises:
        DataError: Names the first that differs.
    """
    for path, own in zip(paths, bands, strict=True):
        if own != bands[0]:
            first, other = bands_in_words(*bands[0]), bands_in_words(*own)
            raise DataError(f"{path}: expected {first}, as {paths[0]} has, found {other}; read it alone, or as RGB")


def is_grey(wavelengths: Sequence[float]) -> bool:
    """Whether bands have no colour: one band alone, or none that is visible.

    Example:
        >>> from torchbrdf.measured.bands import is_grey
        >>> is_grey([650.0]), is_grey([465, 525, 630])
        (True, False)
    """
    return len(wavelengths) < 2 or not any(VISIBLE[0] <= one <= VISIBLE[1] for one in wavelengths)


def colors_label(wavelengths: Sequence[float], illuminant: str = DEFAULT_ILLUMINANT) -> str:
    """How bands became colours, in words.

    Example:
        >>> from torchbrdf.measured.bands import colors_label
        >>> colors_label([650.0])
        'grey: one band alone'
    """
    if len(wavelengths) < 2:
        return "grey: one band alone"
    if is_grey(wavelengths):
        return f"grey: the mean of {len(wavelengths)} bands, none of which is visible"
    few = f", interpolated between {len(wavelengths)} bands" if len(wavelengths) < 8 else ""
    return f"linear RGB (BT.709) by the CIE 1931 observer under illuminant {illuminant}{few}"
