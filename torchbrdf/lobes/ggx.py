"""The GGX lobe: Trowbridge and Reitz' distribution with Smith's shadowing."""

import math

from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, tangent
from torchbrdf.lobes._smith import ggx_visibility, ggx_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def ggx(pairs: Pairs, specular: Tensor, roughness: Tensor, f0: Tensor) -> Tensor:
    """The GGX lobe: specular * D G F / (4 cos_i cos_o).

    D = a^2 / (pi cos_h^4 (a^2 + tan2_h)^2) (Trowbridge-Reitz), G = 1 / (1 + Lambda(wi) + Lambda(wo)) (Smith, heights
    correlated), F = Schlick's Fresnel.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: a `(..., 1)`; renderers' own "roughness" often is its square root.
        f0: reflectance at normal incidence `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: B. Walter, S. Marschner, H. Li and K. Torrance, Microfacet Models for Refraction through Rough Surfaces,
    2007, doi:10.2312/EGWR/EGSR07/195-206; T. Trowbridge and K. Reitz, Average irregularity representation of a rough
    surface for ray reflection, 1975, doi:10.1364/JOSA.65.000531; E. Heitz, Understanding the Masking-Shadowing Function
    in Microfacet-Based BRDFs, 2014, JCGT 3(2).

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ggx
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> ggx(pairs, colour, torch.tensor([0.1]), torch.tensor([0.3]))
        tensor([[0.0108, 0.0215, 0.0323]])
    """
    facets = ggx_distribution(roughness, tangent(pairs)) * ggx_visibility(pairs, roughness)
    return apply_albedo(pairs, facets * fresnel(f0, pairs), specular)


def ggx_distribution(roughness: Tensor, tan2: Tensor) -> Tensor:
    """D = (a (1 + tan2_h) / (a^2 + tan2_h))^2 / pi."""
    return ((1 + tan2) / (roughness.square() + tan2)).square() * (roughness.square() / math.pi)


@LOBES.register("ggx")
class GGX(Lobe):
    """The GGX lobe, with height-correlated Smith shadowing and Schlick's Fresnel, as in most renderers.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import GGX
        >>> GGX(roughness=0.1, f0=0.04)
        GGX(specular=[0.5, 0.5, 0.5], roughness=0.1, f0=0.04)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.1, lower=0.001, upper=1.0, log=True, doc="alpha, the width of the distribution"
    )
    f0: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.02, upper=1.0, affine=True, doc="reflectance at normal incidence"
    )
    function = staticmethod(ggx)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/da = shape (2 / a - 4 a / (a^2 + tan2_h) + d log G / da), d/dF0 = shape / F (1 - (1 - cos_d)^5)."""
        roughness, f0 = scalars
        visibility, slope = ggx_visibility_and_log_derivative(pairs, roughness)
        facets = ggx_distribution(roughness, tangent(pairs)) * visibility
        shape = facets * fresnel(f0, pairs)
        slope = slope + 2 / roughness - 4 * roughness / (roughness.square() + tangent(pairs))
        return [shape, shape * slope, facets * (1 - schlick_weight(pairs))]
