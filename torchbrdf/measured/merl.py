"""MERL tables: isotropic BRDFs on 90 x 90 x 180 bins of half and difference angles.

Source: W. Matusik, H. Pfister, M. Brand, L. McMillan, A Data-Driven Reflectance Model, 2003,
doi:10.1145/882262.882343; the scales are those of the reading code that comes with the database.
"""

import math
import os
import struct
from collections.abc import Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError, ShapeError
from torchbrdf.files import replacing
from torchbrdf.measured.catalogue import merl_name
from torchbrdf.measured.format import FORMATS, BrdfFormat, Interpolation, Lookup, reopened
from torchbrdf.measured.grid import chunks, nearest_rows, nearest_valid, neighbours, normalized, weighted_rows
from torchbrdf.pairs import Pairs
from torchbrdf.precision import undisturbed
from torchbrdf.quantities import of_half_diff
from torchbrdf.reading import reading

BINS = (90, 90, 180)
COUNT = math.prod(BINS)
HEADER = struct.Struct("<3i")


class Layout(NamedTuple):
    """How a file of one kind is laid out: behind the dimensions the entries of red, green and blue.

    Attributes:
        bins: Of theta_h, theta_d and phi_d.
        kind: NumPy's type of an entry.
    """

    bins: tuple[int, int, int] = BINS
    kind: str = "<f8"

    @property
    def entries(self) -> int:
        """Entries of a channel."""
        return math.prod(self.bins)

    @property
    def item(self) -> int:
        """Bytes of an entry."""
        return np.dtype(self.kind).itemsize

    @property
    def bytes(self) -> int:
        """Bytes of a file."""
        return HEADER.size + 3 * self.item * self.entries

    def is_one(self, dims: Sequence[int], size: int) -> bool:
        """Whether a file of so many bytes, with these dimensions in front, has this layout; or may be a part of it."""
        return dims == self.bins and (size == self.bytes or (self == WHOLE and size != WHOLE_SINGLE.bytes))

    @property
    def slab(self) -> int:
        """Entries of one theta_h, of a channel."""
        return self.bins[1] * self.bins[2]


BYTES = Layout().bytes
CHANNEL_FACTORS = (1.0, 1.15, 1.66)
CHANNEL_SCALES = tuple(factor / 1500 for factor in CHANNEL_FACTORS)
"""What the entries of a file, red, green and blue, are multiplied by to be in 1/sr."""

LARGEST_DIRECT_LOOKUP = 1 << 15
"""Up to so many pairs, their neighbours are read from the file; for more, the whole table is."""
TABLES = 12
"""Whole tables kept in memory, 23 MB each in float32."""
LARGEST_ENTRY = 1e13
"""Larger entries, some 1e10 / sr, are no reflectance, and would overflow in sums of squares in float32."""
WHOLE, SINGLE, WHOLE_SINGLE = Layout((90, 90, 360)), Layout(kind="<f4"), Layout((90, 90, 360), "<f4")
"""Other kinds of files: phi_d all around, so that light and viewer can be told apart, and single precision."""


@FORMATS.register("merl")
class Merl(BrdfFormat):
    """The format of MERL's `.binary` tables, 35 MB each, read when values are asked for, one at a time.

    They are not memory-mapped: a file that is cut short while it is mapped ends the process.

    Bin i covers [i, i+1), and its value is that of its centre: theta_h = ((i+0.5)/90)^2 pi/2, theta_d and phi_d at
    i+0.5 degrees. `pairs` are the centres of all bins with both directions above the horizon, shared by all
    materials. An entry is invalid if a channel of it is negative, not finite or more than any reflectance is.
    """

    format = "merl"
    suffixes: ClassVar[tuple[str, ...]] = (".binary",)
    on_merl_bins = True
    is_reciprocal = True
    layout: ClassVar[Layout] = Layout()

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths = list(paths)
        self.names = [path.stem for path in paths]
        self._table = lru_cache(TABLES)(self._read_table)
        self._nearest_valid = lru_cache(TABLES)(self._find_nearest_valid)

    @cached_property
    def pairs(self) -> Pairs:  # type: ignore[override]
        """Directions of the bins' centres, `(1, N)`."""
        return bin_centers(self.layout.bins)

    @cached_property
    def _above(self) -> np.ndarray:
        return above_horizon(self.layout.bins)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as the paths of its files."""
        return reopened(self)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it is a MERL table, by the three dimensions in front, even if not quite right, or by the size."""
        size = path.stat().st_size
        if len(head) < HEADER.size:
            return False
        dims = HEADER.unpack_from(head)
        if any(other.is_one(dims, size) for other in (WHOLE, SINGLE, WHOLE_SINGLE)):
            return False
        plausible = all(0 < n <= 4096 for n in dims) and size == HEADER.size + 24 * math.prod(dims)
        return size == BYTES or plausible or {90, 180} <= {*dims} <= {90, 180, 360}

    @classmethod
    def open(cls, paths: Sequence[Path]) -> "Merl":
        """Open MERL tables; DataError for wrong dimensions, a wrong size, or no valid entry."""
        source = cls(paths)
        for material in range(len(paths)):
            source._check(material)
        return source

    def _check(self, material: int) -> None:
        path = self.paths[material]
        with reading(path, "a MERL table"), path.open("rb") as file:
            head = file.read(HEADER.size)
            size = os.fstat(file.fileno()).st_size
            whole, slab = self.layout.bytes, self.layout.slab
            first = [self._entries(file, k * self.layout.entries, slab) for k in range(3)] if size == whole else []
        if len(head) < HEADER.size:
            raise DataError(f"{path}: expected a MERL table of {whole} bytes, found {size}")
        _check_header(path, head, self.layout.bins)
        if size != whole:
            what = "truncated" if size < whole else "too long"
            raise DataError(f"{path}: {what}: expected {whole} bytes, found {size}")
        if _are_swapped(np.stack(first)):
            raise DataError(f"{path}: expected little-endian entries, found big-endian ones; swap the bytes of each")
        # The first theta_h, as a rule: the others are read only where it is empty.
        if not (_valid(first) & self._above[:slab]).any() and not (_valid(self._raw(material)) & self._above).any():
            bad = "negative, not finite, too large or below the horizon"
            raise DataError(f"{path}: no valid entry: all {self.layout.entries} are {bad}")

    def raw(self, material: int) -> np.ndarray:
        """The entries as the file has them, not scaled, `(3, 90, 90, 180)`."""
        return self._raw(material).reshape(3, *self.layout.bins)

    def _raw(self, material: int) -> np.ndarray:
        path = self.paths[material]
        with reading(path, "a MERL table"), path.open("rb") as file:
            return self._entries(file, 0, 3 * self.layout.entries).reshape(3, -1)

    def _some(self, material: int, bins: np.ndarray) -> list[np.ndarray]:
        """Entries of some bins, one array a channel: what is read goes from the first theta_h of them to the last."""
        if not len(bins):
            return [np.empty(0)] * 3
        slab, count = self.layout.slab, self.layout.entries
        start, stop = int(bins.min()) // slab * slab, (int(bins.max()) // slab + 1) * slab
        path, place = self.paths[material], bins - start
        with reading(path, "a MERL table"), path.open("rb") as file:
            return [self._entries(file, k * count + start, stop - start).take(place) for k in range(3)]

    def _entries(self, file: BinaryIO, start: int, count: int) -> np.ndarray:
        """Entries from one on; a DataError if the file ends before: it was cut short since it was opened."""
        file.seek(HEADER.size + self.layout.item * start)
        found = np.fromfile(file, self.layout.kind, count)
        if len(found) < count:
            size = os.fstat(file.fileno()).st_size
            raise DataError(f"{file.name}: truncated: expected {self.layout.bytes} bytes, found {size}")
        return found

    def _rows(self, material: int, bins: np.ndarray | slice = slice(None), *, dtype: type = np.float64) -> np.ndarray:
        """Values and validity of some bins, or of all, `(n, 4)`, as `grid` describes them."""
        part = list(self._raw(material)) if isinstance(bins, slice) else self._some(material, bins)
        valid = _valid(part) & self._above[bins]
        rows: np.ndarray = np.empty((len(valid), 4), dtype)
        for channel, scale in enumerate(CHANNEL_SCALES):
            rows[:, channel] = np.where(valid, part[channel], 0) * scale
        rows[:, 3] = valid
        return rows

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """Values and weights at the bin centres, float64; only these bins are read."""
        bins = _bin_rows(self.layout.bins)[samples].numpy()
        values = np.empty((len(materials), 3, len(bins)))
        weights = np.empty((len(materials), len(bins), 1))
        for k, material in enumerate(materials):
            part = self._some(material, bins)
            valid = _valid(part)
            with np.errstate(invalid="ignore", over="ignore"):  # of invalid entries
                for channel, scale in enumerate(CHANNEL_SCALES):
                    np.multiply(part[channel], scale, out=values[k, channel])
            if not valid.all():
                values[k][:, ~valid] = 0
            weights[k, :, 0] = valid
        return torch.from_numpy(values).mT, torch.from_numpy(weights)

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values at any pairs, trilinear or nearest in theta_h^(1/2), theta_d and phi_d, from the valid neighbours.

        phi_d is mirrored at its ends (reciprocity and isotropy: bin -1 is bin 0, bin 180 is bin 179); theta_h and
        theta_d keep the value of the last bin beyond its centre. Without a valid neighbour it is the value of the
        nearest valid bin.
        """
        values = pairs.cos_i.new_empty((len(materials), len(pairs), 3))
        filled = torch.zeros(len(materials), dtype=torch.int64, device=pairs.device)
        direct = len(pairs) <= LARGEST_DIRECT_LOOKUP
        for part, chunk in chunks(pairs):
            for row, material in enumerate(materials):
                if row < pairs.shape[0]:
                    own = chunk.select([row])
                    above = own.above_horizon[0]
                    position = self._position(own)
                    centre = nearest_rows(position, self.layout.bins)
                    if interpolation == "nearest":
                        index, weight = centre[:, None], torch.ones_like(position[0])[:, None]
                    else:
                        index, weight = neighbours(position, self.layout.bins)
                found, missing = normalized(self._weighted(material, index, weight, direct))
                missing &= above
                if missing.any():
                    place = self._nearest_valid(material)[centre[missing].cpu().numpy()]
                    found[missing] = torch.from_numpy(self._rows(material, place)[:, :3]).to(found)
                    filled[row] += missing.sum()
                values[row, part] = torch.where(above[:, None], found, 0)
        return Lookup(values, filled)

    def _position(self, pairs: Pairs) -> list[Tensor]:
        """Fractional bins, 0 at the centre of bin 0, of `(1, N)` pairs."""
        theta_h = (pairs.theta_h[0] * (2 / math.pi)).sqrt() * 90
        return [theta_h - 0.5, pairs.theta_d[0] * (180 / math.pi) - 0.5, self._phi_d(pairs) * (180 / math.pi) - 0.5]

    def _phi_d(self, pairs: Pairs) -> Tensor:
        """phi_d as the table has it, radians, `(N,)`."""
        return pairs.phi_d[0]

    def _weighted(self, material: int, index: Tensor, weight: Tensor, direct: bool) -> Tensor:
        if not direct:
            return weighted_rows(self._table(material, weight.dtype, weight.device), index, weight)
        rows = torch.from_numpy(self._rows(material, index.flatten().cpu().numpy())).to(weight)
        return (rows.view(*index.shape, 4) * weight[..., None]).sum(1)

    def _read_table(self, material: int, dtype: torch.dtype, device: torch.device) -> Tensor:
        rows = self._rows(material, dtype=np.float64 if dtype == torch.float64 else np.float32)
        return torch.from_numpy(rows).to(device, dtype)

    def _find_nearest_valid(self, material: int) -> np.ndarray:
        return nearest_valid((_valid(self._raw(material)) & self._above).reshape(self.layout.bins))

    def details(self, material: int) -> dict[str, object]:
        """The shares of invalid entries, and the name that MERL gave the file, if it is one of theirs."""
        valid, above = _valid(self._raw(material)), self._above
        return {
            "invalid share of all bins": float((~(valid & above)).mean()),
            "invalid share of bins above the horizon": float((~valid[above]).mean()),
            "MERL's own": merl_name(self.paths[material]) or "no: the checksum is none of MERL's",
        }


def write_merl(path: str | Path, values: np.ndarray | Tensor) -> None:
    """Write a MERL table from BRDF values.

    Reading gives the same doubles bit for bit where the format can say them, which is so for all values that were
    read from a MERL table; as a product with the scale is rounded, other values may come back one rounding off.

    Args:
        path: The file, which appears when it is complete.
        values: In 1/sr without the cosine, at the centres of the bins of theta_h, theta_d and phi_d,
            `(90, 90, 180, 3)`; nan or negative is invalid.

    Raises:
        ShapeError: The values have another shape.
        DataError: The file cannot be written.
    """
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (*BINS, 3):
        raise ShapeError(f"{path}: expected values (90, 90, 180, 3), found {values.shape}")
    valid = _valid(np.moveaxis(values, -1, 0))
    raw = np.full((3, *BINS), -1.0)
    for channel, scale in enumerate(CHANNEL_SCALES):
        wanted = values[..., channel][valid]
        entry = wanted / scale
        for toward in (-np.inf, np.inf):
            near = np.nextafter(entry, toward)
            entry = np.where((entry * scale != wanted) & (near * scale == wanted), near, entry)
        raw[channel][valid] = entry
    write_raw(path, raw)


def write_raw(path: str | Path, raw: np.ndarray) -> None:
    """Write a MERL table from entries as `Merl.raw` gives them: bit for bit the same file.

    Args:
        path: The file, which appears when it is complete.
        raw: Entries that are not scaled, `(3, 90, 90, 180)`.

    Raises:
        ShapeError: The entries have another shape.
        DataError: The file cannot be written.
    """
    if raw.shape != (3, *BINS):
        raise ShapeError(f"{path}: expected entries (3, 90, 90, 180), found {raw.shape}")
    with replacing(path) as part, part.open("wb") as file:
        file.write(HEADER.pack(*BINS))
        file.write(np.ascontiguousarray(raw, "<f8").data)


def bin_centers(bins: tuple[int, int, int] = BINS) -> Pairs:
    """Directions of the centres of a table's bins, `(1, N)`, in the order of the table; the same Pairs each time.

    Only bins with both directions above the horizon.
    """
    return _bin_centers(bins)


def above_horizon(bins: tuple[int, int, int] = BINS) -> np.ndarray:
    """Whether both directions of each bin's centre are above the horizon, `(K,)` of K bins."""
    return _above_horizon(bins)


@lru_cache(2)
@undisturbed()
def _bin_centers(bins: tuple[int, int, int]) -> Pairs:
    theta_h, theta_d, phi_d = (torch.from_numpy(centre) for centre in _centres(bins))
    known = of_half_diff(theta_h[:, None, None], theta_d[:, None], phi_d)  # sines of so many angles as bins have
    return Pairs(**{name: value.expand(bins).flatten()[_bin_rows(bins)][None] for name, value in known.items()})


@lru_cache(2)
@undisturbed()
def _bin_rows(bins: tuple[int, int, int]) -> Tensor:
    return torch.from_numpy(np.flatnonzero(_above_horizon(bins)))


@lru_cache(2)
def _above_horizon(bins: tuple[int, int, int]) -> np.ndarray:
    h, d, phi = np.ix_(*_centres(bins))
    above: np.ndarray = (np.cos(h) * np.cos(d) > np.sin(h) * np.sin(d) * np.abs(np.cos(phi))).reshape(-1)
    return above


def _centres(bins: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    h, d, phi = (np.arange(size) + 0.5 for size in bins)
    return (h / 90) ** 2 * (math.pi / 2), d / 90 * (math.pi / 2), phi / 180 * math.pi


def _valid(channels: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """Where all channels are finite, not negative and not beyond all measure."""
    return np.logical_and.reduce([(entries >= 0) & (entries <= LARGEST_ENTRY) for entries in channels])


def _check_header(path: Path, head: bytes, bins: tuple[int, int, int]) -> None:
    """A DataError that says what a table of other dimensions seems to be."""
    dims = HEADER.unpack(head)
    if dims == bins:
        return
    if struct.unpack(">3i", head) == bins:
        raise DataError(
            f"{path}: header: expected little-endian numbers, found big-endian ones; swap the bytes of the header's "
            "int32 and of every float64"
        )
    hint = ""
    if sorted(dims) == sorted(bins):
        hint = "; they are in another order"
    raise DataError(f"{path}: header: expected {_by(bins)} bins (theta_h, theta_d, phi_d), found {_by(dims)}{hint}")


def _are_swapped(entries: np.ndarray) -> bool:
    """Whether entries mean little, and much if their bytes are swapped."""
    share, other = (np.mean(_means_something(one)) for one in (entries, entries.byteswap()))
    return bool(share < 0.5 < other)


def _means_something(entries: np.ndarray) -> np.ndarray:
    """Where numbers are 0, or of a size that people use."""
    with np.errstate(invalid="ignore"):
        size = np.abs(entries)
        return (size == 0) | ((size > 1 / LARGEST_ENTRY) & (size < LARGEST_ENTRY))


def _by(dims: Sequence[int]) -> str:
    return " x ".join(str(n) for n in dims)
