"""BSDF text of LightTools: tables over the angles from the normal and about it, a block for each light.

Source: what libbsdf (R. Kimura) reads of it; no file of LightTools' own was at hand.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.bands import LONGEST
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.listed import SETTINGS, Listed, ListedFormat
from torchbrdf.measured.rows import head_lines, parse_rows, text_lines
from torchbrdf.measured.tristimulus import rgb_of_reflected
from torchbrdf.reading import check_unpacked

_EXPECTED = "a BSDF of LightTools"
_SYMMETRIES = ("planesymmetrical", "asymmetric", "asymmetrical")
_CONTENTS = ("monochrome", "xyz")
_TRISTIMULUS = ("trisx", "trisy", "trisz")
_WORDS = ("aoi", "poi", "side", "wavelength", "scattertype", "tristimulusvalue")
# A header may say these for all blocks.
_FOR_ALL = ("side", "scattertype", "wavelength")
_UNITS = ("deg", "degrees", "nm")
_MOST_ANGLES = 10_000
# Of a number while it is read, and of a sample.
_BYTES_A_SAMPLE = 300


class _Block(NamedTuple):
    """What was measured with one light: what is said of it, and values, `(azimuths radials,)`."""

    words: dict[str, str]
    values: np.ndarray

    def number(self, path: Path, name: str, largest: float, default: float) -> float:
        """A number from 0 on that the block says."""
        said = self.words.get(name)
        if said is None:
            return default
        try:
            found = float(said)
        except ValueError:
            found = math.nan
        if not 0 <= found <= largest:
            raise DataError(f"{path}: {name.upper()}: expected 0 to {largest:g}, found {shown(said)}")
        return found


@FORMATS.register("lighttools")
class LightTools(ListedFormat):
    """The format of LightTools' `.bsdf` text, in degrees; of one side, and only its reflection.

    A viewer is given by `ScatterRadial`, its angle from the normal, and `ScatterAzimuth`. Light comes from azimuth 90,
    or, if the reader is told so, from that of its plane of incidence, `POI`.
    """

    format = "lighttools"
    settings: ClassVar = {
        "side": ("auto", "front", "back"),
        "light_azimuth": ("90", "poi"),
        **{name: values for name, values in SETTINGS.items() if name != "angles"},
    }

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is such a file, by names that its header shares with Zemax' and one that it lacks."""
        names = {line.split(None, 1)[0].lower() for line in head_lines(path, head)}
        return {"symmetry", "scatterradial", "scatterazimuth"} <= names and "angleofincidence" not in names

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        bare = (line.partition("#")[0].strip() for line in text_lines(path, _EXPECTED))
        lines = [(k, line) for k, line in enumerate(bare, 1) if line]
        said, axes, blocks = _read(path, lines)
        found = self._reflections(path, blocks)
        groups: dict[tuple[float, float], dict[str, _Block]] = {}
        for block in found:
            light = block.number(path, "aoi", 90, math.nan), block.number(path, "poi", 360, 90.0)
            name = block.words.get("tristimulusvalue", "") if said["spectralcontent"] == "xyz" else ""
            name = name.lower() or block.words.get("wavelength", "")
            if math.isnan(light[0]) or name in groups.setdefault(light, {}):
                found_here = "none" if math.isnan(light[0]) else f"a second one for {light[0]:g} degrees"
                raise DataError(f"{path}: AOI: expected a block for each angle of the light, found {found_here}")
            groups[light][name] = block
        turns = sorted({poi for _, poi in groups})
        by_plane = self.setting("light_azimuth", "90") == "poi"
        if len(turns) > 1 and not by_plane:
            expected = (
                "expected one plane of incidence, unless --read light_azimuth=poi says that light comes from there"
            )
            raise DataError(f"{path}: POI: {expected}; found {len(turns)}")
        names, bands = _bands(path, said["spectralcontent"], [list(one) for one in groups.values()])
        values = np.concatenate([np.stack([one[name].values for name in names], -1) for one in groups.values()])
        if said["spectralcontent"] == "xyz":
            values = rgb_of_reflected(values)
        azimuth, radial = (one.reshape(-1) for one in np.meshgrid(*axes, indexing="ij"))
        angles = [
            np.stack([np.full_like(radial, aoi), np.full_like(radial, poi if by_plane else 90), radial, azimuth], -1)
            for aoi, poi in groups
        ]
        side = found[0].words.get("side", "front").lower()
        facts = {
            "angles": f"degrees; light from azimuth {'POI' if by_plane else '90; --read light_azimuth=poi takes POI'}",
            "symmetry": shown(said["symmetry"]),
            "content": shown(said["spectralcontent"]),
            "side": side + ("; --read side=front, side=back" if self.setting("side", "auto") == "auto" else ""),
        }
        if unknown := {name: None for block in found for name in block.words if name not in _WORDS}:
            facts["passed over"] = shown(", ".join(unknown))
        listed = np.radians(np.concatenate(angles))
        return Listed(listed, values, bands, self.setting("quantity", "brdf"), facts)

    def _reflections(self, path: Path, blocks: list[_Block]) -> list[_Block]:
        """Those of one side."""
        kinds = [
            (block.words.get("side", "front").lower(), block.words.get("scattertype", "").lower()) for block in blocks
        ]
        for side, kind in kinds:
            if side not in ("front", "back") or kind not in ("brdf", "btdf"):
                found = shown(f"{side}, {kind}")
                raise DataError(f"{path}: expected Side Front or Back and ScatterType BRDF or BTDF, found {found}")
        there = [side for side in ("front", "back") if (side, "brdf") in kinds]
        told = self.setting("side", "auto")
        side = told if told != "auto" or not there else there[0]
        if side not in there:
            words = ", ".join(dict.fromkeys(f"{kind.upper()} of the {side}" for side, kind in kinds)) or "no block"
            raise DataError(f"{path}: expected a BRDF{'' if told == 'auto' else f' of the {side}'}, found {words}")
        return [block for block, one in zip(blocks, kinds, strict=True) if one == (side, "brdf")]


def _bands(path: Path, content: str, names: list[list[str]]) -> tuple[list[str], list[float] | None]:
    """The blocks of a light in order, by name, and their wavelengths if they are bands."""
    if any(sorted(one) != sorted(names[0]) for one in names):
        raise DataError(f"{path}: expected the same wavelengths for all angles of the light, found others")
    if content == "xyz":
        if sorted(names[0]) != list(_TRISTIMULUS):
            raise DataError(
                f"{path}: TristimulusValue: expected TrisX, TrisY, TrisZ, found {shown(', '.join(names[0]))}"
            )
        return list(_TRISTIMULUS), None
    if len(names[0]) == 1:
        return names[0], None
    try:
        own = sorted(names[0], key=float)
    except ValueError:
        own = []
    waves = [float(one) for one in own]
    if not (waves and waves[0] > 0 and all(np.diff(waves) > 0) and waves[-1] < LONGEST):
        raise DataError(f"{path}: Wavelength: expected ones in nm that differ, found {shown(', '.join(names[0]))}")
    return own, waves


def _read(
    path: Path, lines: list[tuple[int, str]]
) -> tuple[dict[str, str], tuple[np.ndarray, np.ndarray], list[_Block]]:
    """What the header says, azimuths and radials in degrees, and the blocks."""
    said: dict[str, str] = {}
    axes: dict[str, np.ndarray] = {}
    at = 0
    while at < len(lines) and lines[at][1].lower() != "databegin":
        number, line = lines[at]
        word, *more = line.split(None, 1)
        rest = more[0] if more else ""
        at += 1
        if word.lower() in ("scatterazimuth", "scatterradial"):
            largest = 360 if word.lower() == "scatterazimuth" else 90
            axes[word.lower()], at = _axis(path, lines, at, number, rest, largest)
        else:
            said[word.lower()] = rest.strip().lower()
    if at == len(lines) or len(axes) != 2:
        raise DataError(f"{path}: expected ScatterAzimuth, ScatterRadial and DataBegin, found {shown(', '.join(said))}")
    if said.get("symmetry") not in _SYMMETRIES or said.get("spectralcontent") not in _CONTENTS:
        found = shown(f"{said.get('symmetry')}, {said.get('spectralcontent')}")
        raise DataError(f"{path}: expected a known Symmetry, and Monochrome or XYZ, found {found}")
    both = axes["scatterazimuth"], axes["scatterradial"]
    return said, both, _blocks(path, lines, at + 1, len(both[0]) * len(both[1]), said)


def _blocks(path: Path, lines: list[tuple[int, str]], at: int, size: int, header: Mapping[str, str]) -> list[_Block]:
    """The blocks up to DataEnd, so many numbers in each, with all words that they have."""
    given = {name: header[name] for name in _FOR_ALL if header.get(name)}
    blocks: list[_Block] = []
    words: dict[str, str] = {}
    while at < len(lines) and lines[at][1].lower() != "dataend":
        number, line = lines[at]
        name, *rest = line.split()
        at += 1
        own = [one for one in rest if one.lower() not in _UNITS]
        if name.isalpha() and name.lower() != "tis" and (len(own) == 1 or (own and name.lower() not in _WORDS)):
            words[name.lower()] = own[0]
        elif name.lower() == "tis" and words:
            values, at = _numbers(path, lines, at, number, size)
            blocks.append(_Block(given | words, values))
            check_unpacked(path, _BYTES_A_SAMPLE * size * len(blocks))
            words = {}
        else:
            expected = f"one of {', '.join(_WORDS)} and its value, or TIS"
            raise DataError(f"{path}: line {number}: expected {expected}, found {shown(line)}")
    if words or at == len(lines):
        raise DataError(f"{path}: expected DataEnd behind whole blocks, found the end; is the file cut?")
    return blocks


def _axis(
    path: Path, lines: list[tuple[int, str]], at: int, number: int, said: str, largest: float
) -> tuple[np.ndarray, int]:
    """Growing angles in degrees, as many as is said; they begin on the next line, or behind their count."""
    said, *begun = said.split(None, 1) or [""]
    if begun:
        at -= 1
        lines = [*lines[:at], (number, begun[0]), *lines[at + 1 :]]
    if not (said.isascii() and said.isdigit() and len(said) < 9 and 0 < int(said) <= _MOST_ANGLES):
        raise DataError(f"{path}: line {number}: expected a count of angles, found {shown(said)}")
    found, at = _numbers(path, lines, at, number, int(said))
    if not ((np.diff(found) > 0).all() and np.isfinite(found).all() and abs(found[-1]) <= largest >= abs(found[0])):
        expected = f"growing angles up to {largest:g} degrees"
        raise DataError(f"{path}: line {number}: expected {expected}, found {shown(found.tolist())}")
    return found, at


def _numbers(path: Path, lines: list[tuple[int, str]], at: int, number: int, size: int) -> tuple[np.ndarray, int]:
    """So many numbers on the lines that follow, and the line behind them."""
    found: list[str] = []
    while at < len(lines) and len(found) < size:
        found += lines[at][1].replace(",", " ").split()
        at += 1
    return parse_rows(path, [" ".join(found)], size, number + 1).numbers.reshape(-1), at
