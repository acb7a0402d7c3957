"""The energy-preserving Oren-Nayar model."""

import math
from functools import partial
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import clamp_cosine
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.oren_nayar import grooves
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.separable import Slopes, columns
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
    terms = EON.terms(pairs, roughness)
    coefficients = EON.coefficients(albedo=albedo, roughness=roughness)[..., None, :, :]
    value = coefficients[..., 0] * terms[0][..., None] + coefficients[..., 1] * terms[1][..., None]
    return torch.where(pairs.above_horizon[..., None], value, 0)


class _Groove(NamedTuple):
    """What the terms and their derivatives are made of, `(..., N)` where it is of pairs."""

    above: Tensor
    slant: Tensor
    height: Tensor
    gains: list[Tensor]
    lost: list[Tensor]
    scale: Tensor


def _groove(pairs: Pairs, roughness: Tensor) -> _Groove:
    # Of s below 0 by way of 1 + s, all of whose digits count where it is near 0 and r near 1.
    above = pairs.cached(_groove, lambda: 2 * pairs.cos_d.square() - pairs.cos_i * pairs.cos_o)
    slant = torch.where(above > 1, 1 + roughness * grooves(pairs), 1 - roughness + roughness * above)
    height = 1 / (1 + _FACTOR * roughness)
    gains = [
        pairs.cached(_gain, partial(_gain, cosine), name)
        for name, cosine in (("theta_i", pairs.cos_i), ("theta_o", pairs.cos_o))
    ]
    lost = [(1 - height * (1 + roughness / math.pi * gain)).clamp_min(0) for gain in gains]
    # Where r is 0 nothing is lost: 0 / 0.
    scale = math.pi * (1 - height * (1 + _MEAN * roughness)).clamp_min(1e-7)
    return _Groove(above, slant, height, gains, lost, scale)


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

    @classmethod
    def terms(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """Light that is scattered once, and more than once."""
        own = _groove(pairs, *scalars)
        return [own.height / math.pi * own.slant, own.lost[0] * own.lost[1] / own.scale]

    @classmethod
    def terms_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> tuple[list[Tensor], Slopes]:
        """A' = -(1/2 - 2 / (3 pi)) A^2, and what follows."""
        (roughness,) = scalars
        own = _groove(pairs, roughness)
        first, second = cls.terms(pairs, roughness)
        falling = -_FACTOR * own.height.square()
        steep = torch.where(own.above > 1, grooves(pairs), own.above - 1)
        once = (falling * own.slant + own.height * steep) / math.pi
        # d lost = -(A (1 + r G / pi))' = -A' - (r A)' G / pi, with (r A)' = A^2; of the mean alike.
        square = own.height.square()
        slopes = [
            torch.where(lost > 0, -falling - square / math.pi * gain, 0)
            for lost, gain in zip(own.lost, own.gains, strict=True)
        ]
        rate = math.pi * (-falling - square * _MEAN)
        again = (slopes[0] * own.lost[1] + slopes[1] * own.lost[0]) / own.scale - second * (rate / own.scale)
        return [first, second], [[once, again]]

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """rho and rho_m."""
        albedo, roughness = parameters["albedo"], parameters["roughness"]
        mean = (1 + _MEAN * roughness) / (1 + _FACTOR * roughness)
        return columns(albedo, albedo.square() * mean / (1 - albedo * (1 - mean)))
