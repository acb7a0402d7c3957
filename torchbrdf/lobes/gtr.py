"""Burley's generalization of the GGX distribution, whose exponent sets the length of the tail."""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import apply_albedo, clamped_exp, log_secant, tangent
from torchbrdf.lobes._smith import ggx_visibility, ggx_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def gtr(pairs: Pairs, specular: Tensor, roughness: Tensor, exponent: Tensor, f0: Tensor) -> Tensor:
    """The generalized Trowbridge-Reitz lobe: specular * D G F / (4 cos_i cos_o).

    D = c / (1 - (1 - a^2) cos_h^2)^g, normalized: c = (g - 1) (1 - a^2) / (pi (a^(2 - 2 g) - 1)), and
    (1 - a^2) / (pi log(a^-2)) for g = 1. G is Smith's of GGX with the same a, F is Schlick's Fresnel. g = 2 is GGX, 1
    Berry's distribution, with a longer tail.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: a `(..., 1)`.
        exponent: g `(..., 1)`.
        f0: reflectance at normal incidence `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: B. Burley, Physically Based Shading at Disney, 2012 (SIGGRAPH course), appendix B.2; the shadowing is that
    of its section 5.6, without the remapping of roughness, and with heights correlated.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import gtr
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> gtr(pairs, colour, *torch.tensor([[0.1], [2.0], [0.3]]))
        tensor([[0.0108, 0.0215, 0.0323]])
    """
    facets = _distribution(_log_ratio(pairs, roughness), roughness, exponent) * ggx_visibility(pairs, roughness)
    return apply_albedo(pairs, facets * fresnel(f0, pairs), specular)


def _distribution(log_ratio: Tensor, roughness: Tensor, exponent: Tensor) -> Tensor:
    """D, of which nothing overflows, from `_log_ratio`, u.

    With L = log(a^2) and q(x) = (e^x - 1) / x it is q(L) e^(g u) / (pi a^2 q((g - 1) L)).
    """
    log_square = 2 * roughness.log()
    height = _q(log_square) / _q((exponent - 1) * log_square) / (math.pi * roughness.square())
    return clamped_exp(exponent * log_ratio) * height


def _log_ratio(pairs: Pairs, roughness: Tensor) -> Tensor:
    """log(1 + tan2_h) - log(1 + tan2_h / a^2)."""
    return log_secant(pairs) - torch.log1p(tangent(pairs) / roughness.square())


def _q(x: Tensor) -> Tensor:
    """(e^x - 1) / x, 1 at 0."""
    small = x.abs() < 1e-3
    safe = torch.where(small, 1, x)
    series = 1 + x / 2 * (1 + x / 3 * (1 + x / 4 * (1 + x / 5)))
    return torch.where(small, series, torch.expm1(safe) / safe)


def _log_q_derivative(x: Tensor) -> Tensor:
    """Derivative of log((e^x - 1) / x): 1 / (1 - e^-x) - 1 / x, 1/2 at 0."""
    small = x.abs() < 1e-2
    safe = torch.where(small, 1, x)
    return torch.where(small, 0.5 + x / 12 * (1 - x.square() / 60), -1 / torch.expm1(-safe) - 1 / safe)


@LOBES.register("gtr")
class GTR(Lobe):
    """Burley's generalized Trowbridge-Reitz distribution, for tails that are longer or shorter than GGX's.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import GTR
        >>> GTR(roughness=0.1, exponent=1.5)
        GTR(specular=[0.5, 0.5, 0.5], roughness=0.1, exponent=1.5, f0=0.3)
    """

    specular: BoundedParameter = albedo(start=0.5, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.1, lower=0.001, upper=1.0, log=True, doc="alpha, the width of the distribution"
    )
    exponent: BoundedParameter = BoundedParameter(
        start=2.0, lower=0.5, upper=10.0, log=True, doc="gamma, how fast the tail falls; 2 is GGX"
    )
    f0: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.02, upper=1.0, affine=True, doc="reflectance at normal incidence"
    )
    function = staticmethod(gtr)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """Derivatives of the logarithm, with q' = d log q.

        By g: u - L q'((g - 1) L); by a: 2 (q'(L) - (g - 1) q'((g - 1) L) - 1 + g tan2_h / (a^2 + tan2_h)) / a, and G's.
        """
        roughness, exponent, f0 = scalars
        visibility, by_roughness = ggx_visibility_and_log_derivative(pairs, roughness)
        log_ratio = _log_ratio(pairs, roughness)
        facets = _distribution(log_ratio, roughness, exponent) * visibility
        shape, tan2, log_square = facets * fresnel(f0, pairs), tangent(pairs), 2 * roughness.log()
        own = _log_q_derivative((exponent - 1) * log_square)
        constant = _log_q_derivative(log_square) - (exponent - 1) * own - 1
        slope = constant + exponent * (tan2 / (roughness.square() + tan2))
        by_roughness = by_roughness + slope * (2 / roughness)
        by_exponent = log_ratio - log_square * own
        return [shape, shape * by_roughness, shape * by_exponent, facets * (1 - schlick_weight(pairs))]
