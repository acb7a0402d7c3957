"""Fourier BSDFs of pbrt: for each pair of cosines a series of cosines of the azimuth between light and viewer.

Source: W. Jakob, E. d'Eon, O. Jakob, S. Marschner, A Comprehensive Framework for Rendering Layered Materials, 2014,
doi:10.1145/2601097.2601139; M. Pharr, W. Jakob, G. Humphreys, Physically Based Rendering, third edition, 2016, 8.6.
"""

import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.format import FORMATS, Interpolation, Lookup
from torchbrdf.measured.grid import weighted_rows
from torchbrdf.measured.gridded import crossed, polar
from torchbrdf.measured.listed import LEAST_COSINE, Listed, ListedFormat
from torchbrdf.pairs import Pairs
from torchbrdf.reading import check_unpacked, largest, read_bytes

MAGIC = b"SCATFUN"
_EXPECTED = "a Fourier BSDF of pbrt"
_VERSION = MAGIC + b"\x01"
_GZIP = b"\x1f\x8b"
_HEADER = 64
# Of a packed file, enough to unpack the first bytes.
_PACKED_HEAD = 1 << 14
_LARGEST = 1 << 20
# Of pbrt: green of luminance, red and blue, by the primaries of ITU-R BT.709.
_GREEN = (1.39829, -0.297375, -0.100913)
# Samples: at so many of the file's cosines of each direction at most, and at so many azimuths, closer about the mirror
# direction.
_COSINES, _AZIMUTHS = 64, 25
# Numbers that are held at once while series are summed.
_HELD = 1 << 23


class _Series(NamedTuple):
    """The reflecting half of a file.

    Attributes:
        light: Cosines of light, growing from 0 on, `(I,)`.
        viewer: Cosines of viewer, `(O,)`.
        terms: Coefficients of f |cos_i|, float32, `(I O, C K)`: those of a pair of cosines in a row.
        channels: C: 1 of grey, 3 of linear RGB.
    """

    light: Tensor
    viewer: Tensor
    terms: Tensor
    channels: int

    def at(self, wi: Tensor, wo: Tensor, interpolation: Interpolation) -> Tensor:
        """The BRDF of pairs, `(N, C)`, in 1/sr."""
        (_, phi_i), (_, phi_o) = polar(wi), polar(wo)
        turn = phi_o - phi_i + math.pi  # 0 at the mirror direction
        length = self.terms.shape[1] // self.channels
        order = torch.arange(length, dtype=wi.dtype, device=wi.device)
        terms = self.terms.to(wi.device)
        found = wi.new_empty(len(wi), self.channels)
        for part in torch.arange(len(wi), dtype=torch.int64, device=wi.device).split(
            max(1, _HELD // (self.terms.shape[1] + length))
        ):
            light, share = _spline(self.light.to(wi), wi[part, 2], interpolation)
            viewer, weight = _spline(self.viewer.to(wi), wo[part, 2], interpolation)
            rows = (light[:, :, None] * len(self.viewer) + viewer[:, None, :]).flatten(1)
            counted = (share[:, :, None] * weight[:, None, :]).flatten(1).to(terms)
            series = weighted_rows(terms, rows, counted).to(wi).view(-1, self.channels, length)
            found[part] = torch.bmm(series, torch.cos(turn[part, None] * order)[..., None])[..., 0]
        return found.clamp_min(0) / wi[:, 2:].clamp_min(LEAST_COSINE)


@FORMATS.register("fourier")
class Fourier(ListedFormat):
    """The format of pbrt's Fourier `.bsdf` files, isotropic, grey or RGB, plain or packed by gzip; of its reflection.

    A series is that of pbrt: its coefficients are Catmull-Rom splines over the cosines of light and viewer, here over
    the reflecting half alone; its sum is f |cos_i|, and 0 where it is below. As "nearest" it is that of the nearest
    cosines. Samples are taken at the file's cosines, and at 25 azimuths.
    """

    format = "fourier"
    settings: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    is_sampled: ClassVar[bool] = False

    def __init__(self, paths: Sequence[Path], settings: Mapping[str, str] | None = None) -> None:
        super().__init__(paths, settings)
        self.names = [self.name_of(path) for path in paths]

    @classmethod
    def name_of(cls, path: Path) -> str:
        """Without the suffix below that of gzip."""
        return path.stem.removesuffix(".bsdf")

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is such a file, by its first bytes, also where it is packed."""
        if not head.startswith(_GZIP):
            return head.startswith(MAGIC)
        try:
            with path.open("rb") as file:
                return zlib.decompressobj(31).decompress(file.read(_PACKED_HEAD), len(MAGIC)) == MAGIC
        except (OSError, zlib.error):
            return False

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        data, packed = _unpacked(path)
        series, facts = _read(path, data)
        light, viewer = (one[:: -(-len(one) // _COSINES)].numpy() for one in (series.light, series.viewer))
        turns = math.pi * np.linspace(0, 1, _AZIMUTHS) ** 2
        check_unpacked(path, 100 * len(light) * len(viewer) * len(turns))
        seen = np.stack([part.reshape(-1) for part in np.meshgrid(np.arccos(viewer), turns, indexing="ij")], -1)
        angles = crossed(np.stack([np.arccos(light), np.full_like(light, math.pi)], -1), seen)
        pairs = [torch.from_numpy(one) for one in Listed(angles, angles, None).directions()]
        values = series.at(pairs[0], pairs[1], "linear").numpy()
        if packed:
            facts["packed"] = "by gzip"
        return Listed(angles, values, None, facts=facts, table=series)

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values at any pairs, the sums of their series."""
        values = pairs.cos_i.new_zeros((len(materials), len(pairs), self.channels))
        for row, material in enumerate(materials):
            own = pairs.select([row if pairs.shape[0] > 1 else 0])
            series: _Series = self._read[material].table
            found = series.at(own.wi[0], own.wo[0], interpolation)
            # As many channels as all files have.
            found = found.expand(-1, values.shape[2]) if found.shape[1] == 1 else found
            values[row] = torch.where(own.above_horizon[0, :, None], found, 0)
        return Lookup(values, torch.zeros(len(materials), dtype=torch.int64, device=pairs.device))


def _spline(knots: Tensor, x: Tensor, interpolation: Interpolation) -> tuple[Tensor, Tensor]:
    """Knots about each x and what their values count, `(N, 4)`, for a Catmull-Rom spline; one for the nearest.

    Source: E. Catmull, R. Rom, A Class of Local Interpolating Splines, 1974.
    """
    last = len(knots) - 1
    x = x.clamp(knots[0], knots[-1])
    low = (torch.searchsorted(knots, x.contiguous(), right=True) - 1).clamp(0, max(last - 1, 0))
    high = (low + 1).clamp(max=last)
    width = torch.where(high > low, knots[high] - knots[low], 1)
    t = (x - knots[low]) / width
    if interpolation == "nearest" or last == 0:
        return torch.where(t < 0.5, low, high)[:, None], torch.ones_like(x)[:, None]
    before, behind = (low - 1).clamp_min(0), (high + 1).clamp(max=last)
    # Slopes at both ends are those over the neighbours, one-sided at the ends of the knots.
    into, out = width / (knots[high] - knots[before]), width / (knots[behind] - knots[low])
    start, end = t * (t - 1) ** 2, t**2 * (t - 1)
    at_low, at_high = (2 * t - 3) * t**2 + 1, (3 - 2 * t) * t**2
    weights = [-start * into, at_low - end * out, at_high + start * into, end * out]
    return torch.stack([before, low, high, behind], -1), torch.stack(weights, -1)


def _unpacked(path: Path) -> tuple[bytes, bool]:
    """The bytes of a file, which gzip may have packed."""
    data = read_bytes(path, _EXPECTED)
    if not data.startswith(_GZIP):
        return data, False
    unpacking = zlib.decompressobj(31)
    try:
        found = unpacking.decompress(data, largest() + 1)
        check_unpacked(path, len(found))
    except zlib.error as error:
        raise DataError(f"{path}: expected {_EXPECTED} packed by gzip, found damage: {error}") from None
    if not unpacking.eof or unpacking.unused_data:
        found_here = "bytes behind it" if unpacking.eof else "one that is cut"
        raise DataError(f"{path}: expected {_EXPECTED} packed by gzip, found {found_here}")
    return found, True


def _read(path: Path, data: bytes) -> tuple[_Series, dict[str, object]]:
    """The reflecting half of a file, and what there is to say about it."""
    if not data.startswith(_VERSION) or len(data) < _HEADER:
        raise DataError(f"{path}: expected {_EXPECTED}, version 1, found {shown(data[:8])} and {len(data)} bytes")
    flags, size, count, order, channels, bases, said, *more = struct.unpack_from("<9i", data, len(MAGIC) + 1)
    (eta,) = struct.unpack_from("<f", data, 44)
    if flags != 1 or channels not in (1, 3) or bases != 1 or any(more):
        found = f"{flags}, {channels}, {bases} and {sum(more)}"
        raise DataError(f"{path}: expected flags 1, 1 or 3 channels, 1 basis and no parameters, found {found}")
    if not (1 < size <= _LARGEST and count > 0 and 0 < order <= _LARGEST and said >= 0):
        found = f"{size}, {count} and {order}"
        raise DataError(f"{path}: expected counts of cosines, coefficients and orders above 0, found {found}")
    expected = _HEADER + 4 * size + 12 * size * size + 4 * count + said
    if len(data) != expected:
        raise DataError(f"{path}: expected {expected} bytes for {size} cosines, found {len(data)}")
    nodes = np.frombuffer(data, "<f4", size, _HEADER).astype(np.float64)
    place = _HEADER + 4 * size + 4 * size * size  # behind what pbrt draws directions with
    lists = np.frombuffer(data, "<i4", 2 * size * size, place).reshape(size, size, 2)
    coefficients = np.frombuffer(data, "<f4", count, place + 8 * size * size)
    half = size // 2
    if not (np.isfinite(nodes).all() and (np.diff(nodes) >= 0).all() and np.abs(nodes).max() <= 1 + 1e-6):
        raise DataError(f"{path}: expected growing cosines from -1 to 1, found {shown(nodes[:6].tolist())}")
    light, viewer = _rising(path, -nodes[:half][::-1]), _rising(path, nodes[size - half :])
    # Of light the file has the cosine of where it goes to: below 0. The viewer comes first.
    own = lists[size - half :, :half][:, ::-1].transpose(1, 0, 2).reshape(-1, 2).astype(np.int64)
    terms = _terms(path, own, coefficients, channels, order)
    facts: dict[str, object] = {
        "angles": "cosines, and the azimuth between light and viewer; 0 at the mirror direction",
        "quantity": "f |cos_i|; divided by it",
        "series": f"{half} x {half} cosines, up to {int(own[:, 1].max(initial=0))} terms, splines between",
        "index of refraction": round(float(eta), 4) if math.isfinite(eta) else None,
    }
    if said:
        facts["says"] = shown(data[-said:].decode("utf-8", "replace"), 200)
    return _Series(torch.from_numpy(light), torch.from_numpy(viewer), torch.from_numpy(terms), channels), facts


def _rising(path: Path, cosines: np.ndarray) -> np.ndarray:
    """Cosines of one half, which grow from 0 on."""
    if not (len(cosines) and cosines[0] >= 0 and (np.diff(cosines) > 0).all() and cosines[-1] > LEAST_COSINE):
        raise DataError(f"{path}: expected as many cosines above as below 0, found {shown(cosines[:6].tolist())}")
    return np.minimum(cosines, 1)


def _terms(path: Path, lists: np.ndarray, coefficients: np.ndarray, channels: int, order: int) -> np.ndarray:
    """Coefficients of all pairs, as many for each, `(pairs, channels * longest)`, float32, as RGB."""
    first, length = lists.T
    if not ((length >= 0) & (length <= order) & (first >= 0) & (first + length * channels <= len(coefficients))).all():
        bad = lists[(length < 0) | (length > order) | (first < 0) | (first + length * channels > len(coefficients))][0]
        raise DataError(f"{path}: expected lists of up to {order} of the coefficients, found {shown(bad.tolist())}")
    longest = int(length.max(initial=0))
    if not longest:
        raise DataError(f"{path}: expected a reflection, found none")
    check_unpacked(path, 8 * len(lists) * channels * longest)
    terms = np.zeros((len(lists), channels, longest), np.float32)
    for k, (start, own) in enumerate(lists.tolist()):
        terms[k, :, :own] = coefficients[start : start + channels * own].reshape(channels, own)
    if not np.isfinite(terms).all() or np.abs(terms).max() > 1e8:
        raise DataError(f"{path}: expected finite coefficients, found {shown(float(np.abs(terms).max()))}")
    if channels == 3:  # luminance, red, blue
        light, red, blue = (terms[:, k] for k in range(3))
        green = _GREEN[0] * light + _GREEN[1] * red + _GREEN[2] * blue
        terms = np.stack([red, green, blue], 1)
    return terms.reshape(len(lists), -1)
