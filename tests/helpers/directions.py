"""Directions for tests, built without the package."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]


def from_half_diff(theta_h: Array, theta_d: Array, phi_d: Array, phi_h: Array | float = 0.0) -> tuple[Array, Array]:
    """wi and wo `(..., 3)`: wi in the frame of the half vector, rotated by theta_h about y and phi_h about z."""
    theta_h, theta_d, phi_d, phi_h = np.broadcast_arrays(theta_h, theta_d, phi_d, phi_h)
    local = np.stack([np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)], -1)
    zero, one = np.zeros_like(theta_h), np.ones_like(theta_h)

    def rotation(rows: list[list[Array]]) -> Array:
        return np.stack([np.stack(row, -1) for row in rows], -2)

    c, s = np.cos(theta_h), np.sin(theta_h)
    about_y = rotation([[c, zero, s], [zero, one, zero], [-s, zero, c]])
    c, s = np.cos(phi_h), np.sin(phi_h)
    about_z = rotation([[c, -s, zero], [s, c, zero], [zero, zero, one]])
    turn = about_z @ about_y
    mirrored = local * np.array([-1.0, -1.0, 1.0])
    return (turn @ local[..., None])[..., 0], (turn @ mirrored[..., None])[..., 0]


def hemisphere(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    """Directions above the horizon, uniform in solid angle, `(*shape, 3)`."""
    generator = torch.Generator("cpu").manual_seed(seed)
    cos, turn = torch.rand(2, *shape, generator=generator, dtype=torch.float64, device="cpu")
    phi, sin = 2 * math.pi * turn, (1 - cos.square()).sqrt()
    return torch.stack([sin * phi.cos(), sin * phi.sin(), cos], -1).to(dtype)
