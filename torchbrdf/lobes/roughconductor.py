"""Mitsuba's rough conductor: GGX with uncorrelated shadowing and the Fresnel equations of a metal."""

from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, tangent
from torchbrdf.lobes._smith import ggx_separable_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import conductor
from torchbrdf.lobes.ggx import ggx_distribution
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def roughconductor(pairs: Pairs, specular: Tensor, roughness: Tensor, eta: Tensor, k: Tensor) -> Tensor:
    """Mitsuba's `roughconductor` of the distribution `ggx`: specular * D G F / (4 cos_i cos_o).

    D is that of `ggx`, G = G1(wi) G1(wo) (Smith, heights uncorrelated), F the reflectance of a metal of the index of
    refraction eta + i k, which all channels share; `specular` is Mitsuba's `specular_reflectance`.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: colour `(..., 3)`.
        roughness: a `(..., 1)`, Mitsuba's `alpha`.
        eta: real part of the index of refraction `(..., 1)`.
        k: imaginary part `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: W. Jakob et al., Mitsuba 3, 2022, https://mitsuba-renderer.org; B. Walter, S. Marschner, H. Li and K.
    Torrance, Microfacet Models for Refraction through Rough Surfaces, 2007, doi:10.2312/EGWR/EGSR07/195-206.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import roughconductor
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> roughconductor(pairs, colour, *torch.tensor([[0.1], [0.2], [3.0]]))
        tensor([[0.0331, 0.0662, 0.0993]])
    """
    visibility, _ = ggx_separable_visibility_and_log_derivative(pairs, roughness)
    facets = ggx_distribution(roughness, tangent(pairs)) * visibility
    return apply_albedo(pairs, facets * conductor(eta, k, pairs.cos_d), specular)


@LOBES.register("roughconductor")
class RoughConductor(Lobe):
    """Mitsuba's rough conductor, exactly: GGX with uncorrelated shadowing, eta and k of all channels, and a colour.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import RoughConductor
        >>> RoughConductor(roughness=0.1, eta=0.2)
        RoughConductor(specular=[0.5, 0.5, 0.5], roughness=0.1, eta=0.2, k=2)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="colour that multiplies the reflectance, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.1, lower=0.001, upper=1.0, log=True, doc="alpha, the width of the distribution"
    )
    eta: BoundedParameter = BoundedParameter(
        start=1.0, lower=0.02, upper=10.0, log=True, doc="index of refraction, real part"
    )
    k: BoundedParameter = BoundedParameter(
        start=2.0, lower=0.02, upper=20.0, log=True, doc="index of refraction, imaginary part"
    )
    function = staticmethod(roughconductor)
