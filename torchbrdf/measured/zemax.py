"""BSDF interchange text of Zemax OpticStudio and LightTools: tables of scatter angles about the mirror direction."""

import math
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.format import FORMATS
from torchbrdf.measured.listed import Listed, ListedFormat
from torchbrdf.measured.rows import head_lines, parse_rows, text_lines

_EXPECTED = "a BSDF interchange file"
_AXES = ("samplerotation", "angleofincidence", "scatterazimuth", "scatterradial")
# Of XYZ, the luminance; tables of the others are passed over.
_KNOWN = {
    "Symmetry": ("PlaneSymmetrical", "ASymmetrical", "ASymmetrical4D"),
    "SpectralContent": ("Monochrome", "XYZ"),
}
# Of these a header has two at least.
_NAMES = {"scattertype", "symmetry", "spectralcontent", "scatterazimuth", "scatterradial", "samplerotation"}
_LARGEST = 100_000
_NOT_MEASURED = 0.0


@FORMATS.register("zemax")
class Zemax(ListedFormat):
    """The format of `.bsdf` text files of Zemax OpticStudio and LightTools, in degrees.

    A scattered direction is given by `ScatterRadial`, its angle from the mirror direction, and `ScatterAzimuth` about
    that, 0 towards the normal. A value of exactly 0 was not measured: it stands where instruments do not reach.
    Tables of XYZ are read by their luminance, as grey.
    """

    format = "zemax"

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is an interchange file, by names that its header has."""
        names = {line.split(None, 1)[0].lower() for line in head_lines(path, head)}
        return len(_NAMES & names) > 1

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        lines = [line.partition("#")[0].strip() for line in text_lines(path, _EXPECTED)]
        words = {line.split(None, 1)[0].lower(): line.split()[1:] for line in lines if line}
        said = {key: " ".join(words.get(key, [])) for key in ("scattertype", "symmetry", "spectralcontent", "source")}
        if said["scattertype"].lower() != "brdf":
            raise DataError(f"{path}: ScatterType: expected BRDF, found {shown(said['scattertype'])}")
        for key, known in _KNOWN.items():
            if said[key.lower()].lower() not in map(str.lower, known):
                raise DataError(f"{path}: {key}: expected {', '.join(known)}, found {shown(said[key.lower()])}")
        facts: dict[str, object] = {}
        axes = [_axis(path, lines, name, facts) for name in _AXES]
        shape = [len(axis) for axis in axes]
        if math.prod(shape) > _LARGEST * 100:
            raise DataError(f"{path}: expected at most {100 * _LARGEST} values, found a table of {math.prod(shape)}")
        values = _values(path, lines, shape, said["spectralcontent"].lower())
        rotation, incidence, azimuth, radial = (np.radians(one) for one in np.meshgrid(*axes, indexing="ij"))
        facts |= {"angles": "degrees, about the mirror direction", "symmetry": said["symmetry"]}
        facts |= {"content": said["spectralcontent"], "source": said["source"]}
        # With light from +x the mirror direction lies towards -x.
        toward = np.stack([np.cos(incidence), 0 * incidence, np.sin(incidence)], -1)
        mirror = np.stack([-np.sin(incidence), 0 * incidence, np.cos(incidence)], -1)
        across = np.stack([0 * incidence, 1 + 0 * incidence, 0 * incidence], -1)
        turned = toward * np.cos(azimuth)[..., None] + across * np.sin(azimuth)[..., None]
        wo = (mirror * np.cos(radial)[..., None] + turned * np.sin(radial)[..., None]).reshape(-1, 3)
        theta_o = np.arctan2(np.hypot(wo[:, 0], wo[:, 1]), wo[:, 2])
        turn, light = -rotation.reshape(-1), incidence.reshape(-1)
        between, values = np.arctan2(wo[:, 1], wo[:, 0]), values.reshape(-1, 1)
        angles = np.stack([light, turn, theta_o, between + turn], -1)
        if (
            said["symmetry"].lower() == _KNOWN["Symmetry"][0].lower() and shape[0] > 1
        ):  # of one rotation it would say nothing more
            angles = np.concatenate([angles, np.stack([light, turn, theta_o, turn - between], -1)])
            values = np.concatenate([values, values])
            facts["mirrored"] = "at the plane of incidence, as the symmetry says"
        return Listed(angles, values, None, self.setting("quantity", "brdf"), facts)


def _axis(path: Path, lines: list[str], name: str, facts: dict[str, object]) -> np.ndarray:
    """The angles of an axis: their count behind its name, and themselves behind it or in the lines that follow.

    Where these are more or fewer than their count, they are believed: the table has to have as many rows.
    """
    at = next((k for k, line in enumerate(lines) if line.split()[:1] and line.split()[0].lower() == name), None)
    if at is None and name == _AXES[0]:
        return np.zeros(1)
    if at is None:
        raise DataError(f"{path}: expected a line {name}, found none")
    first, *rest = lines[at].split()
    said, *found = rest or [""]
    if not (said.isascii() and said.isdigit() and len(said) < 9 and 0 < int(said) <= _LARGEST):
        raise DataError(f"{path}: {first}: expected a count of angles, found {shown(' '.join([said, *found]))}")
    for line in filter(None, lines[at + 1 :]):
        if len(found) >= int(said) or line[0].isalpha():
            break
        found += line.split()
    if not found:
        raise DataError(f"{path}: {first}: expected {said} angles, found none")
    if len(found) != int(said):
        facts[first] = f"the file says {said}, and lists {len(found)}; these were believed"
    return parse_rows(path, [" ".join(found)], len(found), at + 2).numbers.reshape(-1)


def _values(path: Path, lines: list[str], shape: list[int], content: str) -> np.ndarray:
    """The table, `(rotations, incidences, azimuths, radials)`, nan where nothing was measured."""
    low = [line.lower() for line in lines]
    begins = [k for k, line in enumerate(low) if line == "databegin"]
    wanted = 1 if content == "xyz" else 0  # X, Y, Z behind each other: Y
    if len(begins) <= wanted:
        raise DataError(f"{path}: expected DataBegin, found {len(begins)} of them")
    last = max((k for k, line in enumerate(low) if line == "dataend"), default=len(lines))
    rest = next((line for line in lines[last + 1 :] if line and line[0] != "#"), "")
    if rest:
        raise DataError(f"{path}: expected the file's end behind the last DataEnd, found {shown(rest, 40)}")
    start = begins[wanted]
    end = next((k for k in range(start, len(low)) if low[k] == "dataend"), len(lines))
    rows = ["#" if line.lower().startswith("tis") else line for line in lines[start + 1 : end]]
    words = " ".join(row for row in rows if row != "#").split()
    if len(words) == math.prod(shape) and any(row not in ("", "#") and len(row.split()) != shape[-1] for row in rows):
        rows = [" ".join(words[k : k + shape[-1]]) for k in range(0, len(words), shape[-1])]
    found = parse_rows(path, rows, shape[-1], start + 2).numbers
    if len(found) != math.prod(shape[:-1]):
        raise DataError(f"{path}: expected {math.prod(shape[:-1])} rows of values, found {len(found)}")
    return np.where(found == _NOT_MEASURED, np.nan, found).reshape(shape)
