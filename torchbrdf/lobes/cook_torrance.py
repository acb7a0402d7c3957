"""The Cook-Torrance lobe with Beckmann's distribution."""

import math

from torch import Tensor

from torchbrdf.lobes._microfacet import (
    apply_albedo,
    beckmann_exponential,
    log_beckmann_derivative,
    v_groove,
)
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def cook_torrance(pairs: Pairs, specular: Tensor, roughness: Tensor, f0: Tensor) -> Tensor:
    """The Cook-Torrance lobe with Beckmann's distribution: specular * D G F / (pi cos_i cos_o).

    D = exp(-tan2_h / m^2) / (m^2 cos_h^4) (Beckmann), G = min(1, 2 cos_h cos_o / cos_d, 2 cos_h cos_i / cos_d),
    F = Schlick's Fresnel.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: m `(..., 1)`.
        f0: reflectance at normal incidence `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: the paper's eq. 4 to 6; R. Cook and K. Torrance, A Reflectance Model for Computer Graphics, 1982,
    doi:10.1145/357290.357293.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import cook_torrance
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> cook_torrance(pairs, colour, torch.tensor([0.1]), torch.tensor([0.3]))
        tensor([[0.0185, 0.0369, 0.0554]])
    """
    return apply_albedo(pairs, facets(pairs, roughness) * fresnel(f0, pairs), specular)


def facets(pairs: Pairs, roughness: Tensor) -> Tensor:
    """D G / (pi cos_i cos_o)."""
    inverse = roughness.square().reciprocal()
    return beckmann_exponential(pairs, inverse) * (v_groove(pairs) * (inverse / math.pi))


@LOBES.register("cook_torrance")
class CookTorrance(Lobe):
    """Cook-Torrance with Beckmann's distribution (eq. 4 to 6), with the start and bounds of the paper's Table 1.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import CookTorrance
        >>> CookTorrance(roughness=0.1, f0=0.04)
        CookTorrance(specular=[0.5, 0.5, 0.5], roughness=0.1, f0=0.04)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.02, lower=0.001, upper=1.0, log=True, doc="m, the rms slope of the microfacets"
    )
    f0: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.02, upper=1.0, affine=True, doc="reflectance at normal incidence"
    )
    function = staticmethod(cook_torrance)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/dm = shape (2 tan2_h / m^3 - 2 / m), d/dF0 = D G (1 - (1 - cos_d)^5) / (pi cos_i cos_o)."""
        roughness, f0 = scalars
        own = facets(pairs, roughness)
        shape = own * fresnel(f0, pairs)
        return [shape, shape * log_beckmann_derivative(pairs, roughness), own * (1 - schlick_weight(pairs))]

    @classmethod
    def pair_factors(cls, pairs: Pairs) -> list[Tensor]:
        """G / (cos_i cos_o), and that times (1 - cos_d)^5."""
        geometry = v_groove(pairs)
        return [geometry, geometry * schlick_weight(pairs)]
