"""Distances between the measured tables that the authors of the triplets computed."""

from pathlib import Path

import torch
from scipy.io import loadmat
from torch import Tensor

from torchbrdf.errors import DataError

TABLE_LOSSES = {"rms": "rms", "rms_cos": "cosine_rms", "rms_cos_cube": "cube_root"}
"""Names in the file, and the losses that they are: of their own grid of directions, on MERL's measured tables."""
PICTURE_DISTANCES = ("dist_L2_lab", "dist_L4_lab")


def read_lagunas(path: Path | str, materials: int = 100) -> dict[str, Tensor]:
    """Read distances between MERL's tables by Lagunas et al. 2019: `(K, K)` float64 by name, from a MAT file.

    The names are those of TABLE_LOSSES and of PICTURE_DISTANCES.

    Raises:
        DataError: The file is missing, or a matrix is not as expected.

    Source: M. Lagunas et al., A similarity measure for material appearance, 2019, doi:10.1145/3306346.3323036.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: no such file; expected distances of MERL's tables by Lagunas et al. 2019")
    try:
        content = loadmat(path)
    except Exception as error:  # scipy raises many kinds
        raise DataError(f"{path}: expected a MAT file: {error}") from None
    found = {}
    for name in (*TABLE_LOSSES, *PICTURE_DISTANCES):
        if name not in content or content[name].shape != (materials, materials):
            shape = content[name].shape if name in content else "no such matrix"
            raise DataError(f"{path}: {name}: expected {materials} x {materials} distances, found {shape}")
        found[name] = torch.from_numpy(content[name].astype("float64"))
        if not bool((found[name] >= 0).all()):
            raise DataError(f"{path}: {name}: expected distances of at least 0")
    return found
