"""Distances between the measured tables that the authors of the triplets computed."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.perception.datasets.matlab import read_matrices
from torchbrdf.reading import exists

TABLE_LOSSES = {"rms": "rms", "rms_cos": "cosine_rms", "rms_cos_cube": "cube_root"}
"""Names in the file, and the losses that they are: of their own grid of directions, on MERL's measured tables."""
PICTURE_DISTANCES = ("dist_L2_lab", "dist_L4_lab")


def read_lagunas(path: Path | str, materials: int = 100) -> dict[str, Tensor]:
    """Read distances between MERL's tables by Lagunas et al. 2019: `(K, K)` float64 by name, from a MAT file.

    The names are those of TABLE_LOSSES and of PICTURE_DISTANCES.

    Raises:
        DataError: The file is missing or damaged, or a matrix is not as expected: finite, at least 0, symmetric.

    Source: M. Lagunas et al., A similarity measure for material appearance, 2019, doi:10.1145/3306346.3323036.
    """
    path = Path(path)
    if not exists(path):
        raise DataError(f"{path}: no such file; expected distances of MERL's tables by Lagunas et al. 2019")
    names = (*TABLE_LOSSES, *PICTURE_DISTANCES)
    found = read_matrices(path, names)
    for name in names:
        if name not in found or found[name].shape != (materials, materials):
            shape = found[name].shape if name in found else "no such matrix"
            raise DataError(f"{path}: {name}: expected {materials} x {materials} distances, found {shape}")
        matrix = found[name]
        if not (np.isfinite(matrix).all() and (matrix >= 0).all() and (matrix == matrix.T).all()):
            raise DataError(f"{path}: {name}: expected finite distances of at least 0, the same both ways")
    return {name: torch.from_numpy(found[name]) for name in names}
