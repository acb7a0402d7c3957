"""Values that files list with a wavelength each, gathered to spectra of directions."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchbrdf.errors import DataError
from torchbrdf.reading import check_unpacked

LONGEST = 1e6
"""No wavelength of light, in nm, is as long."""


class Spectra(NamedTuple):
    """Spectra at places, and what there is to say of how they were made.

    Attributes:
        places: Angles as they were given, `(N, d)`.
        values: `(N, W)`, nan where a place has no value at a wavelength.
        wavelengths: nm, growing, W.
        facts: By name.
    """

    places: np.ndarray
    values: np.ndarray
    wavelengths: list[float]
    facts: dict[str, object]


def spectra(path: Path, angles: np.ndarray, wavelengths: np.ndarray, values: np.ndarray) -> Spectra:
    """Gather values of the same angles; the mean of those that are at the same wavelength, too.

    Args:
        path: The file, for errors.
        angles: Of each value, `(K, d)`.
        wavelengths: Of each value, nm, `(K,)`.
        values: `(K,)`, at least one.

    Raises:
        DataError: The wavelengths are none, or are so many others at all angles that they are no bands.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from torchbrdf.measured.spectra import spectra
        >>> angles, lengths = np.array([[0.1, 0.2], [0.1, 0.2], [0.3, 0.2]]), np.array([500, 600, 500])
        >>> spectra(Path("x"), angles, lengths, np.array([1.0, 2.0, 3.0])).values.tolist()
        [[1.0, 2.0], [3.0, nan]]
    """
    places, own = np.unique(angles, axis=0, return_inverse=True)
    bands, band = np.unique(wavelengths, return_inverse=True)
    size = len(places) * len(bands)
    if not (bands[0] > 0 and bands[-1] < LONGEST):
        raise DataError(
            f"{path}: wavelengths: expected some of light, 0 to {LONGEST:g} nm, found {bands[0]:.4g} to {bands[-1]:.4g}"
        )
    if size > 50 * len(values) + 1000:
        raise DataError(f"{path}: wavelengths: expected the same ones at all angles, found {len(bands)} in all")
    check_unpacked(path, 40 * size)
    cell = own.reshape(-1) * len(bands) + band.reshape(-1)
    repeats = np.bincount(cell, minlength=size)
    with np.errstate(invalid="ignore"):  # nan where a band is missing
        table = (np.bincount(cell, values, size) / repeats).reshape(-1, len(bands))
    facts: dict[str, object] = {}
    if repeats.max() > 1:
        facts["repetitions"] = f"{len(values)} values of {int((repeats > 0).sum())}: their means"
    return Spectra(places, table, bands.tolist(), facts)
