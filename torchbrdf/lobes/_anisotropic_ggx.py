"""Distribution and shadowing of GGX with a grain, and the derivatives of their logarithms.

Source: B. Burley, Physically-Based Shading at Disney, 2012 (SIGGRAPH course), eq. 13; E. Heitz, Understanding the
Masking-Shadowing Function in Microfacet-Based BRDFs, 2014, JCGT 3(2), eq. 85 to 87, 98 and 99.
"""

import math
from typing import NamedTuple

from torch import Tensor

from torchbrdf.lobes._anisotropic import half_slopes, in_the_grain
from torchbrdf.lobes._microfacet import clamp_cosine, tangent
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio


class Part(NamedTuple):
    """A factor of a lobe, `(..., N)`, and the derivatives of its logarithm by a_x, a_y and the rotation."""

    value: Tensor
    by_x: Tensor
    by_y: Tensor
    by_turn: Tensor


def distribution(pairs: Pairs, a_x: Tensor, a_y: Tensor, rotation: Tensor) -> Part:
    """D = ((1 + tan2_h) / q)^2 / (pi a_x a_y), with q = 1 + u^2 / a_x^2 + v^2 / a_y^2 of the half vector's slopes."""
    u, v = half_slopes(pairs, rotation)
    x2, y2 = (u / a_x).square(), (v / a_y).square()
    q = 1 + x2 + y2
    apart = a_y.square().reciprocal() - a_x.square().reciprocal()
    return Part(
        ((1 + tangent(pairs)) / q).square() / (math.pi * a_x * a_y),
        (4 * x2 / q - 1) / a_x,
        (4 * y2 / q - 1) / a_y,
        4 * u * v / q * apart,
    )


class _Direction(NamedTuple):
    """Of one direction its cosine and s = sqrt(z^2 + a_x^2 x^2 + a_y^2 y^2), with the derivatives of s."""

    cosine: Tensor
    s: Tensor
    by_x: Tensor
    by_y: Tensor
    by_turn: Tensor


def _directions(pairs: Pairs, a_x: Tensor, a_y: Tensor, rotation: Tensor) -> list[_Direction]:
    square_x, square_y = a_x.square(), a_y.square()
    found = []
    for cosine, vector in ((pairs.cos_i, pairs.wi), (pairs.cos_o, pairs.wo)):
        z = clamp_cosine(cosine)
        x, y = in_the_grain(vector[..., 0], vector[..., 1], rotation)
        s = (z.square() + square_x * x.square() + square_y * y.square()).sqrt()
        slopes = (a_x * x.square() / s, a_y * y.square() / s, (square_x - square_y) * x * y / s)
        found.append(_Direction(z, s, *slopes))
    return found


def visibility(pairs: Pairs, a_x: Tensor, a_y: Tensor, rotation: Tensor) -> Part:
    """G / (4 cos_i cos_o) = 1 / (2 (cos_o s_i + cos_i s_o)), heights correlated."""
    light, viewer = _directions(pairs, a_x, a_y, rotation)
    total = viewer.cosine * light.s + light.cosine * viewer.s
    own, other = -viewer.cosine / total, -light.cosine / total
    by_x, by_y, by_turn = (own * one + other * two for one, two in zip(light[2:], viewer[2:], strict=True))
    return Part(safe_ratio(0.5, total), by_x, by_y, by_turn)


def separable_visibility(pairs: Pairs, a_x: Tensor, a_y: Tensor, rotation: Tensor) -> Part:
    """The same with heights uncorrelated, 1 / ((cos_i + s_i) (cos_o + s_o))."""
    light, viewer = _directions(pairs, a_x, a_y, rotation)
    one, two = light.cosine + light.s, viewer.cosine + viewer.s
    by_x, by_y, by_turn = (-a / one - b / two for a, b in zip(light[2:], viewer[2:], strict=True))
    return Part(safe_ratio(1, one * two), by_x, by_y, by_turn)


def facets(density: Part, seen: Part) -> Part:
    """D G / (4 cos_i cos_o)."""
    slopes = (one + two for one, two in zip(density[1:], seen[1:], strict=True))
    return Part(density.value * seen.value, *slopes)
