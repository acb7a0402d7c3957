"""Ward's lobe with Duer's normalization."""

import math

from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine, clamped_exp, log_beckmann_derivative, tangent
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio


@half_in_float32
def duer(pairs: Pairs, specular: Tensor, roughness: Tensor) -> Tensor:
    """Ward's lobe as Duer normalizes it: specular * exp(-tan2_h / a^2) / (4 pi a^2 cos_i cos_o).

    Ward's own lobe has the root of the two cosines, and loses light at grazing angles, where this one has too much:
    `ward_duer` is the bounded form that came after it.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: a `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: A. Duer, An Improved Normalization for the Ward Reflectance Model, 2006, doi:10.1080/2151237X.2006.10129215;
    fitted before by A. Ngan, F. Durand and W. Matusik, Experimental Analysis of BRDF Models, 2005,
    doi:10.2312/EGWR/EGSR05/117-126.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import duer
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> duer(pairs, colour, torch.tensor([0.1]))
        tensor([[0.0142, 0.0284, 0.0426]])
    """
    return apply_albedo(pairs, _shape(pairs, roughness), specular)


def _shape(pairs: Pairs, roughness: Tensor) -> Tensor:
    """exp(-tan2_h / a^2) / (4 pi a^2 cos_i cos_o)."""
    inverse = roughness.square().reciprocal()
    return clamped_exp(tangent(pairs) * -inverse) * (_geometry(pairs) * inverse)


def _geometry(pairs: Pairs) -> Tensor:
    """1 / (4 pi cos_i cos_o)."""

    def make() -> Tensor:
        return safe_ratio(1 / (4 * math.pi), clamp_cosine(pairs.cos_i) * clamp_cosine(pairs.cos_o))

    return pairs.cached(_geometry, make)


@LOBES.register("duer")
class Duer(Lobe):
    """Ward's lobe with Duer's normalization, with the bounds of `Ward`.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import Duer
        >>> Duer(roughness=0.1)
        Duer(specular=[0.5, 0.5, 0.5], roughness=0.1)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.01, lower=0.001, upper=0.5, log=True, doc="alpha, the width of the lobe"
    )
    function = staticmethod(duer)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/da = shape (2 tan2_h / a^3 - 2 / a)."""
        (roughness,) = scalars
        shape = _shape(pairs, roughness)
        return [shape, shape * log_beckmann_derivative(pairs, roughness)]

    @classmethod
    def pair_factors(cls, pairs: Pairs) -> list[Tensor]:
        """1 / (4 pi cos_i cos_o)."""
        return [_geometry(pairs)]
