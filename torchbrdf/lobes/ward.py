"""Ward's isotropic lobe."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes.base import LOBES, Bounded, Lobe, color
from torchbrdf.lobes.shape import colored, decay, floored, tangent, width_slope
from torchbrdf.pairs import Pairs


def ward(pairs: Pairs, specular: Tensor, roughness: Tensor) -> Tensor:
    """specular * exp(-tan2_h / roughness^2) / (4 pi roughness^2 sqrt(cos_i cos_o)).

    specular: albedo `(..., 3)`; roughness: alpha `(..., 1)`. Result in 1/sr, `(..., N, 3)`, zero below the horizon.
    Source: the paper's eq. 7; G. Ward, Measuring and Modeling Anisotropic Reflection, 1992,
    doi:10.1145/142920.134078.
    """
    return colored(pairs, _shape(pairs, roughness), specular)


def _shape(pairs: Pairs, roughness: Tensor) -> Tensor:
    def geometry() -> Tensor:
        return torch.rsqrt(floored(pairs.cos_i)) * torch.rsqrt(floored(pairs.cos_o)) / (4 * math.pi)

    inverse = roughness.square().reciprocal()
    return decay(tangent(pairs) * -inverse) * (pairs.keep("ward", geometry) * inverse)


@LOBES.register("ward")
class Ward(Lobe):
    """Ward's isotropic lobe (eq. 7), with the start and bounds of the paper's Table 1."""

    specular = color(start=0.5, doc="specular albedo, per channel")
    roughness = Bounded(start=0.01, lower=0.001, upper=0.5, log=True, doc="alpha, the width of the lobe")
    function = staticmethod(ward)

    @classmethod
    def linearized(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/d(alpha) = shape (2 tan2_h / alpha^3 - 2 / alpha)."""
        (roughness,) = scalars
        shape = _shape(pairs, roughness)
        return [shape, shape * width_slope(pairs, roughness)]
