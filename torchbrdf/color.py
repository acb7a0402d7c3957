"""What colours and display values are computed with: luminance, and powers with a finite gradient."""

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""What linear red, green and blue count in luminance, with the primaries of ITU-R BT.709."""


def luminance(rgb: Tensor) -> Tensor:
    """Luminance of linear RGB with the primaries of ITU-R BT.709.

    Args:
        rgb: Linear values, `(..., 3)`, in any unit.

    Returns:
        `(...)`, in the same unit.

    Raises:
        ShapeError: There are other channels than three.

    Example:
        >>> luminance(torch.tensor([[1.0, 1.0, 1.0], [0.0, 1.0, 0.0]]))
        tensor([1.0000, 0.7152])
    """
    if rgb.shape[-1:] != (3,):
        raise ShapeError(f"luminance: expected linear RGB (..., 3), found {(*rgb.shape,)}")
    red, green, blue = LUMINANCE
    return rgb[..., 0] * red + rgb[..., 1] * green + rgb[..., 2] * blue


def safe_power(x: Tensor, exponent: float) -> Tensor:
    """x^exponent with value and gradient 0 at 0 and below, where the true gradient is infinite or nan.

    Args:
        x: Any shape; nan stays nan.
        exponent: Above 0.

    Returns:
        The shape of x.

    Example:
        >>> safe_power(torch.tensor([4.0, 0.0, -1.0]), 0.5).abs()
        tensor([2., 0., 0.])
    """
    positive = x > 0
    return torch.where(positive, torch.where(positive, x, 1).pow(exponent), 0 * x)  # 0 * x: nan stays nan
