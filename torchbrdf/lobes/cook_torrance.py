"""The Cook-Torrance lobe with Beckmann's distribution."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes.base import LOBES, Bounded, Lobe, color
from torchbrdf.lobes.fresnel import schlick
from torchbrdf.lobes.shape import colored, tangent, v_groove
from torchbrdf.pairs import Pairs


def cook_torrance(pairs: Pairs, specular: Tensor, roughness: Tensor, f0: Tensor) -> Tensor:
    """specular * D G F / (pi cos_i cos_o).

    D = exp(-tan2_h / m^2) / (m^2 cos_h^4) (Beckmann), G = min(1, 2 cos_h cos_o / cos_d, 2 cos_h cos_i / cos_d),
    F = Schlick's Fresnel. specular: albedo `(..., 3)`; roughness: m `(..., 1)`; f0 `(..., 1)`.
    Result in 1/sr, `(..., N, 3)`, zero below the horizon.
    Source: the paper's eq. 4 to 6; R. Cook and K. Torrance, A Reflectance Model for Computer Graphics, 1982,
    doi:10.1145/357290.357293.
    """
    square = roughness.square()
    # cos_h^-4 = (1 + tan2_h)^2 goes into the exponent, so that 0 * inf cannot come up at grazing half vectors.
    tan2 = tangent(pairs)
    distribution = torch.exp(2 * torch.log1p(tan2) - tan2 / square) / square
    geometry = v_groove(pairs) / math.pi
    return colored(pairs, distribution * geometry * schlick(f0, pairs.cos_d), specular)


@LOBES.register("cook_torrance")
class CookTorrance(Lobe):
    """Cook-Torrance with Beckmann's distribution (eq. 4 to 6), with the start and bounds of the paper's Table 1."""

    specular = color(start=0.5, doc="specular albedo, per channel")
    roughness = Bounded(start=0.02, lower=0.001, upper=1.0, log=True, doc="m, the rms slope of the microfacets")
    f0 = Bounded(start=0.3, lower=0.02, upper=1.0, doc="reflectance at normal incidence")
    function = staticmethod(cook_torrance)
