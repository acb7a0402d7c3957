"""The isotropic Ashikhmin-Shirley lobe with an index of refraction."""

from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo
from torchbrdf.lobes.ashikhmin_shirley import half_power, log_half_power_derivative
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import dielectric, dielectric_derivative
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def ashikhmin_shirley_ior(pairs: Pairs, specular: Tensor, exponent: Tensor, ior: Tensor) -> Tensor:
    """The isotropic Ashikhmin-Shirley lobe with Fresnel's reflectance in the place of Schlick's.

    specular * (m + 1) / (8 pi) * cos_h^m / (cos_d max(cos_i, cos_o)) * F, where F is `dielectric`.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        exponent: m `(..., 1)`.
        ior: a real index of refraction `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: M. Ashikhmin and P. Shirley, An Anisotropic Phong BRDF Model, 2000, doi:10.1080/10867651.2000.10487522; with
    this Fresnel term fitted by J. Low, J. Kronander, A. Ynnerman and J. Unger, BRDF Models for Accurate and Efficient
    Rendering of Glossy Surfaces, 2012, doi:10.1145/2077341.2077350.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ashikhmin_shirley_ior
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> ashikhmin_shirley_ior(pairs, colour, torch.tensor([50.0]), torch.tensor([1.5]))
        tensor([[0.0030, 0.0061, 0.0091]])
    """
    return apply_albedo(pairs, half_power(pairs, exponent) * dielectric(ior, pairs.cos_d), specular)


@LOBES.register("ashikhmin_shirley_ior")
class AshikhminShirleyIOR(Lobe):
    """The isotropic Ashikhmin-Shirley lobe with a real index of refraction; the bounds hold all fits of Low et al.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import AshikhminShirleyIOR
        >>> AshikhminShirleyIOR(exponent=50.0)
        AshikhminShirleyIOR(specular=[0.5, 0.5, 0.5], exponent=50, ior=1.5)
    """

    specular: BoundedParameter = albedo(start=0.5, upper=5.0, doc="specular albedo, per channel")
    exponent: BoundedParameter = BoundedParameter(
        start=5.0, lower=0.001, upper=1e6, log=True, doc="m, the sharpness of the lobe"
    )
    ior: BoundedParameter = BoundedParameter(
        start=1.5, lower=1.02, upper=100.0, log=True, doc="index of refraction, real"
    )
    function = staticmethod(ashikhmin_shirley_ior)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/dm = shape (1 / (m + 1) + log(cos_h)), d/d(ior) = shape F' / F."""
        exponent, ior = scalars
        power = half_power(pairs, exponent)
        shape = power * dielectric(ior, pairs.cos_d)
        slope = shape * log_half_power_derivative(pairs, exponent)
        return [shape, slope, power * dielectric_derivative(ior, pairs.cos_d)]
