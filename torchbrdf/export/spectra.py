"""Colours as spectra, for renderers that work with those."""

import numpy as np

FIRST, STEP = 400.0, 20.0
"""The first wavelength of the basis, and how far apart they are, in nm."""
# Linear between its wavelengths, from 0 to 1, with the sum 1, as smooth as can be; made so that each spectrum, lit by
# D65 and seen by the CIE 1931 observer, is red, green or blue of sRGB, linear: the tests do that again.
BASIS = np.array(
    [
        [0.1899, 0.0958, 0.0113, 0, 0, 0, 0, 0, 0, 0.1422, 0.7890, 1, 1, 1, 1, 1],
        [0, 0, 0, 0, 0.2621, 0.7459, 1, 1, 1, 0.7845, 0.2094, 0, 0, 0, 0, 0],
        [0.8101, 0.9042, 0.9887, 1, 0.7379, 0.2541, 0, 0, 0, 0.0733, 0.0016, 0, 0, 0, 0, 0],
    ]
)
"""Spectra of red, green and blue, `(3, W)`. Idea: I. Mallett and C. Yuksel, Spectral Primary Decomposition for
Rendering with sRGB Reflectance, 2019, doi:10.2312/sr.20191216."""
WAVELENGTHS = FIRST + STEP * np.arange(BASIS.shape[1])


def to_spectra(rgb: np.ndarray, axis: int = -1) -> np.ndarray:
    """Linear sRGB as spectra, of any scale.

    Args:
        rgb: With three channels along the axis.
        axis: Of the channels; of the wavelengths in what is returned.

    Example:
        >>> from torchbrdf.export.spectra import to_spectra
        >>> to_spectra(np.array([0.5, 0.5, 0.5])).round(3)[:3].tolist()
        [0.5, 0.5, 0.5]
    """
    return np.moveaxis(np.moveaxis(rgb, axis, -1) @ BASIS.astype(rgb.dtype), -1, axis)
