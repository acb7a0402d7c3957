"""Ward's isotropic lobe."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine, clamped_exp, log_beckmann_derivative, tangent
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def ward(pairs: Pairs, specular: Tensor, roughness: Tensor) -> Tensor:
    """Ward's isotropic lobe: specular * exp(-tan2_h / roughness^2) / (4 pi roughness^2 sqrt(cos_i cos_o)).

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: alpha `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: the paper's eq. 7; G. Ward, Measuring and Modeling Anisotropic Reflection, 1992,
    doi:10.1145/142920.134078.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ward
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> ward(pairs, colour, torch.tensor([0.1]))
        tensor([[0.0136, 0.0272, 0.0408]])
    """
    return apply_albedo(pairs, _shape(pairs, roughness), specular)


def _shape(pairs: Pairs, roughness: Tensor) -> Tensor:
    inverse = roughness.square().reciprocal()
    return clamped_exp(tangent(pairs) * -inverse) * (_geometry(pairs) * inverse)


def _geometry(pairs: Pairs) -> Tensor:
    """1 / (4 pi sqrt(cos_i cos_o))."""

    def make() -> Tensor:
        return torch.rsqrt(clamp_cosine(pairs.cos_i)) * torch.rsqrt(clamp_cosine(pairs.cos_o)) / (4 * math.pi)

    return pairs.cached(_geometry, make)


@LOBES.register("ward")
class Ward(Lobe):
    """Ward's isotropic lobe (eq. 7), with the start and bounds of the paper's Table 1.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import Ward
        >>> Ward(roughness=0.1)
        Ward(specular=[0.5, 0.5, 0.5], roughness=0.1)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.01, lower=0.001, upper=0.5, log=True, doc="alpha, the width of the lobe"
    )
    function = staticmethod(ward)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/d(alpha) = shape (2 tan2_h / alpha^3 - 2 / alpha)."""
        (roughness,) = scalars
        shape = _shape(pairs, roughness)
        return [shape, shape * log_beckmann_derivative(pairs, roughness)]

    @classmethod
    def pair_factors(cls, pairs: Pairs) -> list[Tensor]:
        """1 / (4 pi sqrt(cos_i cos_o))."""
        return [_geometry(pairs)]
