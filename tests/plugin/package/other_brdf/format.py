"""A format: scattered samples in an .npz file, without interpolation."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf import Pairs
from torchbrdf.errors import DataError
from torchbrdf.measured import BrdfFormat


class Scattered(BrdfFormat):
    """`wi` and `wo`, `(N, 3)`, and `rgb`, `(N, 3)`."""

    format = "scattered"

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths, self.names = list(paths), [path.stem for path in paths]
        self.tables = []
        for path in paths:
            with np.load(path) as file:
                if not {"wi", "wo", "rgb"} <= set(file.files):
                    raise DataError(f"{path}: expected wi, wo and rgb, found {', '.join(file.files)}")
                self.tables.append([torch.from_numpy(file[name]).double() for name in ("wi", "wo", "rgb")])
        self.pairs = Pairs.from_directions(*(torch.stack([t[k] for t in self.tables]) for k in (0, 1)))

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """By the names in the file."""
        if not head.startswith(b"PK"):
            return False
        with np.load(path) as file:
            return "rgb" in file.files

    @classmethod
    def open(cls, paths: Sequence[Path]) -> "Scattered":
        """Read files."""
        return cls(paths)

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """Values, all of them valid above the horizon."""
        values = torch.stack([self.tables[k][2][samples] for k in materials])
        weight = self.pairs.select(materials, samples).above_horizon[..., None].double()
        return values * weight, weight
