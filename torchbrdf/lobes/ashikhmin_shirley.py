"""The isotropic Ashikhmin-Shirley lobe."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes.base import LOBES, Bounded, Lobe, color
from torchbrdf.lobes.fresnel import schlick
from torchbrdf.lobes.shape import colored, floored, tangent
from torchbrdf.pairs import Pairs


def ashikhmin_shirley(pairs: Pairs, specular: Tensor, exponent: Tensor, f0: Tensor) -> Tensor:
    """specular * (m + 1) / (8 pi) * cos_h^m / (cos_d max(cos_i, cos_o)) * F.

    F is Schlick's Fresnel. specular: albedo `(..., 3)`; exponent: m `(..., 1)`; f0 `(..., 1)`.
    Result in 1/sr, `(..., N, 3)`, zero below the horizon.
    Source: the paper's eq. 2 and 3; M. Ashikhmin and P. Shirley, An Anisotropic Phong BRDF Model, 2000,
    doi:10.1080/10867651.2000.10487522.
    """
    # cos_h^m by way of tan2_h: at m = 50000 a float32 cos_h near 1 has too few digits.
    power = torch.exp(-0.5 * exponent * torch.log1p(tangent(pairs)))
    geometry = 1 / (floored(pairs.cos_d) * torch.maximum(floored(pairs.cos_i), pairs.cos_o)) / (8 * math.pi)
    return colored(pairs, power * (exponent + 1) * geometry * schlick(f0, pairs.cos_d), specular)


@LOBES.register("ashikhmin_shirley")
class AshikhminShirley(Lobe):
    """The isotropic Ashikhmin-Shirley lobe (eq. 2 and 3), with the start and bounds of the paper's Table 1."""

    specular = color(start=0.5, doc="specular albedo, per channel")
    exponent = Bounded(start=5.0, lower=0.001, upper=50000.0, log=True, doc="m, the sharpness of the lobe")
    f0 = Bounded(start=0.3, lower=0.02, upper=1.0, doc="reflectance at normal incidence")
    function = staticmethod(ashikhmin_shirley)
