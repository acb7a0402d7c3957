"""The universal BRDF data format of the BiRD and BxDiff projects: JSON with a list for each variable.

Source: D. Lanevski et al., Universal BRDF data format, 2022, doi:10.1002/col.22790, and its JSON schema.
"""

from pathlib import Path

import msgspec
import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.angles import in_radians
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.listed import Listed, ListedFormat
from torchbrdf.measured.rows import head_lines
from torchbrdf.measured.spectra import spectra
from torchbrdf.reading import read_json

_EXPECTED = "a BiRD BRDF file"
_ANGLE_UNITS = {"°": "degrees", "deg": "degrees", "degree": "degrees", "rad": "radians"}
_LENGTH_UNITS = {"nm": 1.0, "μm": 1e3, "um": 1e3, "\u00b5m": 1e3}
_VALUE_UNITS = ("sr^-1", "1/sr")


class _Variable(msgspec.Struct):
    """A variable of a file: a number for each sample, which one writer calls `value`."""

    values: list[float] = []
    value: list[float] = []
    unit: str = ""

    @property
    def numbers(self) -> list[float]:
        """The number for each sample."""
        return self.values or self.value


class _Data(msgspec.Struct):
    """The variables that are read."""

    theta_i: _Variable
    phi_i: _Variable
    theta_r: _Variable
    phi_r: _Variable
    brdf: _Variable = msgspec.field(name="BRDF")
    wavelength_i: _Variable | None = None
    wavelength_r: _Variable | None = None


class _Document(msgspec.Struct):
    """The part of a file that is read."""

    data: _Data


@FORMATS.register("bird")
class Bird(ListedFormat):
    """The format of BiRD and BxDiff's universal BRDF files, JSON.

    Samples at the same angles are bands, and the mean over what else differs, such as polarization.
    """

    format = "bird"

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is such a file, by the schema that it names."""
        start = " ".join(head_lines(path, head))
        return start.startswith("{") and "brdf_json_schema" in start.lower() and '"metadata"' in start

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        document: _Document = read_json(path, _Document, _EXPECTED)
        data = document.data
        named = {"theta_i": data.theta_i, "phi_i": data.phi_i, "theta_r": data.theta_r, "phi_r": data.phi_r}
        count = len(data.brdf.numbers)
        if not count:
            raise DataError(f"{path}: BRDF: expected values, found none")
        length = data.wavelength_i or data.wavelength_r
        for name, one in (named | ({"wavelength": length} if length else {})).items():
            if len(one.numbers) != count:
                raise DataError(f"{path}: {name}: expected {count} values as of BRDF, found {len(one.numbers)}")
        units = {one.unit for one in named.values()}
        if len(units) != 1 or not units <= set(_ANGLE_UNITS) or data.brdf.unit not in _VALUE_UNITS:
            found = shown(" ".join([*sorted(units), data.brdf.unit]))
            raise DataError(f"{path}: expected angles in ° or rad and BRDF in sr^-1, found {found}")
        if length and length.unit not in _LENGTH_UNITS:
            raise DataError(f"{path}: wavelength: expected nm or μm, found {shown(length.unit)}")
        angles = np.array([one.numbers for one in named.values()], np.float64).T
        factor, unit = in_radians(path, angles[:, ::2], angles[:, 1::2], _ANGLE_UNITS[units.pop()])
        facts: dict[str, object] = {"angles": unit}
        values = np.array(data.brdf.numbers, np.float64)
        if not length:
            return Listed(angles * factor, values[:, None], None, facts=facts)
        lengths = np.array(length.numbers, np.float64) * _LENGTH_UNITS[length.unit]
        each = spectra(path, angles, lengths, values)  # the mean over what else differs, such as polarization
        return Listed(each.places * factor, each.values, each.wavelengths, facts=facts | each.facts)
