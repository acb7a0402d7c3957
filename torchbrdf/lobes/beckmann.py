"""Beckmann's distribution with Smith's shadowing."""

import math

from torch import Tensor

from torchbrdf.lobes._microfacet import (
    apply_albedo,
    beckmann_exponential,
    log_beckmann_derivative,
)
from torchbrdf.lobes._smith import beckmann_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def beckmann(pairs: Pairs, specular: Tensor, roughness: Tensor, f0: Tensor) -> Tensor:
    """The Beckmann lobe with Smith's shadowing: specular * D G F / (4 cos_i cos_o).

    D = exp(-tan2_h / m^2) / (pi m^2 cos_h^4), G = 1 / (1 + Lambda(wi) + Lambda(wo)) with Beckmann's exact Lambda
    (heights correlated), F = Schlick's Fresnel. `cook_torrance` has the same D, 4 times as high, with the shadowing of
    V-shaped grooves.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: m `(..., 1)`.
        f0: reflectance at normal incidence `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: B. Walter, S. Marschner, H. Li and K. Torrance, Microfacet Models for Refraction through Rough Surfaces,
    2007, doi:10.2312/EGWR/EGSR07/195-206; E. Heitz, Understanding the Masking-Shadowing Function in Microfacet-Based
    BRDFs, 2014, JCGT 3(2).

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import beckmann
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> beckmann(pairs, colour, torch.tensor([0.1]), torch.tensor([0.3]))
        tensor([[0.0046, 0.0092, 0.0138]])
    """
    visibility, _ = beckmann_visibility_and_log_derivative(pairs, roughness)
    return apply_albedo(pairs, _distribution(pairs, roughness) * visibility * fresnel(f0, pairs), specular)


def _distribution(pairs: Pairs, roughness: Tensor) -> Tensor:
    """D."""
    inverse = roughness.square().reciprocal()
    return beckmann_exponential(pairs, inverse) * (inverse / math.pi)


@LOBES.register("beckmann")
class Beckmann(Lobe):
    """Beckmann's distribution, with height-correlated Smith shadowing and Schlick's Fresnel.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import Beckmann
        >>> Beckmann(roughness=0.1, f0=0.04)
        Beckmann(specular=[0.5, 0.5, 0.5], roughness=0.1, f0=0.04)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.1, lower=0.001, upper=1.0, log=True, doc="m, the rms slope of the microfacets"
    )
    f0: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.02, upper=1.0, affine=True, doc="reflectance at normal incidence"
    )
    function = staticmethod(beckmann)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/dm = shape (2 tan2_h / m^3 - 2 / m + d log G / dm), d/dF0 = shape / F (1 - (1 - cos_d)^5)."""
        roughness, f0 = scalars
        visibility, by_shadowing = beckmann_visibility_and_log_derivative(pairs, roughness)
        facets = _distribution(pairs, roughness) * visibility
        shape = facets * fresnel(f0, pairs)
        slope = log_beckmann_derivative(pairs, roughness) + by_shadowing
        return [shape, shape * slope, facets * (1 - schlick_weight(pairs))]
