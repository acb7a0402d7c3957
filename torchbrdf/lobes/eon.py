"""The energy-preserving Oren-Nayar model."""

import math
from typing import ClassVar

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import clamp_cosine
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.oren_nayar import grooves
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.pairs import Pairs

# A = 1 / (1 + FACTOR r); the mean albedo of the first term is A (1 + MEAN r).
_FACTOR = 0.5 - 2 / (3 * math.pi)
_MEAN = 2 / 3 - 28 / (15 * math.pi)


@half_in_float32
def eon(pairs: Pairs, albedo: Tensor, roughness: Tensor) -> Tensor:
    """Diffuse reflection of a rough surface that keeps all energy: a white one is white under any light.

    f = rho / pi A (1 + r s / t) + rho_m / pi (1 - E(wi)) (1 - E(wo)) / (1 - E_m), with s = wi wo - cos_i cos_o,
    t = max(cos_i, cos_o) where s > 0 and 1 elsewhere, A = 1 / (1 + (1/2 - 2 / (3 pi)) r), E the albedo of the first
    term at rho = 1, E_m = A (1 + (2/3 - 28 / (15 pi)) r) its mean, and rho_m = rho^2 E_m / (1 - rho (1 - E_m)).

    Args:
        pairs: where values are wanted, `(..., N)`.
        albedo: rho `(..., 3)`.
        roughness: r `(..., 1)`, 0 (`lambert`) to 1.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: J. Portsmouth, P. Kutz and S. Hill, EON: A Practical Energy-Preserving Rough Diffuse BRDF, 2024,
    arXiv:2410.18026; the diffuse reflection of OpenPBR.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import eon
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> eon(Pairs.from_half_diff(angle, angle, angle), colour, torch.tensor([0.5]))
        tensor([[0.0283, 0.0576, 0.0879]])
    """
    # Of s below 0 by way of 1 + s, all of whose digits count where it is near 0 and r near 1.
    above = 2 * pairs.cos_d.square() - pairs.cos_i * pairs.cos_o
    slant = torch.where(above > 1, 1 + roughness * grooves(pairs), 1 - roughness + roughness * above)
    height = 1 / (1 + _FACTOR * roughness)
    mean = height * (1 + _MEAN * roughness)
    lost = [1 - height * (1 + roughness / math.pi * _gain(cosine)) for cosine in (pairs.cos_i, pairs.cos_o)]
    # Where r is 0 nothing is lost: 0 / 0.
    again = lost[0].clamp_min(0) * lost[1].clamp_min(0) / (1 - mean).clamp_min(1e-7)
    mean = mean[..., None, :]
    multiple = albedo.square()[..., None, :] * mean / (1 - albedo[..., None, :] * (1 - mean))
    value = albedo[..., None, :] * (height * slant)[..., None] + multiple * again[..., None]
    return torch.where(pairs.above_horizon[..., None], value / math.pi, 0)


def _gain(cosine: Tensor) -> Tensor:
    """G = sin (theta - sin cos) + 2/3 (tan (1 - sin^3) - sin), so that E = A (1 + r G / pi)."""
    cosine = clamp_cosine(cosine).clamp_max(1)
    square = (1 - cosine).clamp_min(1e-12) * (1 + cosine)
    sine = square.sqrt()
    theta = torch.atan2(sine, cosine)
    # tan (1 - sin^3) = sin cos (1 + sin + sin^2) / (1 + sin), which divides by no cosine.
    steep = sine * cosine * (1 + sine + square) / (1 + sine)
    return sine * (theta - sine * cosine) + 2 / 3 * (steep - sine)


@LOBES.register("eon")
class EON(Lobe):
    """The energy-preserving Oren-Nayar model, OpenPBR's diffuse reflection.

    Its colour is no factor, as light that is scattered more than once is coloured more than once.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import EON
        >>> EON(albedo=0.25, roughness=0.5)
        EON(albedo=[0.25, 0.25, 0.25], roughness=0.5)
    """

    is_diffuse: ClassVar[bool] = True
    albedo: BoundedParameter = BoundedParameter(
        start=0.5, lower=0.0, upper=1.0, shape=(3,), doc="albedo of a light that comes from everywhere, per channel"
    )
    roughness: BoundedParameter = BoundedParameter(start=0.3, lower=0.0, upper=1.0, doc="roughness, 0 to 1")
    function = staticmethod(eon)
