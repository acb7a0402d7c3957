"""Look-up tables of ASAM OpenMATERIAL 3D: JSON with rows of a wavelength, three angles and a value.

Source: ASAM OpenMATERIAL 3D 1.0.0, the schema of its material BRDF, https://github.com/asam-ev/OpenMATERIAL-3D.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.angles import in_radians
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.listed import SETTINGS, Listed, ListedFormat
from torchbrdf.measured.rows import head_lines
from torchbrdf.measured.spectra import spectra
from torchbrdf.reading import check_unpacked, read_json

_EXPECTED = "an OpenMATERIAL 3D BRDF table"
_COLUMNS = 5
_NM = 1e9
# Wavelengths nearer to each other than so much of themselves are one, written with other digits.
_SAME = 1e-6
# Of a row while it is read.
_BYTES_A_ROW = 400


class _Metadata(msgspec.Struct):
    """What a file says of itself."""

    name: str = ""
    sources: str = ""
    sensor: str = msgspec.field(default="", name="typicalSensorTechnology")


class _Brdf(msgspec.Struct):
    """The table of a file."""

    wavelengths: list[float]
    rows: list[list[float | None]] = msgspec.field(name="lookupTable")


class _Document(msgspec.Struct):
    """The part of a file that is read."""

    brdf: _Brdf
    metadata: _Metadata = msgspec.field(default_factory=_Metadata)


@FORMATS.register("openmaterial")
class OpenMaterial(ListedFormat):
    """The format of ASAM OpenMATERIAL 3D's `.xompt` files with a BRDF, scattered samples in any bands.

    Rows have a wavelength in m, theta_i, theta_o, the viewer's azimuth from the light's, in radians, and a value in
    1/sr. The schema calls the incident ray the reference of azimuths, and does not say whether it is followed back to
    the light: the setting `azimuth` does. A row with a null holds nothing.
    """

    format = "openmaterial"
    settings: ClassVar[Mapping[str, tuple[str, ...]]] = {**SETTINGS, "azimuth": ("light", "mirror")}

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is such a table, by the schema that it names, or by the standard's version and a BRDF."""
        start = " ".join(head_lines(path, head))
        named = '"openMaterial3dVersion"' in start and '"brdf"' in start
        return start.startswith("{") and ("schemas/material_brdf_schema" in start or named)

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        document: _Document = read_json(path, _Document, _EXPECTED)
        rows = _table(path, document.brdf.rows)
        factor, unit = in_radians(path, rows[:, 1:3], rows[:, 3:4], self.setting("angles", "radians"))
        lengths = _merged(rows[:, 0])
        said = _merged(np.array(document.brdf.wavelengths, np.float64))
        found = spectra(path, rows[:, 1:4], lengths * _NM, rows[:, 4])
        theta_i, theta_o, azimuth = (found.places * factor).T
        from_light = self.setting("azimuth", "light") == "light"
        angles = np.stack([theta_i, 0 * theta_i, theta_o, azimuth + (0 if from_light else np.pi)], -1)
        facts: dict[str, object] = {"angles": unit}
        if np.ptp(azimuth) or np.any(azimuth):
            facts["azimuths"] = f"0 is the {'light' if from_light else 'mirror direction'}'s (the file does not say)"
        for name, text in (
            ("sample", document.metadata.name), ("source", document.metadata.sources),
            ("sensor", document.metadata.sensor),
        ):  # fmt: skip
            if text.strip():
                facts[name] = shown(text.strip(), 90)[1:-1]
        if len(said) != len(found.wavelengths) or not np.allclose(np.unique(said) * _NM, found.wavelengths):
            facts["wavelengths"] = (
                f"the header lists {len(said)}, the rows have {len(found.wavelengths)}; the rows were believed"
            )
        return Listed(angles, found.values, found.wavelengths, self.setting("quantity", "brdf"), facts | found.facts)


def _table(path: Path, rows: list[list[float | None]]) -> np.ndarray:
    """The rows without a null, `(N, 5)`."""
    check_unpacked(path, _BYTES_A_ROW * len(rows))
    for k, row in enumerate(rows):
        if len(row) != _COLUMNS:
            raise DataError(f"{path}: lookupTable[{k}]: expected {_COLUMNS} numbers, found {len(row)}")
    found = [row for row in rows if None not in row]
    if not found:
        raise DataError(f"{path}: lookupTable: expected rows of {_COLUMNS} numbers, found none")
    return np.array(found, np.float64)


def _merged(lengths: np.ndarray) -> np.ndarray:
    """Wavelengths in m, each as the first of those that are the same."""
    each, own = np.unique(lengths, return_inverse=True)
    first = np.concatenate([[True], np.diff(each) > _SAME * each[1:]])
    merged: np.ndarray = each[np.flatnonzero(first)[np.cumsum(first) - 1]][own.reshape(-1)]
    return merged
