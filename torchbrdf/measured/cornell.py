"""Text of Cornell's gonioreflectometer: wavelengths, then rows of four angles and a spectrum.

Source: S. Foo, A Gonioreflectometer for Measuring the Bidirectional Reflectance of Material for Use in Illumination
Computation, 1997; files that say so of themselves.
"""

from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.angles import in_radians
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.listed import Listed, ListedFormat
from torchbrdf.measured.rows import head_lines, parse_rows, text_lines

_EXPECTED = "a Cornell BRDF file"
# More than any spectrometer has.
_MOST_BANDS = 10_000
_MARKS = ("# num wls", "# wls")


@FORMATS.register("cornell")
class Cornell(ListedFormat):
    """The format of Cornell's `.brdf` text files, scattered samples in many bands.

    `# num wls` and `# wls` introduce the wavelengths, in nm; rows have theta_i, phi_i, theta_s, phi_s in radians, and a
    value for each wavelength.
    """

    format = "cornell"

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is a file of Cornell's, by the comments that introduce its wavelengths."""
        return any(_marked(line) == _MARKS[0] for line in head_lines(path, head))

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        lines = text_lines(path, _EXPECTED)
        lines, mended = _apart(lines)
        low = [line.lower() for line in lines]
        for mark in _MARKS:
            if mark not in low:
                raise DataError(f"{path}: expected a line {mark!r}, found none")
        said = next((line for line in lines[low.index(_MARKS[0]) + 1 :] if line), "")
        if not (said.isascii() and said.isdigit() and len(said) < 9 and 0 < int(said) <= _MOST_BANDS):
            raise DataError(f"{path}: # num wls: expected a count up to {_MOST_BANDS}, found {shown(said)}")
        count, at = int(said), low.index(_MARKS[1]) + 1
        words: list[str] = []
        while at < len(lines) and len(words) < count:
            if lines[at].startswith("#"):
                break
            words += lines[at].split()
            at += 1
        wavelengths = _numbers(words)
        if len(words) != count or wavelengths is None or not _grow(wavelengths):
            raise DataError(f"{path}: # wls: expected {count} growing wavelengths, found {shown(' '.join(words), 90)}")
        rows = parse_rows(path, lines[at:], 4 + count, at + 1)
        factor, unit = in_radians(path, rows.numbers[:, 0:4:2], rows.numbers[:, 1:4:2], self.setting("angles", "auto"))
        mended = ", ".join(filter(None, [mended, rows.mended]))
        facts = {"angles": unit} | ({"mended": mended} if mended else {})
        angles, values = rows.numbers[:, :4] * factor, rows.numbers[:, 4:]
        return Listed(angles, values, wavelengths, self.setting("quantity", "brdf"), facts)


def _marked(line: str) -> str:
    """The comment that a line begins with, if it is one of those that introduce something; else ""."""
    low = " ".join(line.lower().replace("#", "# ").split())
    return next((mark for mark in _MARKS if low.startswith(mark)), "")


def _apart(lines: list[str]) -> tuple[list[str], str]:
    """Lines with each comment that introduces something on a line of its own; and what was mended, in words."""
    found: list[str] = []
    mended = ""
    for line in lines:
        parts = [f"#{one}" for one in line[1:].split("#")] if line.startswith("#") else [line]
        for part in parts if len(parts) > 1 and any(map(_marked, parts)) else [line]:
            mark = _marked(part)
            if not mark or part.lower() == mark:
                found.append(part)
                continue
            word = mark.rpartition(" ")[2]
            found += [mark, part[part.lower().index(word) + len(word) :].strip(" \t:=")]
            mended = "the header's numbers, which stand on the lines of their comments"
    return found, mended


def _numbers(words: list[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _grow(wavelengths: list[float]) -> bool:
    """Whether they are wavelengths in nm, each larger than the one before."""
    return wavelengths[0] > 0 and wavelengths[-1] < 1e6 and bool((np.diff(wavelengths) > 0).all())
