"""The microfacet lobe with the shifted gamma distribution (SGD)."""

import math
from functools import partial
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import clamped_exp, log_secant, tangent
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.lobes.separable import Slopes
from torchbrdf.pairs import Pairs

# Below this a product of cosines no longer changes a quotient.
PRODUCT_FLOOR = 1e-13
# An exponent of the shadowing beyond which it is complete: exp(exp(3)) is 5e8.
COMPLETE = 3.0
# Radians from where shadowing begins; that the logarithm of less is not asked for.
LEAST_ANGLE = 1e-30


@half_in_float32
def shifted_gamma(
    pairs: Pairs,
    specular: Tensor,
    alpha: Tensor,
    p: Tensor,
    normalization: Tensor,
    f0: Tensor,
    f1: Tensor,
    shadow: Tensor,
    reach: Tensor,
    steepness: Tensor,
    onset: Tensor,
) -> Tensor:
    """The shifted gamma lobe: specular * D G(theta_i) G(theta_o) F / (pi cos_i cos_o), each channel by itself.

    D = K exp(-t) / (pi t^p cos_h^4) with t = alpha + tan2_h / alpha. It is normalized where K is
    1 / (alpha Gamma(1 - p, alpha)), with the upper incomplete gamma function; all published K are.
    G(theta) = 1 + Lambda (1 - exp(c (theta - theta0)^k)) from theta0 on and 1 before it, with the angle in radians.
    Published c go from 1e-8 to 1e109 and k to 856; here c is reach^-k, so that the exponent is ((theta - theta0) /
    reach)^k, which loses nothing in float32. F = F0 + (1 - F0) (1 - cos_d)^5 - F1 cos_d. G and F are not below 0.

    Args:
        pairs: where values are wanted, `(..., N)`.
        specular: albedo, `(..., 3)` as all that follow.
        alpha: width, squared.
        p: how fast the tail falls.
        normalization: K.
        f0: F0.
        f1: F1.
        shadow: Lambda.
        reach: c^(-1/k), radians.
        steepness: k.
        onset: theta0, radians.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: M. Bagher, C. Soler and N. Holzschuch, Accurate Fitting of Measured Reflectances Using a Shifted Gamma
    Micro-facet Distribution, 2012, doi:10.1111/j.1467-8659.2012.03147.x.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ShiftedGamma, shifted_gamma
        >>> angle = torch.full((1,), 0.2)
        >>> starts = [torch.full((3,), spec.start) for spec in ShiftedGamma.parameter_specs.values()]
        >>> shifted_gamma(Pairs.from_half_diff(angle, angle, angle), *starts)
        tensor([[0.0053, 0.0053, 0.0053]])
    """
    found = _lit_facets(pairs, alpha, p).value * _reflected(pairs, f0, f1).clamp_min(0)
    for name, cosine in _directions(pairs):
        found = found * _seen(pairs, name, cosine, shadow, reach, steepness, onset).value
    return found.mT * (specular * normalization)[..., None, :]


class _Facets(NamedTuple):
    """D / (pi cos_i cos_o) and its t, of each channel, `(..., C, N)`."""

    value: Tensor
    shifted: Tensor
    log_shifted: Tensor


def _lit_facets(pairs: Pairs, alpha: Tensor, p: Tensor) -> _Facets:
    shifted = alpha[..., None] + tangent(pairs)[..., None, :] / alpha[..., None]
    log_shifted = shifted.log()
    # cos_h^-4 = (1 + tan2_h)^2 goes into the exponent, so that 0 * inf cannot come up at grazing half vectors.
    facets = clamped_exp(2 * log_secant(pairs)[..., None, :] - shifted - p[..., None] * log_shifted)
    return _Facets(facets * _lit(pairs)[..., None, :], shifted, log_shifted)


def _lit(pairs: Pairs) -> Tensor:
    """1 / (pi^2 cos_i cos_o), 0 below the horizon."""

    def make() -> Tensor:
        lit = 1 / (math.pi**2 * (pairs.cos_i * pairs.cos_o).clamp_min(PRODUCT_FLOOR))
        return torch.where(pairs.above_horizon, lit, 0)

    return pairs.cached(_lit, make)


def _reflected(pairs: Pairs, f0: Tensor, f1: Tensor) -> Tensor:
    """F of each channel, which may be below 0, `(..., C, N)`."""
    f0, f1 = f0[..., None], f1[..., None]
    return f0 + (1 - f0) * schlick_weight(pairs)[..., None, :] - f1 * pairs.cos_d[..., None, :]


def _directions(pairs: Pairs) -> tuple[tuple[str, Tensor], ...]:
    return ("theta_i", pairs.cos_i), ("theta_o", pairs.cos_o)


class _Seen(NamedTuple):
    """G of one direction, of each channel, and what its derivatives are made of, `(..., C, N)`.

    beyond: theta - theta0; log: of it over the reach; power: k times that; grown: its exp; fall: expm1 of that.
    """

    value: Tensor
    beyond: Tensor
    log: Tensor
    power: Tensor
    grown: Tensor
    fall: Tensor


def _seen(
    pairs: Pairs, name: str, cosine: Tensor, shadow: Tensor, reach: Tensor, steepness: Tensor, onset: Tensor
) -> _Seen:
    theta = pairs.cached(_angle, partial(_angle, cosine), name)[..., None, :]
    # The floor keeps the logarithm finite; to any power from 1 on it is nothing.
    beyond = (theta - onset[..., None]).clamp_min(LEAST_ANGLE)
    log = (beyond / reach[..., None]).log()
    power = steepness[..., None] * log
    grown = power.clamp_max(COMPLETE).exp()
    fall = torch.expm1(grown)
    return _Seen((1 - shadow[..., None] * fall).clamp_min(0), beyond, log, power, grown, fall)


def _seen_slopes(
    seen: _Seen, shadow: Tensor, reach: Tensor, steepness: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The derivatives of G by shadow, reach, steepness and onset; nothing where it is clamped."""
    shadow, reach, steepness = shadow[..., None], reach[..., None], steepness[..., None]
    there = seen.value > 0
    rate = torch.where(there & (seen.power < COMPLETE), -shadow * (seen.fall + 1) * seen.grown, 0)
    by_onset = torch.where(seen.beyond > LEAST_ANGLE, rate * (-steepness / seen.beyond), 0)
    return torch.where(there, -seen.fall, 0), rate * (-steepness / reach), rate * seen.log, by_onset


def _angle(cosine: Tensor) -> Tensor:
    """The angle of a cosine, by way of the sine, which is kept from 0, where the slope is infinite."""
    return torch.atan2(((1 - cosine) * (1 + cosine)).clamp_min(1e-30).sqrt(), cosine)


@LOBES.register("shifted_gamma")
class ShiftedGamma(Lobe):
    """The shifted gamma lobe; ten numbers for each channel, whose bounds hold the published fits.

    The value depends on the product of `specular` and `normalization` only, and fits move both.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import ShiftedGamma
        >>> ShiftedGamma(p=0.75).p.tolist()
        [0.75, 0.75, 0.75]
    """

    specular: BoundedParameter = albedo(start=0.1, upper=5.0, doc="specular albedo, per channel")
    alpha: BoundedParameter = BoundedParameter(
        start=0.05, lower=1e-5, upper=1.0, shape=(3,), log=True, doc="width of the lobe, squared"
    )
    p: BoundedParameter = BoundedParameter(start=0.5, lower=0.0, upper=2.0, shape=(3,), doc="how fast the tail falls")
    normalization: BoundedParameter = BoundedParameter(
        start=10.0, lower=1.0, upper=1e5, shape=(3,), log=True, doc="K of the distribution"
    )
    f0: BoundedParameter = BoundedParameter(start=0.1, lower=0.0, upper=10.0, shape=(3,), doc="F0 of the Fresnel term")
    f1: BoundedParameter = BoundedParameter(start=0.0, lower=-1.0, upper=8.0, shape=(3,), doc="F1 of the Fresnel term")
    shadow: BoundedParameter = BoundedParameter(
        start=3.0, lower=1e-8, upper=1e8, shape=(3,), log=True, doc="Lambda, the depth of the shadowing"
    )
    reach: BoundedParameter = BoundedParameter(
        start=1.5, lower=0.3, upper=2.5, shape=(3,), log=True, doc="c^(-1/k) of the shadowing, radians"
    )
    steepness: BoundedParameter = BoundedParameter(
        start=20.0, lower=1.0, upper=1000.0, shape=(3,), log=True, doc="k of the shadowing"
    )
    onset: BoundedParameter = BoundedParameter(
        start=0.2, lower=-0.7, upper=1.25, shape=(3,), doc="theta0, where the shadowing begins, radians"
    )
    function = staticmethod(shifted_gamma)
    scalars_of_terms: ClassVar[tuple[str, ...]] = ("alpha", "p", "f0", "f1", "shadow", "reach", "steepness", "onset")

    @classmethod
    def terms(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """One term a channel, of its own numbers alone."""
        alpha, p, f0, f1, shadow, reach, steepness, onset = scalars
        one = torch.ones_like(alpha)
        found = shifted_gamma(pairs, one, alpha, p, one, f0, f1, shadow, reach, steepness, onset)
        return list(found.unbind(-1))

    @classmethod
    def terms_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> tuple[list[Tensor], Slopes]:
        """By the product rule; dt/dalpha = 2 - t / alpha, d log D/dt = -1 - p / t, d log D/dp = -log t."""
        alpha, p, f0, f1, shadow, reach, steepness, onset = scalars
        facets, raw = _lit_facets(pairs, alpha, p), _reflected(pairs, f0, f1)
        one, other = (_seen(pairs, *way, shadow, reach, steepness, onset) for way in _directions(pairs))
        lit = facets.value * raw.clamp_min(0)
        value, unreflected = lit * (one.value * other.value), facets.value * (one.value * other.value)
        unreflected = torch.where(raw > 0, unreflected, 0)
        of_one, of_other = (_seen_slopes(seen, shadow, reach, steepness) for seen in (one, other))
        slopes = [
            value * (-1 - p[..., None] / facets.shifted) * (2 - facets.shifted / alpha[..., None]),
            -value * facets.log_shifted,
            unreflected * (1 - schlick_weight(pairs))[..., None, :],
            -unreflected * pairs.cos_d[..., None, :],
            *(lit * (a * other.value + one.value * b) for a, b in zip(of_one, of_other, strict=True)),
        ]
        return list(value.unbind(-2)), [list(slope.unbind(-2)) for slope in slopes]

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """specular * K, each channel's for its own term."""
        return torch.diag_embed(parameters["specular"] * parameters["normalization"])
