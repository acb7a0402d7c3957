"""Values of scattered samples with a grain for pictures, which ask for many millions of them: from a grid.

A value between scattered samples takes some ten microseconds, most of them to find its neighbours, and pictures ask
for the same places again and again. So values are worked out once, on a grid over the half vector's and the
difference's angles and azimuths, and interpolated there: linear in how values are compressed (`Surface.compressed`),
in which lobes are smooth. Light and viewer can change places there, too.
"""

import math
from collections import OrderedDict
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from torchbrdf import memory
from torchbrdf.measured.format import BrdfFormat
from torchbrdf.measured.grid import chunks, neighbours
from torchbrdf.measured.measured import Measured
from torchbrdf.measured.scattered import Angles, Places, Surface
from torchbrdf.pairs import Pairs

SHAPE = (40, 90, 20, 36)
"""Entries of theta_h's root, the half vector's azimuth, theta_d, and the difference's azimuth in half a turn."""
MUCH = 6.0
"""Light, in means of a pixel's pairs, from which on a pair is asked for between the samples."""
FINE = 0.1
"""theta_h, radians, up to which the grid is fine enough for all pairs: its azimuths are close there."""
# Cells along its last two axes, and the grids of the materials of a source.
_CELLS = (SHAPE[2] - 1, SHAPE[3])
_GRIDS: "WeakKeyDictionary[BrdfFormat, OrderedDict[int, Resampled]]" = WeakKeyDictionary()
# Cosines down to which entries take part in cells that reach above the horizon; and entries that are made at once.
_BELOW, _TOGETHER = -0.25, 1 << 16


class Resampled:
    """One material's values on the grid.

    Args:
        places: Where its samples are, with a grain.
        surface: Its values.
    """

    def __init__(self, places: Places, surface: Surface) -> None:
        self._places, self._surface, self._scale = places, surface, 2 * surface.scale
        found = np.zeros((math.prod(SHAPE), surface.mean.shape[1]), np.float32)
        for start in range(0, len(found), _TOGETHER):
            index = np.arange(start, min(start + _TOGETHER, len(found)))
            angles, lowest = _angles_at(index)
            used = lowest > _BELOW
            if used.any():
                found[index[used]] = surface.compressed(surface.at(places.near(angles.select(used))))
        self.channels = found.shape[1]
        if (found == found[:, :1]).all():  # grey
            found = found[:, :1]
        self._table = torch.from_numpy(_packed(found))

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self._table.numel() * self._table.element_size()

    def at(self, pairs: Pairs) -> Tensor:
        """Values at pairs `(1, N)`, in 1/sr, `(N, C)`, zero below the horizon."""
        values = pairs.cos_i.new_empty(len(pairs), self.channels)
        for part, chunk in chunks(pairs):
            own = chunk.to(device="cpu", dtype=torch.float32)
            found = self._interpolated(_position(own)).sinh_().mul_(self._scale)
            values[part] = found.mul_(own.above_horizon[0, :, None]).to(values)
        return values

    def _interpolated(self, position: list[Tensor]) -> Tensor:
        """Compressed values `(N, 1 or C)`; a row of the table has the four corners of a cell of its last two axes."""
        rows, weight = neighbours(position[:2], (SHAPE[0], SHAPE[1] + 1))
        low = [x.floor().clamp_(0, size - 1) for x, size in zip(position[2:], _CELLS, strict=True)]
        down, across = (x - first for x, first in zip(position[2:], low, strict=True))
        cell = (low[0] * _CELLS[1] + low[1]).to(rows.dtype)
        rows = rows.mul_(math.prod(_CELLS)).add_(cell[:, None])
        found = functional.embedding_bag(rows, self._table, per_sample_weights=weight, mode="sum")
        found = found.unflatten(1, (2, 2, -1))
        found = found[:, 0].lerp(found[:, 1], down[:, None, None])
        return found[:, 0].lerp(found[:, 1], across[:, None])

    def between(self, pairs: Pairs) -> Tensor:
        """Values at pairs `(1, N)` above the horizon as they are between the samples, `(N, C)`."""
        angles = Angles.of(pairs, 0, has_grain=True)
        return torch.from_numpy(self._surface.at(self._places.near(angles))).to(pairs.cos_i)


class ForPictures:
    """Values of measured materials, and the light that pixels get of them: with a grain, from the grid.

    Pairs that bring much of a pixel's light are asked for between the samples, where the grid is not exact.

    Args:
        measured: Materials.
    """

    def __init__(self, measured: Measured) -> None:
        self.measured = measured
        rows = enumerate(measured.materials)
        scattered = measured.is_scattered
        self._grids = {row: _grid_of(measured, k) for row, k in rows if scattered and measured.source.has_grain(k)}

    def __call__(self, pairs: Pairs) -> Tensor:
        """Values at pairs `(1, N)`, `(M, N, C)`."""
        if not self._grids:
            return self.measured.at(pairs)
        rows = range(len(self.measured))
        known = {row: grid.at(pairs)[None] for row, grid in self._grids.items()}
        return torch.cat([known[row] if row in known else self.measured.batch([row]).at(pairs) for row in rows])

    def light(self, pairs: Pairs, weight: Tensor) -> Tensor:
        """The light of pixels, `(M, p, 3)`.

        Args:
            pairs: Of p pixels with L pairs each, `(1, p L)`.
            weight: By which their values count, `(p, L, 3)`.
        """
        values = self(pairs).reshape(-1, *weight.shape)
        for row, grid in self._grids.items():
            counted = (values[row] * weight).sum(-1).abs_()
            much = (counted > MUCH * counted.mean(1, keepdim=True)).flatten() & (pairs.theta_h[0] > FINE)
            much = much.nonzero()[:, 0]
            if len(much):
                values[row].view(-1, values.shape[-1])[much] = grid.between(pairs.select(samples=much))
        return torch.stack([(own * weight).sum(1) for own in values])


def _grid_of(measured: Measured, material: int) -> Resampled:
    """A material's grid, kept as long as there is room: the views of a page all ask for it."""
    known = _GRIDS.setdefault(measured.source, OrderedDict())
    if material not in known:
        known[material] = Resampled(*measured.source.surface(material))
        while sum(one.nbytes for one in known.values()) > memory.limit() // 4 and len(known) > 1:
            known.popitem(last=False)
    return known[material]


def _packed(table: np.ndarray) -> np.ndarray:
    """A table `(K, C)` with the corners of cells of the last two axes in a row, and its first azimuths again behind."""
    table = table.reshape(*SHAPE, -1)
    for axis in (1, 3):
        table = np.concatenate([table, np.take(table, [0], axis)], axis)
    corners = [table[:, :, a : _CELLS[0] + a, b : _CELLS[1] + b] for a in (0, 1) for b in (0, 1)]
    return np.stack(corners, -2).reshape(-1, 4 * table.shape[-1])


def _angles_at(index: np.ndarray) -> tuple[Angles, np.ndarray]:
    """Angles at entries of the grid, and the lesser cosine of both directions, `(n,)`."""
    half, around, difference, turn = np.unravel_index(index, SHAPE)
    theta_h = (half / (SHAPE[0] - 1)) ** 2 * (math.pi / 2)
    theta_d = difference / (SHAPE[2] - 1) * (math.pi / 2)
    phi_h = around * (2 * math.pi / SHAPE[1])
    turned = turn * (math.pi / SHAPE[3])
    # The difference is across the half vector: its slope over its azimuth is -tan(theta_h) cos(turned - phi_h).
    along = np.cos(turned - phi_h) * np.sin(theta_h)
    rise = -along / np.sqrt(np.cos(theta_h) ** 2 + along**2 + 1e-18)
    sides = (np.cos(theta_d) * np.cos(theta_h) + sign * np.sin(theta_d) * rise for sign in (1, -1))
    cos_i, cos_o = sides
    grain = np.stack([np.cos(phi_h), np.sin(phi_h), np.cos(2 * turned), np.sin(2 * turned)], -1)
    return Angles.at(theta_h, theta_d, cos_i, cos_o, grain), np.minimum(cos_i, cos_o)


def _position(pairs: Pairs) -> list[Tensor]:
    """Where pairs `(1, N)` are on the grid, in steps along each of its axes, `(N,)` each."""
    wi, wo = pairs.wi[0], pairs.wo[0]
    both, apart = (wi + wo).unbind(-1), (wi - wo).unbind(-1)
    phi_h, turned = torch.atan2(both[1], both[0]), torch.atan2(apart[1], apart[0])
    phi_h, turned = (
        torch.where(phi < 0, phi + period, phi) for phi, period in ((phi_h, 2 * math.pi), (turned, math.pi))
    )
    return [
        (pairs.theta_h[0] * (2 / math.pi)).sqrt_().mul_(SHAPE[0] - 1),
        phi_h.mul_(SHAPE[1] / (2 * math.pi)),
        pairs.theta_d[0] * ((SHAPE[2] - 1) * 2 / math.pi),
        turned.mul_(SHAPE[3] / math.pi),
    ]
