"""Losses, values and pairs that suit any registered loss."""

import inspect
from typing import Any

import pytest
import torch
from torch import Tensor

from helpers.directions import hemisphere
from torchbrdf.losses import LOSSES, Loss
from torchbrdf.pairs import Pairs

every_loss = pytest.mark.parametrize("name", LOSSES)


WITH_EPS = [name for name, loss in LOSSES.items() if "eps" in inspect.signature(loss).parameters]


def make(name: str, exact: bool = True, **options: Any) -> Loss:
    """A loss with an error for each material; exact: without its eps, if it has one."""
    if exact and name in WITH_EPS:
        options["eps"] = 0.0
    return LOSSES[name](**{"reduction": "none", **options})


def some_pairs(*shape: int, dtype: torch.dtype = torch.float64) -> Pairs:
    return Pairs.from_directions(hemisphere(*shape, seed=1, dtype=dtype), hemisphere(*shape, seed=2, dtype=dtype))


def some_values(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    """BRDF values from 1e-3 to 1e2."""
    generator = torch.Generator().manual_seed(seed)
    return (10 ** (5 * torch.rand(*shape, 3, generator=generator, dtype=torch.float64) - 3)).to(dtype)
