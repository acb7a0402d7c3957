"""ALTA's data, text and binary: a header of dimensions and coordinates, then a row for each sample.

Source: L. Belcour, R. Pacanowski, P. Barla, ALTA: Analysis of BRDFs, https://github.com/belcour/alta; its files.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.images.primaries import XYZ, to_rec709
from torchbrdf.measured.alta_parameters import PARAMETERS, Parameters
from torchbrdf.measured.angles import in_radians, of_direction
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.listed import SETTINGS, Listed, ListedFormat
from torchbrdf.measured.rows import HEAD, parse_rows
from torchbrdf.reading import check_unpacked, read_bytes

_EXPECTED = "an ALTA file"
_LINE = re.compile(r"#([A-Z_]+)(?:\s+(.*))?")
_DIM = re.compile(rb"^\s*#DIM\b", re.MULTILINE)
_FUNCTION = re.compile(rb"^\s*#(?:ALTA )?FUNC\b", re.MULTILINE)
_BEGIN = b"#BEGIN_STREAM"
# What values are, by PARAM_OUT; the quantity of the others is the setting's.
_COSINE = "INV_STERADIAN_COSINE_FACTOR"
_ONE = ("INV_STERADIAN", _COSINE, "ENERGY")
_THREE = ("RGB_COLOR", "XYZ_COLOR")
_MOST = 1000


@FORMATS.register("alta")
class Alta(ListedFormat):
    """The format of ALTA's data, text and binary, with any of its coordinates that say what light and viewer are.

    `#DIM` counts coordinates and values, `#PARAM_IN` and `#PARAM_OUT` name them, and `#VS` says how many bounds of its
    confidence interval each sample has behind them; these are passed over. Coordinates may leave an angle open, as
    `COS_TH` does, the half vector's angle alone: the setting `incomplete` says whether one is taken.
    """

    format = "alta"
    settings: ClassVar[Mapping[str, tuple[str, ...]]] = {**SETTINGS, "incomplete": ("complete", "refuse")}

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is a file of ALTA's, by `#DIM` in its header, and not one of a function that was fitted."""
        start = _start(path, head)
        return _DIM.search(start) is not None and _FUNCTION.search(start) is None

    @classmethod
    def hint(cls, path: Path, head: bytes) -> str:
        """That a file has a function, and no data."""
        return "a function that ALTA fitted, and no data" if _FUNCTION.search(_start(path, head)) else ""

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        data = read_bytes(path, _EXPECTED)
        found = re.search(rb"^" + _BEGIN + rb"[^\n]*\n", data, re.MULTILINE)
        text = _decoded(data[: found.start()] if found else data)
        lines = [line.strip() for line in text.splitlines()]
        header = _header(path, lines)
        given, values = _dimensions(path, header)
        parameters = self._parameters(path, header, given)
        _check_values(path, header, values)
        facts: dict[str, object] = {"coordinates": header["PARAM_IN"]}
        for key, name in (("SAMPLE", "sample"), ("ORIGIN", "origin")):
            if header.get(key, "").strip('"'):
                facts[name] = shown(header[key].strip('"'))[1:-1]
        if parameters.left_open:
            facts["incomplete"] = parameters.left_open
        if found:
            rows = _binary(path, header, given, values, data[found.end() :])
        else:
            count = _columns(path, header, given, values, lines)
            text_rows = parse_rows(path, lines, count, 1)
            rows = text_rows.numbers
            facts |= {"mended": text_rows.mended} if text_rows.mended else {}
        if rows.shape[1] > given + values:
            facts["confidence intervals"] = "passed over"
        angles, more = self._angles(path, parameters, rows[:, :given])
        numbers, quantity, words = self._values(header, rows[:, given : given + values])
        return Listed(angles, numbers, None, quantity, facts | more | {"values": words})

    def _parameters(self, path: Path, header: Mapping[str, str], given: int) -> Parameters:
        name = header.get("PARAM_IN", "")
        if name not in PARAMETERS:
            raise DataError(
                f"{path}: PARAM_IN: expected coordinates of two directions, such as SPHERICAL_TL_PL_TV_PV, found "
                f"{shown(name) if name else 'none: the file does not say what its numbers are'}"
            )
        found = PARAMETERS[name]
        if given != found.size:
            raise DataError(f"{path}: DIM: expected {found.size} coordinates of {name}, found {given}")
        if found.left_open and self.setting("incomplete", "complete") == "refuse":
            raise DataError(f"{path}: PARAM_IN {name}: expected coordinates that say all; {found.left_open}")
        return found

    def _angles(self, path: Path, parameters: Parameters, rows: np.ndarray) -> tuple[np.ndarray, dict[str, object]]:
        """theta_i, phi_i, theta_o and phi_o in radians, `(N, 4)`, below the horizon where coordinates are none."""
        polar, azimuth = list(parameters.polar), list(parameters.azimuth)
        facts: dict[str, object] = {}
        if polar or azimuth:
            unit = self.setting("angles", "auto")
            factor, facts["angles"] = in_radians(path, rows[:, polar], rows[:, azimuth], unit)
            rows = rows.copy()
            rows[:, polar + azimuth] *= factor
        with np.errstate(invalid="ignore", over="ignore"):
            light, viewer = parameters.directions(rows.T)
            known = np.isfinite(np.concatenate([light, viewer], -1)).all(-1)
        if not known.all():
            facts["no directions"] = f"{int((~known).sum())} rows, whose coordinates are none"
        light, viewer = (np.where(known[:, None], one, [0.0, 0.0, -1.0]) for one in (light, viewer))
        angles = np.concatenate([of_direction(light), of_direction(viewer)], -1)
        if not parameters.has_grain:
            angles[:, 3] -= angles[:, 1]
            angles[:, 1] = 0
        return angles, facts

    def _values(self, header: Mapping[str, str], rows: np.ndarray) -> tuple[np.ndarray, str, str]:
        """Values `(N, 1)` or linear RGB `(N, 3)`, their quantity, and what the file says that they are."""
        name = header.get("PARAM_OUT", "")
        if name == "XYZ_COLOR":
            with np.errstate(invalid="ignore", over="ignore"):
                rows = rows @ to_rec709("", XYZ).T
        quantity = "brdf_cosine" if name == _COSINE else "brdf"
        return rows, self.setting("quantity", quantity), name or "the file does not say (no PARAM_OUT)"


def _start(path: Path, head: bytes) -> bytes:
    """What a file that may be of ALTA's begins with; nothing of another one, or of one that cannot be read."""
    if not head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"#"):
        return b""
    try:
        with path.open("rb") as file:
            return file.read(HEAD).replace(b"\r", b"\n")
    except OSError:
        return b""


def _decoded(data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _header(path: Path, lines: list[str]) -> dict[str, str]:
    """What lines such as `#DIM 3 1` say, by their first words."""
    header: dict[str, str] = {}
    for line in lines:
        if found := _LINE.fullmatch(line):
            key, said = found[1], (found[2] or "").strip()
            if header.setdefault(key, said) != said and key in ("DIM", "PARAM_IN", "PARAM_OUT", "VS"):
                raise DataError(f"{path}: #{key}: expected it once, found {shown(header[key])} and {shown(said)}")
    return header


def _count(path: Path, key: str, said: str, most: int) -> int:
    if not (said.isascii() and said.isdigit() and len(said) < 12 and int(said) <= most):
        raise DataError(f"{path}: #{key}: expected a count up to {most}, found {shown(said)}")
    return int(said)


def _dimensions(path: Path, header: Mapping[str, str]) -> tuple[int, int]:
    """How many coordinates and how many values a sample has."""
    said = header.get("DIM", "").split()
    if len(said) != 2:
        raise DataError(f"{path}: #DIM: expected two counts, found {shown(' '.join(said))}")
    given, values = (_count(path, "DIM", one, _MOST) for one in said)
    return given, values


def _check_values(path: Path, header: Mapping[str, str], values: int) -> None:
    name = header.get("PARAM_OUT", "")
    own = 1 if name in _ONE else 3 if name in _THREE else None
    if values not in (1, 3) or (own is not None and own != values):
        raise DataError(f"{path}: DIM: expected {own or '1 or 3'} values of {shown(name)}, found {values}")


def _bounds(path: Path, header: Mapping[str, str]) -> int:
    """How many bounds a confidence interval has: 0, 1 or 2 (the kind of the first value is that of all)."""
    said = header.get("VS", "0").split() or ["0"]
    return _count(path, "VS", said[0], 2)


def _columns(path: Path, header: Mapping[str, str], given: int, values: int, lines: list[str]) -> int:
    """How many numbers a line has: intervals may be those of the first value, or of all."""
    bounds = _bounds(path, header)
    first = next((line for line in lines if line and line[0] != "#"), "")
    every = given + values + bounds * values
    return every if bounds and len(re.split(r"[,;\s]+", first.strip(",; "))) == every else given + values + bounds


def _binary(path: Path, header: Mapping[str, str], given: int, values: int, data: bytes) -> np.ndarray:
    """Rows of a binary file: doubles, intervals of all values behind them."""
    precision, endian = header.get("PRECISION", "ieee754-double"), header.get("ENDIAN", "")
    if header.get("FORMAT") != "binary" or precision != "ieee754-double" or endian not in ("little", "big"):
        found = shown(" ".join([header.get("FORMAT", ""), precision, endian]), 90)
        raise DataError(f"{path}: expected FORMAT binary, ieee754-double and ENDIAN little or big, found {found}")
    count = _count(path, "SAMPLE_COUNT", header.get("SAMPLE_COUNT", ""), 10**10)
    columns = given + values + _bounds(path, header) * values
    size = 8 * columns * count
    rest = data[size:].strip()
    if len(data) < size or rest not in (b"", b"#END_STREAM"):
        there = len(data) - len(b"\n#END_STREAM\n") if data.rstrip().endswith(b"#END_STREAM") else len(data)
        expected = f"expected {size} bytes of {count} samples of {columns} numbers"
        raise DataError(f"{path}: {expected}, found {there}")
    check_unpacked(path, 4 * size)
    return (
        np.frombuffer(data, ">f8" if endian == "big" else "<f8", columns * count)
        .reshape(count, columns)
        .astype(np.float64)
    )
