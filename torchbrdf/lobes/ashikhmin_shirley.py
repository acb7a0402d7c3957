"""The isotropic Ashikhmin-Shirley lobe."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine, clamped_exp, log_secant
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio


@half_in_float32
def ashikhmin_shirley(pairs: Pairs, specular: Tensor, exponent: Tensor, f0: Tensor) -> Tensor:
    """The isotropic Ashikhmin-Shirley lobe: specular * (m + 1) / (8 pi) * cos_h^m / (cos_d max(cos_i, cos_o)) * F.

    F is Schlick's Fresnel.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        exponent: m `(..., 1)`.
        f0: reflectance at normal incidence `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: the paper's eq. 2 and 3; M. Ashikhmin and P. Shirley, An Anisotropic Phong BRDF Model, 2000,
    doi:10.1080/10867651.2000.10487522.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ashikhmin_shirley
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> ashikhmin_shirley(pairs, colour, torch.tensor([50.0]), torch.tensor([0.3]))
        tensor([[0.0227, 0.0454, 0.0681]])
    """
    return apply_albedo(pairs, half_power(pairs, exponent) * fresnel(f0, pairs), specular)


def half_power(pairs: Pairs, exponent: Tensor) -> Tensor:
    """(m + 1) / (8 pi) * cos_h^m / (cos_d max(cos_i, cos_o))."""
    # cos_h^m by way of tan2_h: at m = 50000 a float32 cos_h near 1 has too few digits.
    return clamped_exp(log_secant(pairs) * (-0.5 * exponent)) * (_geometry(pairs) * (exponent + 1))


def _geometry(pairs: Pairs) -> Tensor:
    """1 / (8 pi cos_d max(cos_i, cos_o))."""

    def make() -> Tensor:
        highest = torch.maximum(clamp_cosine(pairs.cos_i), pairs.cos_o)
        return safe_ratio(1, clamp_cosine(pairs.cos_d) * highest) / (8 * math.pi)

    return pairs.cached(_geometry, make)


def log_half_power_derivative(pairs: Pairs, exponent: Tensor) -> Tensor:
    """Derivative of log(half_power) by m: 1 / (m + 1) + log(cos_h)."""
    return torch.add(1 / (exponent + 1), log_secant(pairs), alpha=-0.5)


@LOBES.register("ashikhmin_shirley")
class AshikhminShirley(Lobe):
    """The isotropic Ashikhmin-Shirley lobe (eq. 2 and 3), with the start and bounds of the paper's Table 1.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import AshikhminShirley
        >>> AshikhminShirley(exponent=50.0)
        AshikhminShirley(specular=[0.5, 0.5, 0.5], exponent=50, f0=0.3)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="specular albedo, per channel")
    exponent: BoundedParameter = BoundedParameter(
        start=5.0, lower=0.001, upper=50000.0, log=True, doc="m, the sharpness of the lobe"
    )
    f0: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.02, upper=1.0, affine=True, doc="reflectance at normal incidence"
    )
    function = staticmethod(ashikhmin_shirley)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/dm = shape (1 / (m + 1) + log(cos_h)), d/dF0 = shape / F (1 - (1 - cos_d)^5)."""
        exponent, f0 = scalars
        power = half_power(pairs, exponent)
        shape = power * fresnel(f0, pairs)
        slope = shape * log_half_power_derivative(pairs, exponent)
        return [shape, slope, power * (1 - schlick_weight(pairs))]

    @classmethod
    def pair_factors(cls, pairs: Pairs) -> list[Tensor]:
        """1 / (8 pi cos_d max(cos_i, cos_o)), and that times (1 - cos_d)^5."""
        geometry = _geometry(pairs)
        return [geometry, geometry * schlick_weight(pairs)]
