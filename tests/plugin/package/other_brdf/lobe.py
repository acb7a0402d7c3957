"""A lobe."""

import math

import torch
from torch import Tensor

from torchbrdf import Lobe, Pairs
from torchbrdf.lobes import BoundedParameter, albedo, apply_albedo, clamp_cosine


def my_ggx(pairs: Pairs, specular: Tensor, roughness: Tensor) -> Tensor:
    """specular D / (4 cos_i cos_o) with D = (1 + t)^2 / (pi a^2 (1 + t / a^2)^2) and t = tan2_h, without shadowing."""
    t, square = pairs.cached(my_ggx, lambda: pairs.tan2_h.clamp_max(1e12)), roughness.square()
    distribution = ((1 + t) / (1 + t / square)).square() / (math.pi * square)
    larger = torch.maximum(clamp_cosine(pairs.cos_i), clamp_cosine(pairs.cos_o))
    return apply_albedo(pairs, distribution / (4 * larger), specular)


class MyGGX(Lobe):
    """A GGX distribution; shadowing cancels the smaller cosine."""

    specular: BoundedParameter = albedo(start=0.3, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(start=0.1, lower=0.01, upper=1.0, log=True, doc="a, the width")
    function = staticmethod(my_ggx)
