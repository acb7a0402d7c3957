"""The sheen lobe of cloth: an inverted Gaussian-like distribution."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine, clamped_exp, log_secant, tangent
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio


@half_in_float32
def charlie(pairs: Pairs, specular: Tensor, roughness: Tensor) -> Tensor:
    """The sheen of Estevez and Kulla: specular * D V, D = (2 + 1/a) sin_h^(1/a) / (2 pi).

    V = 1 / (4 (cos_i + cos_o - cos_i cos_o)), the soft visibility of Neubelt and Pettineo, as in glTF's
    `KHR_materials_sheen`, whose roughness is the square root of a.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo, the colour of the sheen `(..., 3)`.
        roughness: a `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: A. Estevez and C. Kulla, Production Friendly Microfacet Sheen BRDF, 2017 (SIGGRAPH course); D. Neubelt and
    M. Pettineo, Crafting a Next-Gen Material Pipeline for The Order: 1886, 2013 (SIGGRAPH course).

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import charlie
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> charlie(pairs, colour, torch.tensor([0.5]))
        tensor([[0.0006, 0.0013, 0.0019]])
    """
    return apply_albedo(pairs, _shape(pairs, roughness), specular)


def _shape(pairs: Pairs, roughness: Tensor) -> Tensor:
    inverse = roughness.reciprocal()
    height = (2 + inverse) / (2 * math.pi)
    return clamped_exp(log_sine(pairs) * inverse) * (_visibility(pairs) * height)


def log_sine(pairs: Pairs) -> Tensor:
    """log(sin_h) = (log(tan2_h) - log(1 + tan2_h)) / 2; a number far below 0 at the pole."""

    def make() -> Tensor:
        tan2, least = tangent(pairs), torch.finfo(pairs.dtype).tiny
        pole = tan2 < least
        return torch.where(pole, -1000, 0.5 * (torch.where(pole, 1, tan2).log() - log_secant(pairs)))

    return pairs.cached(log_sine, make)


def _visibility(pairs: Pairs) -> Tensor:
    def make() -> Tensor:
        cos_i, cos_o = clamp_cosine(pairs.cos_i), clamp_cosine(pairs.cos_o)
        return safe_ratio(0.25, cos_i + cos_o - cos_i * cos_o)

    return pairs.cached(_visibility, make)


@LOBES.register("charlie")
class Charlie(Lobe):
    """The sheen lobe of Estevez and Kulla, which is bright where the half vector is far from the normal.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import Charlie
        >>> Charlie(roughness=0.5)
        Charlie(specular=[0.5, 0.5, 0.5], roughness=0.5)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="colour of the sheen, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.01, upper=1.0, log=True, doc="alpha, the width of the distribution"
    )
    function = staticmethod(charlie)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """d/da = -shape (1 / (2 + 1/a) + log(sin_h)) / a^2."""
        (roughness,) = scalars
        shape, inverse = _shape(pairs, roughness), roughness.reciprocal()
        slope = torch.add(1 / (2 + inverse), log_sine(pairs))
        return [shape, shape * slope * -inverse.square()]

    @classmethod
    def pair_factors(cls, pairs: Pairs) -> list[Tensor]:
        """1 / (4 (cos_i + cos_o - cos_i cos_o))."""
        return [_visibility(pairs)]
