"""Disney's principled material as Mitsuba 3 has it, without transmission and anisotropy."""

import math
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import tangent
from torchbrdf.lobes._sloped import LayeredMaterial, Value, chain, facets, fresnel_of, number, root
from torchbrdf.lobes._smith import ggx_separable_visibility_and_log_derivative
from torchbrdf.lobes.base import LOBES
from torchbrdf.lobes.evaluation import half_in_float32
from torchbrdf.lobes.fresnel import fresnel, schlick_weight
from torchbrdf.lobes.parameter import BoundedParameter, share
from torchbrdf.lobes.separable import columns, value_of
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio

# Rec. 709, as in Mitsuba.
_LUMINANCE = (0.212671, 0.715160, 0.072169)
# The clear coat's shadowing has a width of its own.
_COAT_SHADOW = 0.25


@half_in_float32
def principled(
    pairs: Pairs,
    base_color: Tensor,
    metallic: Tensor,
    roughness: Tensor,
    specular: Tensor,
    spec_tint: Tensor,
    sheen: Tensor,
    sheen_tint: Tensor,
    clearcoat: Tensor,
    clearcoat_gloss: Tensor,
    flatness: Tensor,
) -> Tensor:
    """Disney's principled material as Mitsuba 3's `principled`, opaque and isotropic.

    With m metallic, t spec_tint, c the base colour and c' that colour by its luminance it is
    (1 - m) (c diffuse + sheen c'' (1 - cos_d)^5) + D G F / (4 cos_i cos_o) + clearcoat / 4 Fc Dc Gc, with
    c'' = 1 + sheen_tint (c' - 1) and F = (1 - m) (1 - t) Fresnel(eta) + m Schlick(c) + (1 - m) t Schlick(c' F0), F0 =
    ((eta - 1) / (eta + 1))^2.
    D is that of `ggx` with a = roughness^2, G Smith's of uncorrelated heights, eta = 2 / (1 - sqrt(0.08 specular)) - 1;
    Dc is `gtr` of exponent 1 with a from 0.1 to 0.001, Gc Smith's with a = 0.25, Fc Schlick's with 0.04. The diffuse
    reflection is Burley's with its retro-reflection, blended to that of Hanrahan and Krueger by flatness.

    Args:
        pairs: where values are wanted, `(..., N)`.
        base_color: c `(..., 3)`.
        metallic: m `(..., 1)`.
        roughness: the square root of a, which is at least 0.001 `(..., 1)`.
        specular: 0.5 is an index of refraction of 1.5 `(..., 1)`.
        spec_tint: t `(..., 1)`.
        sheen: its strength `(..., 1)`.
        sheen_tint: how much of c' it has `(..., 1)`.
        clearcoat: its strength `(..., 1)`.
        clearcoat_gloss: 1 is the sharpest `(..., 1)`.
        flatness: share of the flat diffuse reflection `(..., 1)`.

    Returns:
        Values in 1/sr, `(..., N, 3)`, zero below the horizon.

    Source: B. Burley, Physically Based Shading at Disney, 2012, and Extending the Disney BRDF to a BSDF with Integrated
    Subsurface Scattering, 2015 (SIGGRAPH courses); W. Jakob et al., Mitsuba 3, 2022, https://mitsuba-renderer.org.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import principled
        >>> angle, colour = torch.full((1,), 0.2), torch.tensor([0.1, 0.2, 0.3])
        >>> pairs, half = Pairs.from_half_diff(angle, angle, angle), torch.tensor([0.5])
        >>> principled(pairs, colour, *[half] * 9)
        tensor([[0.0550, 0.0983, 0.1415]])
    """
    values = (metallic, roughness, specular, spec_tint, sheen, sheen_tint, clearcoat, clearcoat_gloss, flatness)
    return value_of(Principled)(pairs, base_color, *values)


def _tint(base: Tensor) -> Tensor:
    """A colour by its luminance; white of black."""
    luminance = (base * base.new_tensor(_LUMINANCE)).sum(-1, keepdim=True)
    dark = luminance <= 0
    return torch.where(dark, 1, base / torch.where(dark, 1, luminance))


def _eta(specular: Value) -> Value:
    """The index of refraction."""
    return 2 / (1 - root(0.08 * specular)) - 1


def _diffuse(pairs: Pairs, roughness: Value, flatness: Value) -> Value:
    """Burley's diffuse reflection and its retro-reflection, blended to Hanrahan and Krueger's.

    With s and p the sum and the product of both directions' (1 - cos)^5, and q = roughness cos_d^2, they are, but for
    1 / pi, 1 - s / 2 + p / 4 + 2 q (s - p + 2 p q) and
    1.25 ((1 + (q - 1) s + (q - 1)^2 p) (1 / (cos_i + cos_o) - 1/2) + 1/2).
    """
    total, product = pairs.cached(_sum, partial(_sum, pairs)), pairs.cached(_product, partial(_product, pairs))
    q, lift = roughness * pairs.cos_d.square(), pairs.cached(_lift, partial(_lift, pairs))
    rough = 2 * q * (2 * product * q + (total - product)) + (1 - total / 2 + product / 4)
    less = q - 1
    flat = 1.25 * (less * (less * product + total) + 1) * lift + 0.625
    return (rough + flatness * (flat - rough)) * (1 / math.pi)


def _fifths(pairs: Pairs) -> tuple[Tensor, Tensor]:
    rests = [1 - cosine.clamp(0, 1) for cosine in (pairs.cos_i, pairs.cos_o)]
    first, second = (rest.square().square() * rest for rest in rests)
    return first, second


def _sum(pairs: Pairs) -> Tensor:
    first, second = _fifths(pairs)
    return first + second


def _product(pairs: Pairs) -> Tensor:
    first, second = _fifths(pairs)
    return first * second


def _lift(pairs: Pairs) -> Tensor:
    return safe_ratio(1, pairs.cos_i.clamp(0, 1) + pairs.cos_o.clamp(0, 1)) - 0.5


def _clearcoat(pairs: Pairs, gloss: Value) -> Value:
    """Of the width w the distribution is (1 + tan2_h) / (w^2 + tan2_h) (w^2 - 1) / (pi log(w^2))."""
    width = 0.1 - 0.099 * number(gloss)
    square, tan2 = width.square(), tangent(pairs)
    log = square.log()
    value = pairs.cached(_coat, partial(_coat, pairs)) / (square + tan2) * ((square - 1) / log)
    return chain(
        gloss, value, lambda: value * (1 / (square - 1) - 1 / (square * log) - 1 / (square + tan2)) * (-0.198 * width)
    )


def _coat(pairs: Pairs) -> Tensor:
    """What of the clear coat depends on pairs alone. Mitsuba's has no 1 / (4 cos_i cos_o), but G."""
    visibility, _ = ggx_separable_visibility_and_log_derivative(pairs, pairs.cos_d.new_tensor(_COAT_SHADOW))
    masked = visibility * (pairs.cos_i * pairs.cos_o) * (1 + tangent(pairs))
    return masked * fresnel(pairs.cos_d.new_tensor(0.04), pairs) / math.pi


@LOBES.register("principled")
class Principled(LayeredMaterial):
    """Disney's principled material as Mitsuba 3's `principled`, a whole material, opaque and isotropic.

    Left out: `anisotropic` and `spec_trans`, which are 0.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: the parameters declared below, each a number or what broadcasts to its shape; its start if not given.

    Example:
        >>> from torchbrdf.lobes import Principled
        >>> Principled(base_color=[0.8, 0.1, 0.1], metallic=0).metallic.item()
        0.0
    """

    base_color: BoundedParameter = BoundedParameter(
        start=0.5, lower=0.0, upper=1.0, shape=(3,), doc="colour of diffuse reflection and of a metal, per channel"
    )
    metallic: BoundedParameter = share(0.5, "share of metal")
    roughness: BoundedParameter = BoundedParameter(
        start=0.3, lower=0.032, upper=1.0, log=True, doc="the square root of alpha"
    )
    # At 0 Mitsuba takes 0.001 as well.
    specular: BoundedParameter = BoundedParameter(
        start=0.5, lower=0.001, upper=1.0, doc="12.5 times the reflectance at normal incidence"
    )
    spec_tint: BoundedParameter = share(0.0, "share of specular reflection in the base colour")
    sheen: BoundedParameter = share(0.05, "strength of the sheen")
    sheen_tint: BoundedParameter = share(0.0, "share of the sheen in the base colour")
    clearcoat: BoundedParameter = share(0.1, "strength of the clear coat")
    clearcoat_gloss: BoundedParameter = share(0.5, "how sharp the clear coat is")
    flatness: BoundedParameter = share(0.0, "share of flat diffuse reflection")
    function = staticmethod(principled)
    scalars_of_terms: ClassVar[tuple[str, ...]] = ("roughness", "specular", "clearcoat_gloss", "flatness")

    @classmethod
    def layers(cls, pairs: Pairs, *scalars: Any) -> list[Any]:
        """Diffuse reflection, sheen, Fresnel's specular reflection, Schlick's two terms, clear coat."""
        roughness, specular, gloss, flatness = scalars
        alpha, fifth = (roughness**2).clamp(0.001, math.inf), schlick_weight(pairs)
        main = facets(pairs, alpha, ggx_separable_visibility_and_log_derivative)
        return [
            _diffuse(pairs, roughness, flatness),
            fifth,
            main * fresnel_of(pairs, _eta(specular)),
            main,
            main * fifth,
            _clearcoat(pairs, gloss),
        ]

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """Of the terms in their order; Schlick's have what metal and tint add up to."""
        base, metallic, tinted = parameters["base_color"], parameters["metallic"], parameters["spec_tint"]
        tint, rest = _tint(base), 1 - metallic
        eta, sheen_tint = _eta(parameters["specular"]), parameters["sheen_tint"]
        f0 = tint * ((eta - 1) / (eta + 1)).square()
        return columns(
            rest * base,
            rest * parameters["sheen"] * (1 - sheen_tint + sheen_tint * tint),
            rest * (1 - tinted),
            metallic * base + rest * tinted * f0,
            metallic * (1 - base) + rest * tinted * (1 - f0),
            parameters["clearcoat"],
        )
