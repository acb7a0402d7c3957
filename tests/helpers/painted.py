"""BRDFs for tests of pictures: lobes of many kinds, and lobes where a scene asks for measured values."""

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.lobes import CookTorrance, Lambert, Lobe, Ward
from torchbrdf.measured.measured import BrdfFormat, Interpolation, Lookup
from torchbrdf.pairs import Pairs

MATERIALS = {
    "lambert": Lambert(albedo=[0.5, 0.3, 0.1]),
    "sharp": Ward(specular=0.5, roughness=0.01),
    "glossy": Ward(specular=[0.5, 0.4, 0.2], roughness=0.05),
    "rough": Ward(specular=0.5, roughness=0.3),
    "metal": CookTorrance(specular=0.8, roughness=0.15, f0=0.5),
}


class Painted(BrdfFormat):
    """Materials that are given by lobes, where a scene asks for measured values."""

    format = "painted"

    def __init__(self, lobes: Sequence[Lobe]) -> None:
        self.lobes = lobes
        self.names = [str(k) for k in range(len(lobes))]
        self.paths = []
        self.pairs = Pairs.from_half_diff(*torch.full((3, 1, 1), 0.1, dtype=torch.float64))

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        return False

    @classmethod
    def open(cls, paths: Sequence[Path]) -> "Painted":
        raise DataError("not from files")

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        raise DataError("no samples")

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        with torch.no_grad():
            values = torch.cat([self.lobes[k](pairs) for k in materials])
        return Lookup(values, torch.zeros(len(materials)))
