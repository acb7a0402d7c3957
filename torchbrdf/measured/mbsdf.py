"""Measured BSDFs of NVIDIA's MDL: tables over the angles of light and viewer and the azimuth between them.

Source: NVIDIA Material Definition Language, Language Specification, appendix on the MBSDF file format; and the MDL SDK.
"""

import math
import struct
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.format import FORMATS, Interpolation
from torchbrdf.measured.grid import nearest_rows, neighbours
from torchbrdf.measured.gridded import GriddedFormat, polar
from torchbrdf.measured.listed import QUANTITIES, Listed
from torchbrdf.reading import check_unpacked, read_bytes

MAGIC = b"NVIDIA ARC MBSDF"
_EXPECTED = "a measured BSDF of MDL"
_VERSION = b"NVIDIA ARC MBSDF V1\n"
_PARTS = {
    b"MBSDF_DATA=": "reflection",
    b"MBSDF_DATA_REFLECTION=": "reflection",
    b"MBSDF_DATA_TRANSMISSION=": "transmission",
}
_CHANNELS = {0: 1, 1: 3}
# Of a sample while it is read: its number and its directions.
_BYTES_A_SAMPLE = 160
# Of the text in front of the tables.
_LONGEST_LINE = 1 << 16


class _Part(NamedTuple):
    """A table, `(theta_i, theta_o, phi, channels)`."""

    name: str
    values: np.ndarray


class _Cells:
    """Cells of theta_i, theta_o and phi, equally wide on each axis, whose values count at their middles.

    Args:
        shape: How many there are on each axis.
        mirror: Where the mirror direction lies: at phi of 180 or of 0 degrees.
    """

    is_anisotropic = False

    def __init__(self, shape: tuple[int, int, int], mirror: str) -> None:
        self.shape, self.opposite = shape, mirror == "180"

    def angles(self) -> np.ndarray:
        """theta_i, phi_i, theta_o and phi_o of the middles, radians, `(N, 4)`."""
        theta, phi = (
            (np.arange(size) + 0.5) / size * whole for size, whole in zip(self.shape[1:], _RANGES, strict=True)
        )
        light, viewer, turn = (part.reshape(-1) for part in np.meshgrid(theta, theta, phi, indexing="ij"))
        return np.stack([light, 0 * light, viewer, turn if self.opposite else math.pi - turn], -1)

    def around(self, wi: Tensor, wo: Tensor, interpolation: Interpolation) -> tuple[Tensor, Tensor]:
        """The cells about pairs: on each axis the two between whose middles they are."""
        (theta_i, phi_i), (theta_o, phi_o) = polar(wi), polar(wo)
        turn = (phi_i - phi_o).abs()
        turn = torch.minimum(turn, 2 * math.pi - turn)
        phi = turn if self.opposite else math.pi - turn
        whole = (_RANGES[0], *_RANGES)
        places = [
            x / width * size - 0.5 for x, width, size in zip((theta_i, theta_o, phi), whole, self.shape, strict=True)
        ]
        if interpolation == "nearest":
            return nearest_rows(places, self.shape)[:, None], torch.ones_like(theta_i)[:, None]
        return neighbours(places, self.shape)


# Of an angle from the normal, and of the azimuth between light and viewer.
_RANGES = (math.pi / 2, math.pi)


@FORMATS.register("mbsdf")
class Mbsdf(GriddedFormat):
    """The format of `.mbsdf` files, isotropic, grey or RGB; only the reflection is read.

    Cells are equally wide in theta_i, theta_o and phi, and between their middles values are linear, as in the MDL SDK;
    beyond the first and the last they are constant.
    """

    format = "mbsdf"
    settings: ClassVar = {"quantity": QUANTITIES, "mirror": ("180", "0")}

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is such a file, by its first line."""
        return head.startswith(MAGIC)

    def gridded(self, path: Path) -> tuple[Listed, _Cells]:
        """What a file says."""
        data = read_bytes(path, _EXPECTED)
        if not data.startswith(_VERSION):
            raise DataError(f"{path}: expected {_VERSION[:-1].decode()!r}, found {shown(data[: len(_VERSION)])}")
        said, parts = _read(path, data)
        names = [part.name for part in parts]
        if names.count("reflection") != 1:
            raise DataError(f"{path}: expected one reflection, found {' and '.join(names) or 'no table'}")
        values = parts[names.index("reflection")].values
        mirror = self.setting("mirror", "180")
        size = values.shape
        facts: dict[str, object] = {
            "angles": f"the azimuth between light and viewer; the mirror direction is at {mirror} degrees",
            "table": f"{size[0]} x {size[1]} x {size[2]} cells of theta_i, theta_o and phi",
            "parts": f"{' and '.join(names)}; the reflection is read",
        }
        if said:
            facts["says"] = shown("; ".join(said), 200)
        cells = _Cells(size[:3], mirror)
        listed = Listed(cells.angles(), values.reshape(-1, size[3]), None, self.setting("quantity", "brdf"), facts)
        return listed, cells


def _read(path: Path, data: bytes) -> tuple[list[str], list[_Part]]:
    """Lines in front of the tables, and the tables."""
    said: list[str] = []
    parts: list[_Part] = []
    place = len(_VERSION)
    while place < len(data):
        end = data.find(b"\n", place, place + _LONGEST_LINE)
        line = data[place : end if end >= 0 else place + 30]
        if line in _PARTS and end >= 0:
            part, place = _table(path, data, end + 1, _PARTS[line])
            parts.append(part)
        elif end >= 0 and not parts:
            said.append(line.decode("latin-1"))
            place = end + 1
        else:
            raise DataError(f"{path}: byte {place}: expected one of {b', '.join(_PARTS).decode()}, found {shown(line)}")
    return said, parts


def _table(path: Path, data: bytes, place: int, name: str) -> tuple[_Part, int]:
    """A table, and where it ends."""
    if len(data) < place + 12:
        raise DataError(f"{path}: {name}: expected kind and resolution, found {len(data) - place} bytes")
    kind, polar_size, turns = struct.unpack_from("<3I", data, place)
    if kind not in _CHANNELS or not polar_size or not turns:
        expected = "expected kind 0 or 1 and a resolution of 1 x 1 or more"
        raise DataError(f"{path}: {name}: {expected}, found {kind} and {polar_size} x {turns}")
    count = polar_size * polar_size * turns * _CHANNELS[kind]
    there = len(data) - place - 12
    if 4 * count > there:
        raise DataError(f"{path}: {name}: expected {4 * count} bytes of {polar_size} x {turns} angles, found {there}")
    check_unpacked(path, _BYTES_A_SAMPLE * count)
    values = np.frombuffer(data, "<f4", count, place + 12).astype(np.float64)
    shape = (polar_size, polar_size, turns, _CHANNELS[kind])
    return _Part(name, values.reshape(shape)), place + 12 + 4 * count
