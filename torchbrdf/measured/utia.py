"""UTIA's database of anisotropic BRDFs: tables over the angles of both directions.

Source: J. Filip, R. Vavra, Template-Based Sampling of Anisotropic BRDFs, Computer Graphics Forum 33 (7), 2014; the
database is at http://btf.utia.cas.cz. No file of it could be had: the layout is that of the readers that its authors
and others published, and what these disagree about is a setting.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.measured.angles import direction
from torchbrdf.measured.format import FORMATS, BrdfFormat, Interpolation, Lookup, reopened
from torchbrdf.measured.grid import chunks, interpolate, nearest_rows, nearest_valid
from torchbrdf.measured.listed import LARGEST_VALUE
from torchbrdf.pairs import Pairs
from torchbrdf.reading import read_bytes

STEP, TURN = 15.0, 7.5
"""Degrees between angles from the normal, 0 to 75, and between azimuths, all around."""
SHAPE = (6, 48, 6, 48)
"""Of a channel: theta_i, phi_i, theta_o, phi_o."""
BYTES = 3 * 8 * math.prod(SHAPE)
"""1,990,656: red, then green, then blue, 82,944 doubles each; no header."""
# With the first azimuth behind the last.
_AROUND = (6, 49, 6, 49)
ENCODINGS = ("linear", "srgb", "srgb_140")


@FORMATS.register("utia")
class Utia(BrdfFormat):
    """The format of UTIA's `.bin` files, 1,990,656 bytes, anisotropic, RGB.

    `pairs` are all pairs of directions, theta from 0 to 75 degrees by 15, phi by 7.5. Between them values are linear in
    the four angles; **beyond 75 degrees** a direction has the value of its azimuth at 75. Negative values are kept; an
    entry with a channel that is not finite, or larger than any reflectance, is invalid.

    What files do not say: `quantity`, and `encoding`. The database's own reader takes values as they are (`linear`),
    another one as sRGB (`srgb`), a third as sRGB of the 140th part, times 100 (`srgb_140`). `info` prints the albedo,
    by which it can be told.
    """

    format = "utia"
    is_anisotropic = True
    settings: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "encoding": ENCODINGS,
        "quantity": ("brdf", "brdf_cosine", "reflectance_factor"),
    }

    def __init__(self, paths: Sequence[Path], settings: Mapping[str, str] | None = None) -> None:
        self.paths = list(paths)
        self.names = [path.stem for path in paths]
        self.told = dict(settings or {})
        read = [self._read(path) for path in paths]
        self._valid = [valid for _, valid in read]
        self._values = [values for values, _ in read]
        self._table = lru_cache(8)(self._make_table)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether it has the size of a table, and begins with numbers of a size that values have."""
        if path.stat().st_size != BYTES or len(head) < 64:
            return False
        with np.errstate(invalid="ignore"):
            first = np.abs(np.frombuffer(head[:64], "<f8"))
            return bool(((first == 0) | ((first > 1e-12) & (first < 1e9)) | ~np.isfinite(first)).all())

    @classmethod
    def hint(cls, path: Path, head: bytes) -> str:
        """Which size a table of it would have."""
        size = path.stat().st_size if path.suffix.lower() == ".bin" else 0
        return f"a .bin of {size} bytes, and not the {BYTES} of a UTIA table" if size and size != BYTES else ""

    @classmethod
    def open(cls, paths: Sequence[Path], settings: Mapping[str, str] | None = None) -> "Utia":
        """Read and check tables; DataError for a wrong size, or no valid entry."""
        return cls(paths, settings)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as the paths of its files."""
        return reopened(self, self.told)

    def _read(self, path: Path) -> tuple[np.ndarray, np.ndarray]:
        """Values `(*SHAPE, 3)` in 1/sr, 0 where they are invalid, and validity `SHAPE`."""
        data = read_bytes(path, "a UTIA table")
        if len(data) != BYTES:
            raise DataError(f"{path}: expected a UTIA table of {BYTES} bytes, found {len(data)}")
        stored = np.moveaxis(np.frombuffer(data, "<f8").reshape(3, *SHAPE), 0, -1)
        with np.errstate(invalid="ignore", over="ignore"):
            values = _decoded(stored, self.told.get("encoding", ENCODINGS[0]))
            quantity = self.told.get("quantity", "brdf")
            if quantity == "reflectance_factor":
                values = values / math.pi
            elif quantity == "brdf_cosine":
                values = values / np.cos(np.radians(STEP * np.arange(SHAPE[2])))[:, None, None]
            valid = (np.abs(values) <= LARGEST_VALUE).all(-1)
        if not valid.any():
            raise DataError(f"{path}: expected values up to {LARGEST_VALUE:g} / sr, found none")
        return np.where(valid[..., None], values, 0), valid

    @cached_property
    def pairs(self) -> Pairs:  # type: ignore[override]
        """All pairs of directions, `(1, 82944)`."""
        theta, phi = np.radians(STEP * np.arange(SHAPE[0])), np.radians(TURN * np.arange(SHAPE[1]))
        each = direction(*np.meshgrid(theta, phi, indexing="ij")).reshape(-1, 3)
        wi, wo = np.repeat(each, len(each), 0), np.tile(each, (len(each), 1))
        return Pairs.from_directions(torch.from_numpy(wi)[None], torch.from_numpy(wo)[None])

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """The values and their weights, float64."""
        values = torch.from_numpy(np.stack([self._values[k].reshape(-1, 3) for k in materials]))
        weight = torch.from_numpy(np.stack([self._valid[k].reshape(-1, 1) for k in materials])).double()
        return values[:, samples], weight[:, samples]

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values at any pairs, linear in the angles of both directions, or nearest, from the valid neighbours."""
        values = pairs.cos_i.new_empty((len(materials), len(pairs), 3))
        filled = torch.zeros(len(materials), dtype=torch.int64, device=pairs.device)
        for part, chunk in chunks(pairs):
            for row, material in enumerate(materials):
                if row < pairs.shape[0]:
                    own = chunk.select([row])
                    above = own.above_horizon[0]
                    position = [*_position(own.wi[0]), *_position(own.wo[0])]
                table, place = self._table(material, pairs.dtype, pairs.device)
                found, missing = interpolate(table, position, _AROUND, interpolation)
                missing &= above
                if missing.any():
                    centre = nearest_rows([axis[missing] for axis in position], _AROUND)
                    found[missing] = table[place[centre.long()].long(), :3]
                    filled[row] += missing.sum()
                values[row, part] = torch.where(above[:, None], found, 0)
        return Lookup(values, filled)

    def _make_table(self, material: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
        """Values and validity on the closed grid, `(K, 4)`, and of each entry the nearest valid one."""
        valid = _closed(self._valid[material])
        table = np.concatenate([_closed(self._values[material]), valid[..., None]], -1).reshape(-1, 4)
        place = np.arange(valid.size) if valid.all() else nearest_valid(valid)
        return torch.from_numpy(table).to(device, dtype), torch.from_numpy(place).to(device)

    def details(self, material: int) -> dict[str, object]:
        """What was taken, what is invalid or below 0, and how far exchanged directions are apart."""
        values, valid = self._values[material], self._valid[material]
        quantity, encoding = self.told.get("quantity", "brdf"), self.told.get("encoding", ENCODINGS[0])
        both = valid & np.moveaxis(valid, (2, 3), (0, 1))
        other = np.moveaxis(values, (2, 3), (0, 1))
        apart = np.abs(values - other).mean(-1) / np.maximum((np.abs(values) + np.abs(other)).mean(-1) / 2, 1e-30)
        return {
            "quantity": f"{quantity} (the file does not say)",
            "encoding": f"{encoding} (the file does not say)",
            "anisotropic": f"{SHAPE[1]} azimuths of the light",
            "angles": "theta 0 to 75 degrees by 15, phi by 7.5; beyond 75 degrees the value there",
            "invalid share": float(1 - valid.mean()),
            "negative share": float((values[valid] < 0).any(-1).mean()),
            "reciprocity error": f"{100 * float(np.median(apart[both])):.2g} % (median)" if both.any() else None,
        }


def _closed(table: np.ndarray) -> np.ndarray:
    """A table with its first azimuths again behind the last ones."""
    for axis in (1, 3):
        table = np.concatenate([table, np.take(table, [0], axis)], axis)
    return table


def _decoded(stored: np.ndarray, encoding: str) -> np.ndarray:
    """Values as they are, or those that sRGB stands for (IEC 61966-2-1)."""
    if encoding == "linear":
        return stored
    scaled = stored / 140 if encoding == "srgb_140" else stored
    linear = np.where(scaled <= 0.04045, scaled / 12.92, ((np.maximum(scaled, 0) + 0.055) / 1.055) ** 2.4)
    return linear * 100 if encoding == "srgb_140" else linear


def _position(directions: Tensor) -> tuple[Tensor, Tensor]:
    """Fractional indices of directions `(N, 3)`: of the angle from the normal, and of the azimuth."""
    x, y, z = directions.unbind(-1)
    theta = torch.rad2deg(torch.atan2((x.square() + y.square()).sqrt(), z))
    return theta / STEP, torch.rad2deg(torch.atan2(y, x)).remainder(360) / TURN
