"""The values of RGL files: linear RGB, or spectra, of which colours are made.

Source: the reading code of W. Jakob and J. Dupuy, https://github.com/rgl-epfl/brdf-loader: a spectral file has the
fields `wavelengths`, in nm, and `spectra` in the place of `rgb`.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from torchbrdf.errors import DataError, ShapeError
from torchbrdf.measured.bands import (
    BANDS,
    DEFAULT_ILLUMINANT,
    ILLUMINANTS,
    KEEP,
    RGB,
    bands_in_words,
    checked_wavelengths,
    colors_label,
    rgb_weights,
)
from torchbrdf.measured.tensor_file import TensorFile

SETTINGS: Mapping[str, tuple[str, ...]] = {"bands": BANDS, "illuminant": ILLUMINANTS}
"""What a reader may be told, and the values of each."""
SUFFIXES = ("_rgb", "_spec")
"""By which the database's files of one material differ."""


class Stored(NamedTuple):
    """The values that a file stores.

    Attributes:
        values: For each phi_i, theta_i, channel, and node of the grid, `(P, T, C, R, R)`, float64.
        wavelengths: Of the channels, nm; None of linear RGB.
        colors: How they became what they are, in words.
    """

    values: np.ndarray
    wavelengths: tuple[float, ...] | None
    colors: str


def stored(file: TensorFile, directions: int, angles: int, told: Mapping[str, str]) -> Stored:
    """The values of a file, in linear RGB or in its bands.

    Args:
        file: Whose they are.
        directions: How many phi_i it has, P.
        angles: How many theta_i, T.
        told: What its reader is told, of `SETTINGS`.

    Raises:
        DataError: There are none, or of another shape than the rest of the file, or wavelengths do not grow.
    """
    kept = told.get("bands", RGB) == KEEP
    if "rgb" in file.fields and not (kept and "spectra" in file.fields):
        return Stored(file.array("rgb", [directions, angles, 3, None, None]), None, "RGB as the file has it")
    if "spectra" not in file.fields:
        file.array("rgb", [directions, angles, 3, None, None])  # says what there is in its place
    lengths = file.array("wavelengths", [None])
    try:
        wavelengths = checked_wavelengths(lengths.tolist(), len(lengths))
    except ShapeError as error:
        raise DataError(f"{file.path}: {error}") from None
    values = file.array("spectra", [directions, angles, len(wavelengths), None, None])
    if kept:
        return Stored(values, wavelengths, f"none: {bands_in_words(len(wavelengths), wavelengths)}, as they are")
    illuminant = told.get("illuminant", DEFAULT_ILLUMINANT)
    with np.errstate(invalid="ignore", over="ignore"):
        found = np.einsum("ptcuv,ck->ptkuv", values, rgb_weights(wavelengths, illuminant))
    return Stored(found, None, colors_label(wavelengths, illuminant))


def material_name(stem: str) -> str:
    """A material's name from that of one of its files.

    Example:
        >>> from torchbrdf.measured.rgl_spectra import material_name
        >>> material_name("paper_white_spec")
        'paper_white'
    """
    suffix = next((one for one in SUFFIXES if stem.endswith(one) and stem != one), "")
    return stem.removesuffix(suffix)
