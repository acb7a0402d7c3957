"""What is left of a grain where a table has no room for one: the mean over how the surface is turned."""

import math
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.lobes import Lobe
from torchbrdf.measured.format import BrdfFormat, Interpolation, Lookup
from torchbrdf.measured.measured import Measured
from torchbrdf.measured.merl import bin_centers
from torchbrdf.measured.tables import Brdf, values_at
from torchbrdf.pairs import Pairs

TURNS = 12
"""Azimuths that the surface is turned to, evenly all around."""


class AzimuthMean(BrdfFormat):
    """The format of one anisotropic material's means over all azimuths, which have no grain.

    `pairs` are MERL's bins.

    Args:
        brdf: A lobe or a sum of lobes, not batched; or one measured material, in linear RGB.
        name: Of the material.

    Example:
        >>> from torchbrdf.lobes import GGXAnisotropic
        >>> from torchbrdf.measured import Measured
        >>> mean = Measured(AzimuthMean(GGXAnisotropic(roughness_x=0.1, roughness_y=0.4), "brushed"))
        >>> mean.is_anisotropic, mean.names
        (False, ['brushed'])
    """

    format = "azimuth_mean"
    is_sampled = False

    def __init__(self, brdf: Brdf, name: str) -> None:
        self.brdf, self.names, self.paths = brdf, [name], []
        self.stand_in = not isinstance(brdf, Measured) or brdf.stand_in
        self.pairs = bin_centers()

    @property
    def is_reciprocal(self) -> bool:  # type: ignore[override]
        """As what they are of is."""
        return isinstance(self.brdf, Measured) and self.brdf.source.is_reciprocal

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """No file is of this format."""
        return False

    @classmethod
    def open(cls, paths: Sequence[Path]) -> "AzimuthMean":
        """Refuse: there are no such files."""
        raise DataError(f"{paths[0]}: expected a material with a grain")

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """Means at some bins, float64, and weights 1."""
        values = self.at(self.pairs.select(samples=samples), materials, "linear").values
        return values, torch.ones_like(values[..., :1])

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Means at any pairs."""
        rows = pairs.to("cpu", torch.float64)
        first, *others = _turned(rows)
        found = values_at(self.brdf, first)
        for one in others:
            found += values_at(self.brdf, one)
        filled = torch.zeros(1, dtype=torch.int64, device=pairs.device)
        return Lookup((found / TURNS).to(pairs.cos_i)[None], filled)

    def distance_at(self, pairs: Pairs, materials: list[int]) -> Tensor:
        """How far the nearest sample is, of all azimuths the mean."""
        if self.stand_in or not isinstance(self.brdf, Measured):
            return super().distance_at(pairs, materials)
        every = [self.brdf.distance_at(one) for one in _turned(pairs.to("cpu", torch.float64))]
        return torch.stack(every).mean(0).to(pairs.cos_i)


def without_grain(brdf: Brdf, name: str = "material") -> Brdf:
    """A material without a grain: itself, or its means over all azimuths.

    Args:
        brdf: A lobe or a sum of lobes, not batched; or one measured material, in linear RGB.
        name: Of the material.

    Example:
        >>> from torchbrdf.lobes import GGX, GGXAnisotropic
        >>> plain = GGX()
        >>> without_grain(plain) is plain, without_grain(GGXAnisotropic()).is_anisotropic
        (True, False)
    """
    return Measured(AzimuthMean(brdf, name)) if isinstance(brdf, Lobe | Measured) and brdf.is_anisotropic else brdf


def _turned(pairs: Pairs) -> list[Pairs]:
    """The same pairs `(1, N)` on surfaces that are turned to all azimuths."""
    found = []
    for angle in (2 * math.pi * k / TURNS for k in range(TURNS)):
        cos, sin = math.cos(angle), math.sin(angle)
        turn = torch.tensor([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]], dtype=torch.float64, device="cpu")
        found.append(Pairs.from_directions(pairs.wi @ turn, pairs.wo @ turn))
    return found
