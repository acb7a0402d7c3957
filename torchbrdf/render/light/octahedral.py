"""The equal-area map between the sphere and a square, so that every texel has the same solid angle.

Source: P. Clarberg, Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD, 2008, doi:10.1080/2151237X.2008.10129263.
The pole, the middle of the square, is +y; the four corners are -y. Coordinates are in [-1, 1].
"""

import math

import torch
from torch import Tensor


def to_square(directions: Tensor) -> tuple[Tensor, Tensor]:
    """Coordinates in the square, `(...)` each, of unit vectors `(3, ...)`."""
    x, y, z = directions
    # sqrt(1 - |y|), without the cancellation near the poles
    radius = ((x.square() + z.square()) / (1 + y.abs())).sqrt()
    second = torch.atan2(z.abs(), x.abs()) * radius * (2 / math.pi)
    first = radius - second
    lower = y < 0
    first, second = torch.where(lower, 1 - second, first), torch.where(lower, 1 - first, second)
    return torch.copysign(first, x), torch.copysign(second, z)


def to_sphere(first: Tensor, second: Tensor) -> Tensor:
    """Unit vectors `(..., 3)` of coordinates in the square, `(...)` each."""
    signed = 1 - first.abs() - second.abs()
    radius = 1 - signed.abs()
    share = (second.abs() - first.abs()) / torch.where(radius > 0, radius, 1)
    angle = (share + 1) * (math.pi / 4)
    across = radius * (2 - radius.square()).sqrt()
    y = torch.copysign(1 - radius.square(), signed)
    x = torch.copysign(across * angle.cos(), first)
    z = torch.copysign(across * angle.sin(), second)
    return torch.stack([x, y, z], -1)


def texel_centers(resolution: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """Directions of the texels' centres, `(resolution, resolution, 3)`; the first coordinate runs along a row."""
    step = (torch.arange(resolution, dtype=torch.float64, device="cpu") + 0.5) * (2 / resolution) - 1
    second, first = torch.meshgrid(step, step, indexing="ij")
    return to_sphere(first, second).to(dtype)


def padded(image: Tensor) -> Tensor:
    """A map `(n, n, C)` with one texel more on every side, what lies behind its edges on the sphere."""
    wide = torch.cat([image[:, :1].flip(0), image, image[:, -1:].flip(0)], 1)
    top, bottom = wide[:1].flip(1), wide[-1:].flip(1)
    return torch.cat([top, wide, bottom], 0)
