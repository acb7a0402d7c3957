"""Directions and Rusinkiewicz' half and difference angles, with gradients that are finite wherever the angles are."""

import math

import torch
from torch import Tensor

from torchbrdf.roots import safe_ratio, safe_sqrt


def half_vector(wi: Tensor, wo: Tensor) -> Tensor:
    """wi + wo, without a gradient where the directions are opposite but for rounding, and it points anywhere."""
    half = wi + wo
    if not half.requires_grad:
        return half
    nowhere = half.detach().abs().amax(-1, keepdim=True) < 8 * torch.finfo(half.dtype).eps
    return torch.where(nowhere, half.detach(), half)


def norm(vector: Tensor) -> Tensor:
    """Length of `(..., 3)`, `(...)`; Tensor.norm is ten times slower where the components lie apart in memory."""
    x, y, z = vector.unbind(-1)
    return safe_sqrt(x.square() + y.square() + z.square())


def nonzero(length: Tensor) -> Tensor:
    """Lengths to divide by, with 1 in the place of 0."""
    return torch.where(length == 0, 1, length)


def phi_d(wi: Tensor, wo: Tensor) -> Tensor:
    """Azimuth of wi in the frame whose z is the half vector and whose x lies in the plane of h and the normal."""
    h = half_vector(wi, wo)
    radius = safe_sqrt(h[..., 0].square() + h[..., 1].square())
    length = nonzero(safe_sqrt(radius.square() + h[..., 2].square()))
    at_pole, divisor = radius == 0, nonzero(radius)
    cos_p = torch.where(at_pole, 1.0, h[..., 0] / divisor)
    sin_p = torch.where(at_pole, 0.0, h[..., 1] / divisor)
    along = cos_p * wi[..., 0] + sin_p * wi[..., 1]
    across = cos_p * wi[..., 1] - sin_p * wi[..., 0]
    along = (along * h[..., 2] - wi[..., 2] * radius) / length
    # Where wi = wo there is no azimuth: 0, as that of (1, 0), with gradient 0.
    none = across.square() + along.square() < torch.finfo(h.dtype).tiny
    phi = torch.atan2(torch.where(none, 0, across), torch.where(none, 1, along))
    phi = torch.where(phi < 0, phi + math.pi, phi)
    return torch.where(phi >= math.pi, torch.zeros_like(phi), phi)


def slopes(wi: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
    """x and y of the half vector over its z."""
    x, y, z = half_vector(wi, wo).unbind(-1)
    below = z < 0
    return safe_ratio(torch.where(below, -x, x), z.abs()), safe_ratio(torch.where(below, -y, y), z.abs())


def phi_h(wi: Tensor, wo: Tensor) -> Tensor:
    """Azimuth of the half vector about the normal; 0, with gradient 0, where it has none."""
    x, y, _ = half_vector(wi, wo).unbind(-1)
    none = x.square() + y.square() < torch.finfo(x.dtype).tiny
    return torch.atan2(torch.where(none, 0, y), torch.where(none, 1, x))


def turned(vector: Tensor, angle: Tensor) -> Tensor:
    """Vectors `(..., 3)` turned about the normal by angles `(...)`."""
    x, y, z = vector.unbind(-1)
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([x * cos - y * sin, x * sin + y * cos, z], -1)


def directions(theta_h: Tensor, theta_d: Tensor, phi_d: Tensor) -> tuple[Tensor, Tensor]:
    """wi and wo, with the half vector in the plane of x and z."""
    sin_h, cos_h, sin_d, cos_d = theta_h.sin(), theta_h.cos(), theta_d.sin(), theta_d.cos()
    x, y = sin_d * phi_d.cos(), sin_d * phi_d.sin()
    wi = torch.stack([cos_h * x + sin_h * cos_d, y, cos_h * cos_d - sin_h * x], -1)
    wo = torch.stack([sin_h * cos_d - cos_h * x, -y, cos_h * cos_d + sin_h * x], -1)
    return wi, wo
