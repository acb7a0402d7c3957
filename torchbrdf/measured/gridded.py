"""Formats whose files hold a table over directions: values are interpolated in the table, by the azimuths of both."""

from abc import abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor

from torchbrdf.measured.format import BrdfFormat, Interpolation, Lookup
from torchbrdf.measured.grid import chunks, weighted_rows
from torchbrdf.measured.listed import Listed, ListedFormat, Opened
from torchbrdf.pairs import Pairs

# Cosines of light that has an azimuth, and samples that are compared with those of exchanged directions.
_TILTED, _COMPARED = 1 - 1e-6, 4000
# What samples alone would say of it.
_OF_GRAINS = ("anisotropic", "azimuths of the light")


class Grid(Protocol):
    """Where the samples of a file lie, so that those around any pair of directions are found."""

    @property
    def is_anisotropic(self) -> bool:
        """Whether it matters how the surface is turned about its normal."""
        ...

    def around(self, wi: Tensor, wo: Tensor, interpolation: Interpolation) -> tuple[Tensor, Tensor]:
        """The samples that a value is made of, and how much each of them counts.

        Args:
            wi: Unit vectors to the light, `(N, 3)`, above the horizon or not.
            wo: Those to the viewer.
            interpolation: "linear" or "nearest".

        Returns:
            Rows of the file's samples and their weights, whose sum is 1, `(N, k)` both.
        """
        ...


class GriddedFormat(ListedFormat):
    """Base of formats whose files hold a table. A subclass gives `recognises` and `gridded`.

    Samples without a value take no part in interpolation; where all around are such, the nearest one stands in.

    Args:
        paths: Files that `recognises` said yes to.
        settings: What their reader is told.
    """

    is_sampled: ClassVar[bool] = False

    @abstractmethod
    def gridded(self, path: Path) -> tuple[Listed, Grid]:
        """What a file says, and how its samples are found again; DataError if it is bad."""

    def parse(self, path: Path) -> Listed:
        """What a file says."""
        listed, grid = self.gridded(path)
        return replace(listed, table=grid, grain="anisotropic" if grid.is_anisotropic else "isotropic")

    def _opened(self, path: Path) -> Opened:
        """What was read of a file; tables say themselves whether they have a grain, and samples need not be asked."""
        found = super()._opened(path)
        for name in _OF_GRAINS:
            found.facts.pop(name, None)
        return found

    def _grid(self, material: int) -> Grid:
        found: Grid = self._read[material].table
        return found

    def has_grain(self, material: int) -> bool:
        """Whether a material's table is anisotropic."""
        return self._grid(material).is_anisotropic

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values at any pairs, from the samples around them in each material's table."""
        values = pairs.cos_i.new_zeros((len(materials), len(pairs), self.channels))
        filled = torch.zeros(len(materials), dtype=torch.int64, device=pairs.device)
        for part, chunk in chunks(pairs):
            for row, material in enumerate(materials):
                own = chunk.select([row if pairs.shape[0] > 1 else 0])
                above = own.above_horizon[0]
                rows, weight = self._grid(material).around(own.wi[0], own.wo[0], interpolation)
                found = weighted_rows(self._table(material, pairs), rows.to(torch.int64), weight)
                share = found[:, -1:]
                missing = (share[:, 0] <= 0) & above
                found = found[:, :-1] / torch.where(share > 0, share, 1)
                if missing.any():
                    nearest = own.select(samples=missing.nonzero()[:, 0])
                    found[missing] = BrdfFormat.at(self, nearest, [material], "nearest").values[0]
                    filled[row] += missing.sum()
                values[row, part] = torch.where(above[:, None], found, 0)
        return Lookup(values, filled)

    def _table(self, material: int, pairs: Pairs) -> Tensor:
        """A material's values and their validity, `(N, C + 1)`, in the dtype and on the device of pairs."""
        key = ("table", material, pairs.dtype, pairs.device)
        found: Tensor | None = self._ready.get(key)
        if found is None:
            one = self._read[material]
            found = torch.cat([one.values, one.valid[:, None].to(one.values)], -1).to(pairs.device, pairs.dtype)
            self._keep(key, found)
        return found

    def details(self, material: int) -> dict[str, object]:
        """What the file says of itself, how it was read, and what its samples are like."""
        found = super().details(material)
        if not self._grid(material).is_anisotropic:
            return found
        for name in list(found):  # of isotropic materials
            if name.startswith(("azimuths", "noise", "reciprocity")):
                del found[name]
        return found | self._exchanged(material)

    def _exchanged(self, material: int) -> dict[str, object]:
        """What an anisotropic table is like: azimuths of the light, and how alike exchanged directions are."""
        one = self._read[material]
        wi, wo, values, valid = one.wi, one.wo, one.values, one.valid
        tilted = valid & (wi[:, 2] < _TILTED)
        around = torch.atan2(wi[tilted, 1], wi[tilted, 0]).rad2deg().mul(10).round().remainder(3600)
        some = valid.nonzero()[:, 0]
        some = some[:: max(1, len(some) // _COMPARED)]
        there = self.at(Pairs.from_directions(wo[some][None], wi[some][None]), [material], "nearest").values[0].mean(-1)
        here = values[some].mean(-1)
        apart = (here - there).abs() / ((here.abs() + there.abs()) / 2).clamp_min(1e-30)
        return {
            "azimuths of the light": f"{len(around.unique())}; anisotropic, looked up by azimuths",
            "reciprocity error": f"{100 * float(apart.median()):.2g} % (median of {len(some)} pairs of samples)",
        }


def polar(directions: Tensor) -> tuple[Tensor, Tensor]:
    """Angles from the normal and azimuths of unit vectors `(N, 3)`, radians, `(N,)` each."""
    radius = directions[:, :2].square().sum(-1).sqrt()
    return torch.atan2(radius, directions[:, 2]), torch.atan2(directions[:, 1], directions[:, 0])


def crossed(light: np.ndarray, viewer: np.ndarray) -> np.ndarray:
    """Rows of theta_i, phi_i, theta_o, phi_o of every light with every viewer, the light varying fastest.

    Args:
        light: Angles from the normal and azimuths, radians, `(I, 2)`.
        viewer: The same, `(O, 2)`.

    Returns:
        `(O I, 4)`.
    """
    return np.concatenate([np.tile(light, (len(viewer), 1)), np.repeat(viewer, len(light), 0)], 1)
