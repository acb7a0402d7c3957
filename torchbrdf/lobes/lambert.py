"""Lambert's diffuse reflection."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes import base
from torchbrdf.lobes._microfacet import apply_albedo
from torchbrdf.lobes.base import LOBES, BoundedParameter, Lobe
from torchbrdf.pairs import Pairs


def lambert(pairs: Pairs, albedo: Tensor) -> Tensor:
    """albedo / pi.

    albedo: `(..., 3)`. Result in 1/sr, `(..., N, 3)`, zero below the horizon.
    Source: the diffuse term of the paper's eq. 11.
    """
    return apply_albedo(pairs, torch.full_like(pairs.cos_i, 1 / math.pi), albedo)


@LOBES.register("lambert")
class Lambert(Lobe):
    """Diffuse reflection: albedo / pi."""

    albedo: BoundedParameter = base.albedo(start=0.5, doc="diffuse albedo, per channel")
    function = staticmethod(lambert)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """1 / pi."""
        return [pairs.cached(lambert, lambda: torch.full_like(pairs.cos_i, 1 / math.pi))]
