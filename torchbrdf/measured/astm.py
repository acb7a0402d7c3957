"""ASTM E1392 text: rows of four angles and of values in bands, behind a header of names and values.

Source: ASTM E1392-96, Standard Practice for Angle Resolved Optical Scatter Measurements on Specular or Diffuse
Surfaces; and files of instruments that say so of themselves.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.images.primaries import XYZ, to_rec709
from torchbrdf.measured.angles import in_radians
from torchbrdf.measured.bands import columns_of_bands
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.grain import said_grain
from torchbrdf.measured.listed import Listed, ListedFormat
from torchbrdf.measured.notices import notice
from torchbrdf.measured.rows import head_lines, parse_rows, text_lines

# A header may have any of these; one of VARS, and one more, make it one.
_KEYS = (
    *("LAB_NAME", "SYSTEM_NAME", "SAMPLE_NAME", "MEAS_NAME", "FILE_NAME", "NUM_POINTS", "MEAS_DATE", "OPERATOR"),
    *("POLAR_MEAS", "WAVELENGTH", "COMMENT", "APERTURE", "INSTRUMENT"),
)
_ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")
_OTHER_NAMES = {"theta_r": "theta_s", "theta_o": "theta_s", "phi_r": "phi_s", "phi_o": "phi_s"}
_XYZ = ["x", "y", "z"]
_EXPECTED = "an ASTM E1392 file"


@FORMATS.register("astm")
class Astm(ListedFormat):
    """The format of ASTM E1392 text files, scattered samples in bands of wavelengths.

    `VARS` names the columns: theta_i, phi_i, theta_s, phi_s, then bands, such as `465nm`. Where it leaves out phi_s,
    and every row has one column more than it names, the rows are believed. Angles are in radians unless one of them
    is too large for that, or the setting `angles` says otherwise. A `COMMENT grain: anisotropic`, or `isotropic`, says
    what else is found out of samples whose light has several azimuths.
    """

    format = "astm"
    suffixes = (".astm",)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is an ASTM E1392 file, by the names that its header has."""
        lines = head_lines(path, head)
        if not any(line[:4].upper() == "VARS" for line in lines):  # of most files, quickly
            return False
        names = {_key(line)[0] for line in lines}
        return "VARS" in names and bool(names.intersection(_KEYS))

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        lines = text_lines(path, _EXPECTED)
        header: dict[str, str] = {}
        comments: list[str] = []
        start = next((k for k, line in enumerate(lines) if _key(line)[0] == "VARS"), None)
        if start is None:
            raise DataError(f"{path}: expected a line VARS that names the columns, found none")
        for line in lines[: start + 1]:
            key, rest = _key(line)
            header[key] = rest
            comments += [rest] if key == "COMMENT" else []
        names = [_OTHER_NAMES.get(name, name) for name in _split(header.get("VARS", "").lower())]
        facts: dict[str, object] = {}
        for key, word in (("SAMPLE_NAME", "sample"), ("SYSTEM_NAME", "instrument"), ("MEAS_DATE", "date")):
            if header.get(key):
                facts[word] = shown(header[key])[1:-1]
        first = next((line for line in lines[start + 1 :] if line and line[0] != "#"), "")
        if "phi_s" not in names and "theta_s" in names and len(_split(first)) == len(names) + 1:
            names.insert(names.index("theta_s") + 1, "phi_s")
            facts["columns"] = f"the header names {len(names) - 1}, the rows have {len(names)}: phi_s behind theta_s"
        bands, wavelengths = _bands(path, names)
        rows = parse_rows(path, lines[start + 1 :], len(names), start + 2)
        facts |= _counted(path, header.get("NUM_POINTS"), len(rows.numbers))
        mended = ["semicolons between columns"] * (";" in first or ";" in lines[start]) + [rows.mended] * bool(
            rows.mended
        )
        if mended:
            facts["mended"] = ", ".join(mended)
        column = {name: rows.numbers[:, k] for k, name in enumerate(names)}
        polar, azimuth = (rows.numbers[:, [names.index(f"{name}_{end}") for end in "is"]] for name in ("theta", "phi"))
        factor, unit = in_radians(path, polar, azimuth, self.setting("angles", "auto"))
        facts["angles"] = unit
        angles = np.stack([column[name] * factor for name in _ANGLES], -1)
        values = rows.numbers[:, bands]
        if [names[k] for k in bands] == _XYZ:
            values = values @ to_rec709("", XYZ).T
            facts["tristimulus values"] = "made linear RGB (BT.709)"
        return Listed(angles, values, wavelengths, self.setting("quantity", "brdf"), facts, said_grain(comments))


def _key(line: str) -> tuple[str, str]:
    """What a line of the header begins with, in capitals, and what stands behind it."""
    found = re.match(r"([^\s;,:=]*)[\s;,:=]*(.*)", line)
    return ("", "") if found is None else (found[1].upper(), found[2].strip())


def _split(text: str) -> list[str]:
    """What commas, semicolons or blanks part."""
    return [part for part in re.split(r"[,;\s]+", text) if part]


def _bands(path: Path, names: Sequence[str]) -> tuple[list[int], list[float] | None]:
    """The columns of bands, in the order of their wavelengths; None for RGB."""
    missing = [name for name in _ANGLES if names.count(name) != 1]
    if missing:
        raise DataError(f"{path}: VARS: expected {', '.join(_ANGLES)} once each, found {shown(' '.join(names), 90)}")
    columns = [k for k, name in enumerate(names) if name not in _ANGLES]
    if sorted(names[k] for k in columns) == _XYZ:
        return sorted(columns, key=lambda k: names[k]), None
    found = columns_of_bands([names[k] for k in columns])
    if found is None:
        other = " ".join(names[k] for k in columns)
        raise DataError(f"{path}: VARS: expected bands such as 465nm, or red, green, blue, found {shown(other, 90)}")
    order, wavelengths = found
    return [columns[k] for k in order], wavelengths


def _counted(path: Path, said: str | None, rows: int) -> dict[str, object]:
    """What there is to say where the header counts other rows than there are."""
    if said is None or said == str(rows):
        return {}
    found = f"{rows}, and the header says {shown(said)}; the rows were believed"
    notice(path, f"rows: {found}")
    return {"rows": found}
