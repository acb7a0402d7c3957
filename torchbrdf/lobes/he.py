"""He's lobe: light as a wave on a rough surface."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchbrdf.lobes._he_series import he_series, he_series_and_derivatives, lambert_w
from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine, log_secant
from torchbrdf.lobes._smith import beckmann_masked
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import dielectric, dielectric_derivative
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.pairs import Pairs


@half_in_float32
def he(pairs: Pairs, specular: Tensor, roughness: Tensor, autocorrelation: Tensor, ior: Tensor) -> Tensor:
    """The directional-diffuse lobe of He et al., unpolarized: specular * F G S D / (pi cos_i cos_o).

    D = pi^2 tau^2 / 4 sum_m g^m exp(-g) / (m! m) exp(-x / m) over all m from 1, with g = (2 pi sigma (cos_i + cos_o))^2
    and x = (pi tau)^2 |wi + wo|_xy^2; G = (2 cos_d / cos_h)^2, which theirs is where light is not polarized; S is
    S(wi) S(wo), S(w) = (1 - erfc(v) / 2) / (1 + Lambda(v)), v = tau cot(theta) / (2 sigma_0), with Beckmann's Lambda,
    whose exponential is missing in the paper's eq. 25; F is `dielectric`. sigma is the roughness that light sees
    (eq. 80): sigma_0 / sqrt(1 + w), w exp(w) = (K_i + K_o)^2 / (8 pi), K = tan(theta) erfc(v). Lengths are in
    wavelengths, the same for all channels. The sum has all its terms, however large g is.

    Where sigma_0 is large this is Beckmann's microfacet lobe with m = 2 sigma_0 / tau, and only that ratio matters. The
    paper's mirror term, exp(-g) of the light that a smooth surface reflects in one direction, is no lobe, and left out,
    as by Ngan et al.; its uniform diffuse term is a model's diffuse term.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo `(..., 3)`.
        roughness: sigma_0, the rms height, in wavelengths `(..., 1)`.
        autocorrelation: tau, the length over which heights are alike, in wavelengths `(..., 1)`.
        ior: a real index of refraction `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: X. He, K. Torrance, F. Sillion and D. Greenberg, A Comprehensive Physical Model for Light Reflection, 1991,
    doi:10.1145/127719.122738, with x as in S. Westin's program. The published fits of A. Ngan, F. Durand and
    W. Matusik, Experimental Analysis of BRDF Models, 2005, doi:10.2312/EGWR/EGSR05/117-126, come nearest to what was
    measured with a wavelength of 0.65, so that their lengths seem to be micrometres.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import he
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs = Pairs.from_half_diff(angle, angle, angle)
        >>> he(pairs, colour, *torch.tensor([[0.5], [10.0], [1.5]]))
        tensor([[0.0006, 0.0013, 0.0019]])
    """
    surface = _surface(pairs, roughness, autocorrelation)
    facets = surface.height * he_series(surface.g, surface.x)
    return apply_albedo(pairs, facets * dielectric(ior, pairs.cos_d), specular)


class _Surface(NamedTuple):
    """What light meets: everything but F and the series, which is R = D / g; derivatives are by m = 2 sigma_0 / tau."""

    height: Tensor
    g: Tensor
    x: Tensor
    log_shadowing_slope: Tensor
    log_sigma_slope: Tensor


def _surface(pairs: Pairs, roughness: Tensor, autocorrelation: Tensor) -> _Surface:
    cos_i, cos_o = clamp_cosine(pairs.cos_i), clamp_cosine(pairs.cos_o)
    slope = 2 * roughness / autocorrelation
    (lit_i, lit_slope_i, *k_i), (lit_o, lit_slope_o, *k_o) = (_lit(cosine, slope) for cosine in (cos_i, cos_o))
    k, k_slope = (i + o for i, o in zip(k_i, k_o, strict=True))
    hidden = lambert_w(k.square() / (8 * math.pi))
    sigma_square = roughness.square() / (1 + hidden)
    height = (16 * math.pi**3) * (autocorrelation * _cos_d_square(pairs)).square() * sigma_square * lit_i * lit_o
    sigma_slope = (-hidden).exp() * k * k_slope / (-8 * math.pi * (1 + hidden).square())
    g = sigma_square * (2 * math.pi * (cos_i + cos_o)).square()
    return _Surface(height, g, autocorrelation.square() * _aside(pairs), lit_slope_i + lit_slope_o, sigma_slope)


def _cos_d_square(pairs: Pairs) -> Tensor:
    """cos_d^2."""
    return pairs.cached(_cos_d_square, lambda: pairs.cos_d.square())


def _aside(pairs: Pairs) -> Tensor:
    """pi^2 |wi + wo|_xy^2 = (2 pi cos_d sin_h)^2."""

    def make() -> Tensor:
        return (4 * math.pi**2) * _cos_d_square(pairs) * -torch.expm1(-log_secant(pairs))

    return pairs.cached(_aside, make)


def _lit(cosine: Tensor, slope: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """S / cos, the derivative of its logarithm by m, K, and its derivative."""
    masked, by_slope, hidden = beckmann_masked(cosine, slope)
    total, seen = cosine + masked, 1 - 0.5 * hidden
    sine = ((1 - cosine) * (1 + cosine)).clamp_min(1e-12).sqrt()
    # by_slope is sin exp(-v^2) / (2 sqrt(pi)), and the derivative of erfc(v) is 2 exp(-v^2) v / (sqrt(pi) m).
    k_slope = 4 * by_slope / (sine * slope.square())
    by_hidden = k_slope * cosine / sine
    return seen / total, -0.5 * by_hidden / seen - by_slope / total, hidden * (sine / cosine), k_slope


@LOBES.register("he")
class He(Lobe):
    """He's lobe, unpolarized, without the mirror term; the bounds hold nearly all fits of Ngan et al.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import He
        >>> He(roughness=0.2, autocorrelation=30.0)
        He(specular=[0.5, 0.5, 0.5], roughness=0.2, autocorrelation=30, ior=1.5)
    """

    specular: BoundedParameter = albedo(start=0.5, upper=100.0, doc="specular albedo, per channel")
    roughness: BoundedParameter = BoundedParameter(
        start=0.5, lower=0.01, upper=10.0, log=True, doc="sigma_0, the rms height, in wavelengths"
    )
    autocorrelation: BoundedParameter = BoundedParameter(
        start=20.0, lower=1.0, upper=200.0, log=True, doc="tau, the autocorrelation length, in wavelengths"
    )
    ior: BoundedParameter = BoundedParameter(
        start=1.5, lower=1.02, upper=100.0, log=True, doc="index of refraction, real"
    )
    function = staticmethod(he)

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """By way of m = 2 sigma_0 / tau, on which the shadowing and sigma / sigma_0 depend, and of R by g and x."""
        roughness, autocorrelation, ior = scalars
        surface = _surface(pairs, roughness, autocorrelation)
        series, by_g, by_x = he_series_and_derivatives(surface.g, surface.x)
        reflected, by_ior = dielectric(ior, pairs.cos_d), dielectric_derivative(ior, pairs.cos_d)
        scale = surface.height * reflected
        of_sigma = 2 * (series + surface.g * by_g)
        by_slope = series * surface.log_shadowing_slope + of_sigma * surface.log_sigma_slope
        by_roughness = of_sigma / roughness + by_slope * (2 / autocorrelation)
        of_length = 2 * (series + surface.x * by_x) / autocorrelation
        by_length = of_length - by_slope * (2 * roughness / autocorrelation.square())
        return [scale * series, scale * by_roughness, scale * by_length, surface.height * series * by_ior]
