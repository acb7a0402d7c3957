"""Blinn's lobe: a power of the cosine of the half vector."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamped_exp, log_secant
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def blinn_phong(pairs: Pairs, specular: Tensor, exponent: Tensor) -> Tensor:
    """Blinn's lobe: specular * (n + 2) / (2 pi) * cos_h^n.

    Nothing is divided by cosines. (n + 2) / (2 pi) makes cos_h^n times a cosine integrate to 1 over the half vectors.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        exponent: n `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: J. Blinn, Models of Light Reflection for Computer Synthesized Pictures, 1977, doi:10.1145/965141.563893;
    the factor is that of A. Ngan, F. Durand and W. Matusik, Experimental Analysis of BRDF Models, 2005,
    doi:10.2312/EGWR/EGSR05/117-126.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import blinn_phong
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> blinn_phong(pairs, colour, torch.tensor([100.0]))
        tensor([[0.2168, 0.4335, 0.6503]])
    """
    return apply_albedo(pairs, _power(pairs, exponent), specular)


def _power(pairs: Pairs, exponent: Tensor) -> Tensor:
    # cos_h^n by way of tan2_h: at n = 100000 a float32 cos_h near 1 has too few digits.
    return clamped_exp(log_secant(pairs) * (-0.5 * exponent)) * ((exponent + 2) / (2 * math.pi))


@LOBES.register("blinn_phong")
class BlinnPhong(Lobe):
    """Blinn's lobe with the factor of Ngan et al.; the bounds hold all of their fits.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import BlinnPhong
        >>> BlinnPhong(exponent=50.0)
        BlinnPhong(specular=[0.1, 0.1, 0.1], exponent=50)
    """

    specular: BoundedParameter = albedo(start=0.1, doc="specular albedo, per channel")
    exponent: BoundedParameter = BoundedParameter(
        start=100.0, lower=0.001, upper=200_000.0, log=True, doc="n, the sharpness of the lobe"
    )
    function = staticmethod(blinn_phong)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/dn = shape (1 / (n + 2) + log(cos_h))."""
        (exponent,) = scalars
        shape = _power(pairs, exponent)
        return [shape, shape * torch.add(1 / (exponent + 2), log_secant(pairs), alpha=-0.5)]

    @classmethod
    def pair_factors(cls, pairs: Pairs) -> list[Tensor]:
        """1."""
        return [torch.ones_like(pairs.tan2_h)]
