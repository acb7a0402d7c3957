"""SSDD, surface scattering distribution data: the format of libbsdf and BSDF Processor, text or with binary values.

Source: R. Kimura, Surface scattering distribution data (SSDD) file format, version 0.2, 2023,
https://github.com/KimuraRyo/libbsdf.
"""

import math
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.images.primaries import XYZ, to_rec709
from torchbrdf.measured.angles import direction
from torchbrdf.measured.bands import LONGEST
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.grain import GRAINS
from torchbrdf.measured.listed import Listed, ListedFormat
from torchbrdf.measured.notices import notice
from torchbrdf.measured.rows import HEAD, Rows, parse_rows
from torchbrdf.reading import check_unpacked, read_bytes

VERSION = "0.2"
_EXPECTED = "an SSDD file"
_SUFFIX = "_coordinate_system"
_SYSTEMS = ("spherical", "specular", "half_difference")
_CHANNELS = {"monochrome": 1, "rgb": 3, "xyz": 3}
# Bytes that a row becomes while it is read: angles, directions, and values.
_BYTES_A_ROW, _BYTES_A_VALUE = 200, 100
_LINE = re.compile(rb"([^\r\n]*)(?:\r\n|\r|\n|\Z)")
_VERSION = re.compile(rb"^[ \t]*VERSION[ \t]*([^\r\n]*)", re.MULTILINE)
_READ = (["0", "1"], VERSION.split("."))
_KIND = re.compile(rb"^[ \t]*DATA_TYPE[ \t]+(\w{1,40})", re.MULTILINE)


# Of a line of a header, such as DATA_TYPE brdf.
_KEY = re.compile(r"[A-Z][A-Z0-9_]+(?:[ \t]|$)")


@FORMATS.register("ssdd")
class Ssdd(ListedFormat):
    """The format of SSDD files, of which a BRDF is read: a grid, whose nodes above the horizon are scattered samples.

    Directions are spherical, about the mirror direction, or half and difference angles, in degrees; colours are
    monochrome, RGB (the format says no colour space: taken for linear BT.709), CIE XYZ, or a spectrum. What a file
    holds beside the BRDF, transmission and the reflectance of mirrors, is passed over.
    """

    format = "ssdd"
    suffixes = (".ssdd",)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is an SSDD file, by its first words and that of a data block."""
        if not head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith((b"VERSION", b"#")):
            return False
        try:
            with path.open("rb") as file:
                start = file.read(HEAD)
        except OSError:
            return False
        lines = [line.strip() for line in start.removeprefix(b"\xef\xbb\xbf").splitlines()]
        first = next((line for line in lines if line and not line.startswith(b"#")), b"")
        return first.startswith(b"VERSION") and any(line.startswith(b"DATA_TYPE") for line in lines)

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        data = read_bytes(path, _EXPECTED).removeprefix(b"\xef\xbb\xbf")
        version = _version(path, data)
        block = _find_brdf(path, data)
        angles, unit = block.angles(self.setting("angles", "auto"))
        values = block.rows.numbers
        if block.words["COLOR_MODEL"] == "xyz":
            values = values @ to_rec709(path, XYZ).T
        # Nodes below the horizon are there for those that interpolate on the grid.
        if len(block.axes[1]) == 1:  # no grain: azimuths are those from the light's
            angles[:, 3] -= angles[:, 1]
            angles[:, 1] = 0
        above = np.minimum(*(direction(*angles[:, k : k + 2].T)[:, 2] for k in (0, 2))) > 0
        angles, values = angles[above], values[above]
        others = {kind.decode() for kind in _KIND.findall(data)} - {"brdf"}
        facts: dict[str, object] = {
            "angles": unit,
            "coordinates": block.system.replace("_", " "),
            **{name: shown(block.words[key])[1:-1] for key, name in _FACTS.items() if block.words.get(key)},
            **version,
            **({"passed over": ", ".join(sorted(others))} if others else {}),
            **({"mended": block.rows.mended} if block.rows.mended else {}),
        }
        grain = "anisotropic" if len(block.axes[1]) > 1 else GRAINS[0]
        return Listed(angles, values, block.wavelengths, self.setting("quantity", "brdf"), facts, grain)


_FACTS = {"NAME": "sample", "DEVICE": "instrument", "MEASUREMENT_DATE": "date", "SOURCE_TYPE": "source"}


@dataclass(frozen=True)
class _Block:
    """A block of data, and what is said of it, by name."""

    path: Path
    words: dict[str, str]
    data: bytes
    start: int
    line: int

    @property
    def system(self) -> str:
        """In which coordinates directions are."""
        found = self.words.get("PARAM_TYPE", "")
        if found.removesuffix(_SUFFIX) not in _SYSTEMS:
            expected = ", ".join(_SYSTEMS)
            raise DataError(f"{self.path}: PARAM_TYPE: expected {expected}, each {_SUFFIX}, found {shown(found)}")
        return found.removesuffix(_SUFFIX)

    def axis(self, number: int, default: str = "") -> np.ndarray:
        """The angles of an axis, as they are."""
        name = f"PARAM{number}_LIST"
        text = self.words.get(name) or default
        found = _numbers(text)
        if found is None or not len(found) or not (np.diff(found) > 0).all():
            raise DataError(f"{self.path}: {name}: expected angles that grow, found {shown(text)}")
        return found

    @cached_property
    def axes(self) -> list[np.ndarray]:
        """The four axes of the grid; an isotropic BRDF has no second one."""
        return [self.axis(0), self.axis(1, "0"), self.axis(2), self.axis(3)]

    @property
    def wavelengths(self) -> list[float] | None:
        """Of the bands, nm; None of one band and of colours."""
        if self.words["COLOR_MODEL"] != "spectrum":
            return None
        text = self.words.get("WAVELENGTH_LIST", "")
        found = _numbers(text)
        if found is None or not len(found) or not (np.diff(found, prepend=0, append=LONGEST) > 0).all():
            raise DataError(f"{self.path}: WAVELENGTH_LIST: expected wavelengths that grow, found {shown(text)}")
        return found.tolist()

    @property
    def channels(self) -> int:
        """Of a value."""
        model = self.words.get("COLOR_MODEL", "")
        if model != "spectrum" and model not in _CHANNELS:
            raise DataError(
                f"{self.path}: COLOR_MODEL: expected {', '.join(_CHANNELS)} or spectrum, found {shown(model)}"
            )
        return _CHANNELS.get(model) or len(self.wavelengths or ())

    @cached_property
    def rows(self) -> Rows:
        """Values of all nodes, the first axis running fastest, `(N, C)`."""
        count, channels = math.prod(map(len, self.axes)), self.channels
        check_unpacked(self.path, read_size(count, channels))
        mode = self.words["DATA"]
        if mode == "binary":
            size = 4 * count * channels
            if len(self.data) < self.start + size:
                found = len(self.data) - self.start
                raise DataError(f"{self.path}: expected {size} bytes of {count} binary values, found {found}")
            self._check_end(self.start + size)
            flat = np.frombuffer(self.data, "<f4", count * channels, self.start).astype(np.float64)
            return Rows(flat.reshape(count, channels), "")
        if mode != "ascii":
            raise DataError(f"{self.path}: DATA: expected ascii or binary, found {shown(mode)}")
        lines: list[str] = []
        at, kept = self.start, 0
        while at < len(self.data) and kept < count:
            line, at = _line(self.data, at)
            if line.startswith("DATA_TYPE"):
                break
            lines.append(line)
            kept += bool(line) and not line.startswith("#")
        if kept != count:
            sizes = " x ".join(str(len(axis)) for axis in self.axes)
            raise DataError(f"{self.path}: expected {count} rows of values ({sizes}), found {kept}")
        self._check_end(at)
        return parse_rows(self.path, lines, channels, self.line)

    def _check_end(self, at: int) -> None:
        """Refuse what follows the values and is neither another block nor a comment."""
        while at < len(self.data):
            line, behind = _line(self.data, at)
            if _KEY.match(line):
                return
            if line and not line.startswith("#"):
                rest = len(self.data) - at
                expected = "expected the file's end or another block behind the values"
                raise DataError(f"{self.path}: {expected}, found {rest} bytes that begin with {shown(line, 40)}")
            at = behind

    def angles(self, unit: str) -> tuple[np.ndarray, str]:
        """theta and phi of light and viewer at all nodes, radians, `(N, 4)`; and in which unit they were."""
        polar = max(np.abs(self.axes[k]).max() for k in (0, 2))
        own = "degrees" if unit == "auto" else unit
        most = (180 if own == "degrees" else math.pi) * 1.001
        if polar > most or max(np.abs(self.axes[k]).max() for k in (1, 3)) > 2 * most:
            raise DataError(f"{self.path}: PARAM lists: expected angles in {own}, found {polar:.6g} from the normal")
        words = own if unit != "auto" else "degrees, as the format has it"
        if unit == "auto" and 0 < polar <= math.pi / 2 + 0.01:
            words += f"; the largest from the normal is {polar:.4g}: if that is in radians, say angles=radians"
        scale = math.pi / 180 if own == "degrees" else 1.0
        nodes = np.meshgrid(*(scale * axis for axis in self.axes), indexing="ij")
        first, turn, third, last = (node.ravel(order="F") for node in nodes)
        if self.system == "spherical":
            return np.stack([first, turn, third, turn + last], -1), words
        if self.system == "half_difference":
            wi, wo = half_directions(first, turn, third, last)
            return np.concatenate([_angles_of(wi), _angles_of(wo)], -1), words
        count = len(self.axes[0])
        offset = _numbers(self.words.get("PARAM4_LIST") or "0 " * count)
        if offset is None or len(offset) != count:
            found = shown(self.words["PARAM4_LIST"])
            raise DataError(f"{self.path}: PARAM4_LIST: expected {count} angles, as PARAM0_LIST has, found {found}")
        tilt = first + np.tile(scale * offset, len(first) // len(offset))
        x, y, z = direction(third, last).T
        wo = np.stack([np.cos(tilt) * x - np.sin(tilt) * z, y, np.sin(tilt) * x + np.cos(tilt) * z], -1)
        seen = _angles_of(wo)
        seen[:, 1] += turn
        return np.concatenate([np.stack([first, turn], -1), seen], -1), words


def read_size(count: int, channels: int) -> int:
    """Bytes that so many rows of values become while they are read.

    Args:
        count: Of rows.
        channels: Of each.

    Example:
        >>> read_size(1000, 3)
        500000
    """
    return count * (_BYTES_A_ROW + channels * _BYTES_A_VALUE)


def half_directions(
    theta_h: np.ndarray, phi_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to light and viewer, `(N, 3)`, by the angles of half and difference vectors, radians."""
    half = direction(theta_h, phi_h)
    toward = direction(theta_d, phi_d)
    x = np.cos(theta_h) * toward[:, 0] + np.sin(theta_h) * toward[:, 2]
    z = np.cos(theta_h) * toward[:, 2] - np.sin(theta_h) * toward[:, 0]
    y = toward[:, 1]
    wi = np.stack([np.cos(phi_h) * x - np.sin(phi_h) * y, np.sin(phi_h) * x + np.cos(phi_h) * y, z], -1)
    return wi, 2 * np.cos(theta_d)[:, None] * half - wi


def _angles_of(way: np.ndarray) -> np.ndarray:
    """theta and phi of unit vectors, `(N, 2)`."""
    x, y, z = way.T
    return np.stack([np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)], -1)


def _line(data: bytes, at: int) -> tuple[str, int]:
    """The line of text at a place, stripped, and where the next one begins."""
    found = _LINE.match(data, at)
    end = len(data) if found is None else max(found.end(), at + 1)
    text = b"" if found is None else found[1]
    return text.decode("utf-8", "replace").strip(), end


def _numbers(text: str) -> np.ndarray | None:
    """Finite numbers that blanks part; None where something else stands there."""
    try:
        found = np.array([float(word) for word in text.split()])
    except ValueError:
        return None
    return found if np.isfinite(found).all() and "_" not in text else None


def _version(path: Path, data: bytes) -> dict[str, object]:
    """What there is to say of a file's version: nothing of those that are known, and of others in front of 1."""
    found = _VERSION.search(data)
    said = found[1].decode("utf-8", "replace").strip() if found else ""
    if not re.fullmatch(r"0\.[0-9]+(\.[0-9]+)*", said):
        raise DataError(f"{path}: VERSION: expected {VERSION}, found {shown(said)}")
    if said.split(".")[:2] in _READ:
        return {}
    doubt = f"{shown(said)[1:-1]}, which is read as {VERSION}"
    notice(path, f"version: {doubt}")
    return {"version": doubt}


def _find_brdf(path: Path, data: bytes) -> _Block:
    """The first block of a BRDF."""
    at, number = 0, 0
    words: dict[str, str] = {}
    while at < len(data):
        line, at = _line(data, at)
        number += 1
        if not line or line.startswith("#"):
            continue
        key, *rest = line.split(None, 1)
        if key == "DATA_TYPE":
            words = {}
        words[key] = rest[0].strip() if rest else ""
        if key == "DATA" and words.get("DATA_TYPE") == "brdf":
            return _Block(path, words, data, at, number + 1)
    kinds = ", ".join(sorted({kind.decode() for kind in _KIND.findall(data)})) or "none"
    raise DataError(f"{path}: expected a block of the data type brdf that ends with DATA, found {kinds}")
