"""What the lobes share: limits that keep values and gradients finite, and a scalar shape times a colour."""

import math

import torch
from torch import Tensor

from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio

# Below this a cosine no longer changes a quotient: keeps grazing values and gradients finite in float32.
COSINE_FLOOR = 1e-10
# Beyond this every lobe is 0 or flat; an infinite tangent would make gradients 0 * inf.
TAN2_CEILING = 1e18


def clamp_cosine(cosine: Tensor) -> Tensor:
    """Keep a cosine from 0, so that it may be divided by.

    Args:
        cosine: any shape.

    Returns:
        The cosine, at least `COSINE_FLOOR`.

    Example:
        >>> import torch
        >>> from torchbrdf.lobes import clamp_cosine
        >>> 1 / clamp_cosine(torch.tensor([0.5, 0.0, -0.5]))
        tensor([2.0000e+00, 1.0000e+10, 1.0000e+10])
    """
    return cosine.clamp_min(COSINE_FLOOR)


def tangent(pairs: Pairs) -> Tensor:
    """tan2_h, finite at half vectors on the horizon."""
    return pairs.cached(tangent, lambda: pairs.tan2_h.clamp_max(TAN2_CEILING))


def log_secant(pairs: Pairs) -> Tensor:
    """log(1 + tan2_h) = -2 log(cos_h), with all digits near 0."""
    return pairs.cached(log_secant, lambda: torch.log1p(tangent(pairs)))


def clamped_exp(exponent: Tensor) -> Tensor:
    """exp of an exponent of any size below 0, but at least about 1e-35 (float32) or 1e-305.

    Nothing that small is ever seen; but where exp underflows it takes ten times as long, and a sharp lobe does almost
    everywhere.
    """
    return exponent.clamp_min(math.log(torch.finfo(exponent.dtype).tiny) + 7).exp()


def beckmann_exponential(pairs: Pairs, inverse: Tensor) -> Tensor:
    """exp(-tan2_h / w^2) / cos_h^4, `(..., N)`; inverse: 1 / w^2.

    cos_h^-4 = (1 + tan2_h)^2 goes into the exponent, so that 0 * inf cannot come up at grazing half vectors.
    """
    secants = pairs.cached(beckmann_exponential, lambda: 2 * log_secant(pairs))
    return clamped_exp(torch.addcmul(secants, tangent(pairs), -inverse))


def log_beckmann_derivative(pairs: Pairs, width: Tensor) -> Tensor:
    """Derivative of log(exp(-tan2_h / w^2) / w^2) by w: 2 tan2_h / w^3 - 2 / w."""
    return torch.add(-2 / width, tangent(pairs) * (2 / width**3))


def v_groove(pairs: Pairs) -> Tensor:
    """G / (cos_i cos_o), `(..., N)`, with G = min(1, 2 cos_h cos_o / cos_d, 2 cos_h cos_i / cos_d).

    Shadowing and masking of V-shaped grooves (the paper's eq. 6); each term is divided on its own, so that grazing
    values stay finite.
    """

    def make() -> Tensor:
        cos_i, cos_o = clamp_cosine(pairs.cos_i), clamp_cosine(pairs.cos_o)
        masked = safe_ratio(2 * clamp_cosine(pairs.cos_h), clamp_cosine(pairs.cos_d) * torch.maximum(cos_i, cos_o))
        return torch.minimum(safe_ratio(1, cos_i * cos_o), masked)

    return pairs.cached(v_groove, make)


def apply_albedo(pairs: Pairs, shape: Tensor, albedo: Tensor) -> Tensor:
    """Colour a scalar function: albedo times shape, zero below the horizon.

    Args:
        pairs: where the function was taken, `(..., N)`.
        shape: its values in 1/sr, `(..., N)`.
        albedo: the colour, `(..., 3)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import apply_albedo
        >>> pairs = Pairs.from_cosines(torch.tensor([0.5, -0.5]), torch.ones(2))
        >>> apply_albedo(pairs, torch.tensor([2.0, 2.0]), torch.tensor([0.1, 0.2, 0.3]))
        tensor([[0.2000, 0.4000, 0.6000],
                [0.0000, 0.0000, 0.0000]])
    """
    return torch.where(pairs.above_horizon, shape, 0)[..., None] * albedo[..., None, :]
