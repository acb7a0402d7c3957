"""Tables of scatter that FRED takes: for each angle of the light rows of a polar angle, an azimuth and a value."""

import re
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.angles import in_radians
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.listed import Listed, ListedFormat
from torchbrdf.measured.rows import head_lines, parse_rows, text_lines

_EXPECTED = "a FRED scatter table"
_SAID = re.compile(r"(\w+)\s*=\s*(\S+)")
_UNITS = {"deg": "degrees", "rad": "radians"}


@FORMATS.register("fred")
class Fred(ListedFormat):
    """The format of FRED's text tables: `type bsdf_data`, a line `format`, and for each light its rows.

    Azimuths are those of FRED: at the azimuth of the light lies the mirror direction.
    """

    format = "fred"

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is a table of FRED's, by its first words."""
        return any(line.lower().split() == ["type", "bsdf_data"] for line in head_lines(path, head)[:20])

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        lines = text_lines(path, _EXPECTED)
        at = next((k for k, line in enumerate(lines) if line.lower().startswith("format")), None)
        if at is None:
            raise DataError(f"{path}: expected a line 'format', found none")
        said = dict(_SAID.findall(lines[at].lower()))
        if said.get("bsdf", "value") != "value" or said.get("angles", "") not in _UNITS:
            expected = "expected angles=deg or angles=rad, and bsdf=value"
            raise DataError(f"{path}: format: {expected}, found {shown(lines[at])}")
        scale = parse_rows(path, [said.get("scale", "1")], 1, at + 1).numbers.item()
        light: list[str] = []
        rows: list[str] = []
        began = before = 0
        for number, line in enumerate(lines[at + 1 :], at + 2):
            words = _words(line)
            if line and line[0] != "#":
                if len(words) not in (2, 3) or (len(words) == 3 and not light):
                    raise DataError(
                        f"{path}: line {number}: expected two angles of a light, or a row of 3, found {shown(line)}"
                    )
                if len(words) == 2:
                    _check_rows(path, began, count=len(rows) - before)
                    light, began, before = words, number, len(rows)
                else:
                    rows.append(" ".join([*light, *words]))
        _check_rows(path, began, count=len(rows) - before)
        found = parse_rows(path, rows, 5, at + 2).numbers
        factor, unit = in_radians(path, found[:, [0, 2]], found[:, [1, 3]], _UNITS[said["angles"]])
        angles = found[:, :4] * factor + np.array([0, np.pi, 0, 0])
        facts = {"angles": f"{unit}; the mirror direction has the light's azimuth"}
        return Listed(angles, found[:, 4:] * scale, None, facts=facts)


def _words(line: str) -> list[str]:
    """What blanks part, or commas where no blanks are but behind these."""
    words = line.split()
    parted = len(words) == 1 or all(word.endswith(",") for word in words[:-1])
    return [part for part in re.split(r"[,\s]+", line) if part] if parted else words


def _check_rows(path: Path, began: int, count: int) -> None:
    """Refuse a light without rows, as a file that was cut has; `began` is its line, 0 before the first."""
    if began and not count:
        raise DataError(f"{path}: line {began}: expected rows of this light behind it, found none; is the file cut?")
