"""Where texels of a tile are: a coarse grid of them, and those beside each."""

import numpy as np
import torch
from torch import Tensor

# Of the coarse grid: one texel in so many rows and columns.
STEP = 12


def coarse_texels(good: Tensor, shape: tuple[int, int]) -> Tensor:
    """Of every cell of the coarse grid the texel next to its middle that can be fitted, if one can."""
    rows, columns = good // shape[1], good % shape[1]
    cell = rows // STEP * (-(-shape[1] // STEP)) + columns // STEP
    middle = (STEP - 1) / 2
    away = (rows % STEP - middle).square() + (columns % STEP - middle).square()
    order = np.lexsort((away.numpy(), cell.numpy()))
    _, first = np.unique(cell.numpy()[order], return_index=True)
    return good[torch.from_numpy(order[first])]


def neighbours(x: Tensor) -> tuple[Tensor, Tensor]:
    """The mean of the four texels beside each, `(M, P)`, of maps `(h, w, P)` with NaN, and how many there are."""
    wide = torch.nn.functional.pad(x, (0, 0, 1, 1, 1, 1), value=torch.nan)
    beside = torch.stack([wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]])
    count = beside[..., 0].isfinite().sum(0).double()
    return beside.nanmean(0).nan_to_num().flatten(0, 1), count.flatten()


def with_columns(x: Tensor, other: Tensor, columns: Tensor) -> Tensor:
    """`(m, P)` with some columns of another."""
    found = x.clone()
    found[:, columns] = other[:, columns]
    return found


def places_of(rows: Tensor, shape: tuple[int, int]) -> Tensor:
    """Row and column of texels, `(m, 2)`."""
    return torch.stack([rows // shape[1], rows % shape[1]], -1).float()
