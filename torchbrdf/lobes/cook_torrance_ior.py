"""The Cook-Torrance lobe with an index of refraction."""

from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, log_beckmann_derivative
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.cook_torrance import facets
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import dielectric, dielectric_derivative
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def cook_torrance_ior(pairs: Pairs, specular: Tensor, roughness: Tensor, ior: Tensor) -> Tensor:
    """The Cook-Torrance lobe with Fresnel's reflectance in the place of Schlick's: specular * D G F / (pi cos_i cos_o).

    D and G are those of `cook_torrance`, F is `dielectric`, as in the paper of Cook and Torrance.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: m `(..., 1)`.
        ior: a real index of refraction `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: R. Cook and K. Torrance, A Reflectance Model for Computer Graphics, 1982, doi:10.1145/357290.357293; fitted
    by J. Low, J. Kronander, A. Ynnerman and J. Unger, BRDF Models for Accurate and Efficient Rendering of Glossy
    Surfaces, 2012, doi:10.1145/2077341.2077350.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import cook_torrance_ior
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> cook_torrance_ior(pairs, colour, torch.tensor([0.1]), torch.tensor([1.5]))
        tensor([[0.0025, 0.0049, 0.0074]])
    """
    return apply_albedo(pairs, facets(pairs, roughness) * dielectric(ior, pairs.cos_d), specular)


@LOBES.register("cook_torrance_ior")
class CookTorranceIOR(Lobe):
    """Cook-Torrance with a real index of refraction; the bounds hold all fits of Low et al.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import CookTorranceIOR
        >>> CookTorranceIOR(roughness=0.1)
        CookTorranceIOR(specular=[0.1, 0.1, 0.1], roughness=0.1, ior=1.5)
    """

    specular: BoundedParameter = albedo(start=0.1, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.02, lower=0.001, upper=3.0, log=True, doc="m, the rms slope of the microfacets"
    )
    ior: BoundedParameter = BoundedParameter(
        start=1.5, lower=1.02, upper=100.0, log=True, doc="index of refraction, real"
    )
    function = staticmethod(cook_torrance_ior)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/dm = shape (2 tan2_h / m^3 - 2 / m), d/d(ior) = D G F' / (pi cos_i cos_o)."""
        roughness, ior = scalars
        own = facets(pairs, roughness)
        shape = own * dielectric(ior, pairs.cos_d)
        slope = shape * log_beckmann_derivative(pairs, roughness)
        return [shape, slope, own * dielectric_derivative(ior, pairs.cos_d)]
