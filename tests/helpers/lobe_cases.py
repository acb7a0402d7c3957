"""Parameters and directions that suit any registered lobe."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from helpers.directions import hemisphere
from torchbrdf.lobes import LOBES, BoundedParameter, Lobe
from torchbrdf.pairs import Pairs

every_lobe = pytest.mark.parametrize("name", LOBES)


def middle(spec: BoundedParameter) -> float:
    """A value well inside the bounds, where nothing is negligible."""
    if spec.log:
        return math.sqrt(spec.lower * spec.upper)
    return (spec.lower + min(spec.upper, 1.0)) / 2


def values(name: str, *lead: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> dict[str, Tensor]:
    """Different parameters of the shape (*lead, k), within a factor of 2 of the middle."""
    generator = torch.Generator().manual_seed(seed)

    def around(spec: BoundedParameter) -> Tensor:
        factor = 2 ** (torch.rand(*lead, *spec.shape, generator=generator, dtype=torch.float64) - 0.5)
        return (middle(spec) * factor).to(dtype)

    return {key: around(spec) for key, spec in LOBES[name].parameter_specs.items()}


def made(name: str, *lead: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Lobe:
    return LOBES[name](**values(name, *lead, seed=seed, dtype=dtype))


def some_pairs(*shape: int, dtype: torch.dtype = torch.float64) -> Pairs:
    """Directions above the horizon, within reach of the mirror direction, so that sharp lobes are not 0."""
    wi = hemisphere(*shape, seed=1)
    mirror = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    near = mirror + 0.1 * hemisphere(*shape, seed=2)
    return Pairs.from_directions(wi.to(dtype), (near / near.norm(dim=-1, keepdim=True)).to(dtype))


def values_at(
    function: Callable[..., Tensor],
    theta_i: float | Tensor,
    theta_o: float | Tensor,
    phi: float | Tensor,
    *parameters: float,
) -> Tensor:
    """The first channel at these angles from the normal and between both azimuths, each `()` or `(N,)`."""
    angles = (torch.as_tensor(angle, dtype=torch.float64) for angle in (theta_i, theta_o, phi))
    theta_i, theta_o, phi = torch.broadcast_tensors(*angles)
    wi = torch.stack([theta_i.sin(), torch.zeros_like(phi), theta_i.cos()], -1).reshape(-1, 3)
    wo = torch.stack([theta_o.sin() * phi.cos(), theta_o.sin() * phi.sin(), theta_o.cos()], -1).reshape(-1, 3)
    numbers = (torch.tensor([value], dtype=torch.float64) for value in parameters)
    return function(Pairs.from_directions(wi, wo), *numbers)[:, 0]


def evaluate(function: Callable[..., Tensor], theta_i: float, theta_o: float, phi: float, *parameters: float) -> float:
    """`values_at` of one pair."""
    return values_at(function, theta_i, theta_o, phi, *parameters).item()
