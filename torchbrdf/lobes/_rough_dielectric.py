"""What a rough dielectric surface lets through, one way and the other, by quadrature over its facets.

Mitsuba 3 keeps the share of light that enters at `COSINES` cosines of the incident direction and interpolates between
them, and takes the mean over them for the share that is thrown back from inside. Both are parts of its material, and so
they are here; the shares themselves are more exact than Mitsuba's own.

They are sums over the facets of GGX that light at an angle t from the normal sees, whose normals m have a cosine c to
it: of 1 - F(c) times the masking G1 of the refracted direction, or of F(c) times that of the reflected one. In angles
theta and phi of m about the normal of the surface these are smooth in rings of theta on either side of an angle, below
which phi goes all around; from there phi has a largest value, where the facet turns away from the light (pi / 2 - t),
or where what it reflects ends at the horizon (pi / 4 - t / 2). Around the normal the distribution changes over a width
a, far from it over a width of 1: nodes lie evenly in asinh(d / a) with tan(d) = a / tan(theta). What leaves the inside
ends at the critical angle, which gives other rings.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchbrdf.lobes._sloped import Mixed, Value, chain, larger, linear, number, of_several, smaller

COSINES = 64
"""How many cosines Mitsuba has, from 0 to 1."""
# The first of them, in the place of 0.
_LEAST = 1e-6
# Keeps roots and quotients finite.
_NONE = 1e-12


def _gauss(count: int) -> tuple[list[float], list[float]]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes.tolist(), weights.tolist()


# Numbers of Python, which torch.compile takes for constants: of rings without and with a largest phi, and of phi.
_WHOLE_RINGS, _CUT_RINGS, _WHOLE_TURN = _gauss(10), _gauss(12), 6
# Half of a rule for what is even in phi.
_CUT_TURN = [half[6:] for half in _gauss(12)]


class _Facets(NamedTuple):
    """Facets that light sees, `(..., cosines, rings, turns)`: tensors, or all of them `Sloped`.

    cosine: of light and facet; normal: of facet and surface; weight: their share of the light.
    """

    cosine: Mixed
    normal: Mixed
    weight: Mixed


def transmittances(roughness: Value, ior: Value) -> tuple[Value, Value]:
    """Shares of light that a rough dielectric lets in, and lets out.

    Args:
        roughness: a of GGX `(..., 1)`.
        ior: index of refraction of the inside by that of the outside, above 1 `(..., 1)`.

    Returns:
        In, at each cosine, `(..., COSINES)`; and out, of diffuse light, `(..., 1)`.
    """
    like = number(roughness)
    mu = torch.linspace(0, 1, COSINES, dtype=like.dtype, device=like.device).clamp_min(_LEAST)[:, None]
    a, n = _deeper(roughness), _deeper(ior)
    out = linear(_leaving(mu, a, n), lambda one: 2 * (one * mu[:, 0]).mean(-1, keepdim=True))
    return _entering(mu, a, n), out


def _entering(mu: Tensor, a: Mixed, n: Mixed) -> Mixed:
    angle = torch.atan2(_sine(mu), mu)
    turned, last = math.pi / 2 - angle, torch.full_like(angle, math.pi / 2)
    whole, cut = _whole(mu, a, 0 * angle, turned), _cut(mu, a, turned, last, lambda normal: 0 * normal)
    return _entered(whole, mu, a, n) + _entered(cut, mu, a, n)


def _entered(facets: _Facets, mu: Tensor, a: Mixed, n: Mixed) -> Mixed:
    index = _deeper(n)
    refracted = _root(1 - (1 - facets.cosine**2) * index**-2)
    depth = (refracted - facets.cosine / index) * facets.normal + mu[..., None] / index
    return _sum(facets.weight * _through(index, facets.cosine, refracted) * _masking(a, depth))


def _leaving(mu: Tensor, a: Mixed, n: Mixed) -> Mixed:
    """1 less what is reflected: all beyond the critical angle, and as much as from outside where it is refracted to."""
    angle = torch.atan2(_sine(mu), mu)
    none, first, last = 0 * angle, math.pi / 4 - angle / 2, math.pi / 4 + angle / 2
    critical = _root(1 - n**-2)
    limit = _arc(critical)
    farthest = smaller(limit + angle, last)
    near = smaller((limit - angle).clamp(0, math.pi), first)
    start = smaller(larger(near, angle - limit), farthest)

    def horizon(normal: Mixed) -> Mixed:
        return mu / (2 * normal)

    def end(normal: Mixed) -> Mixed:
        return larger(horizon(normal), critical)

    back = [_whole(mu, a, none, first), _cut(mu, a, first, last, horizon)]
    out = [_whole(mu, a, none, near), _cut(mu, a, start, farthest, end)]
    lost = _sum(_thrown(back[0], mu, a)) + _sum(_thrown(back[1], mu, a))
    return 1 - lost + _left(out[0], mu, a, n) + _left(out[1], mu, a, n)


def _thrown(facets: _Facets, mu: Tensor, a: Mixed) -> Mixed:
    """What would be reflected, if all were."""
    height = 2 * facets.cosine * facets.normal - mu[..., None]
    return facets.weight * _masking(a, height.clamp(0, 1))


def _left(facets: _Facets, mu: Tensor, a: Mixed, n: Mixed) -> Mixed:
    index = _deeper(n)
    refracted = _root(1 - (1 - facets.cosine**2) * index**2)
    return _sum(_thrown(facets, mu, a) * _through(index, refracted, facets.cosine))


def _through(n: Mixed, outside: Mixed, inside: Mixed) -> Mixed:
    """1 - F, by the cosines of a ray on both sides of a facet."""
    return 2 * n * outside * inside * ((outside + n * inside) ** -2 + (n * outside + inside) ** -2)


def _masking(a: Mixed, cosine: Mixed) -> Mixed:
    """G1 of a direction above its horizon."""
    square = _deeper(a) ** 2
    return 2 * cosine / (cosine + _root(square + (1 - square) * cosine**2))


def _whole(mu: Tensor, a: Mixed, low: Mixed, high: Mixed) -> _Facets:
    """Rings between two angles from the normal, all around."""
    nodes, weights = (mu.new_tensor(one) for one in _WHOLE_RINGS)
    turns = (torch.arange(_WHOLE_TURN, dtype=mu.dtype, device=mu.device) + 0.5) * (math.pi / _WHOLE_TURN)
    cos, sin, weight = _rings(a, low, high, (nodes + 1) / 2, weights / 2)
    return _around(mu, a, cos, sin, _deeper(weight) * (1 / _WHOLE_TURN), turns.cos())


def _cut(mu: Tensor, a: Mixed, low: Mixed, high: Mixed, least: Callable[[Mixed], Mixed]) -> _Facets:
    """Rings between two angles from the normal, as far as c is above `least`, which depends on the angle's cosine."""
    nodes, weights = (mu.new_tensor(one) for one in _CUT_RINGS)
    turns, parts = (mu.new_tensor(one) for one in _CUT_TURN)
    # The largest phi grows as a root from either end.
    x = (nodes + 1) / 2
    cos, sin, weight = _rings(a, low, high, x.square() * (3 - 2 * x), 3 * x * (1 - x) * weights)
    room = 4 * torch.finfo(mu.dtype).eps
    largest = (least(cos) - mu * cos) / (_sine(mu).clamp_min(_NONE) * sin)
    largest = _deeper(_arc(largest.clamp(-1 + room, 1 - room)))
    # There what leaves ends as a root.
    turn = largest * (turns * (3 - turns.square()) / 2)
    part = largest * (parts * (1 - turns.square()) * (1.5 / math.pi))
    return _around(mu, a, cos, sin, _deeper(weight) * part, _cos(turn))


def _rings(a: Mixed, low: Mixed, high: Mixed, x: Tensor, weight: Tensor) -> tuple[Mixed, Mixed, Mixed]:
    """Cosines and sines of angles from the normal, and the area of facets there as it is seen from the normal."""
    begin, end = _place(a, high), _place(a, low)
    length = end - begin
    place = begin + length * x
    d, width = a * _sinh(place), a * _cosh(place)
    cos, leaning = _sin(d), _cos(d)
    sin = a * leaning
    stretch = _root(cos**2 + sin**2)
    # D cos dw is 2 sin cos of d, by dd.
    area = 2 * cos * leaning * width * length * weight
    return cos / stretch, sin / stretch, area


def _place(a: Mixed, angle: Mixed) -> Mixed:
    """asinh(d / a)."""
    alpha, theta = number(a), number(angle)
    cos, sin = theta.cos(), theta.sin()
    square = (alpha * cos).square() + sin.square()
    d = of_several(torch.atan2(alpha * cos, sin), (a, lambda: cos * sin / square), (angle, lambda: -alpha / square))
    ratio = d / a
    value = number(ratio)
    return chain(ratio, value.asinh(), lambda: (1 + value.square()).rsqrt())


def _around(mu: Tensor, a: Mixed, cos: Mixed, sin: Mixed, weight: Mixed, cos_turn: Mixed) -> _Facets:
    """Of rings, by the cosine of phi."""
    cosine = (_deeper(_sine(mu) * sin) * cos_turn + _deeper(mu * cos)).clamp(0, 1)
    square = a**2
    seen = 2 / ((mu + _root(square + (1 - square) * mu.square())) * cos)
    return _Facets(cosine, _deeper(cos), weight * _deeper(seen) * cosine)


def _deeper(x: Mixed) -> Mixed:
    return linear(x, lambda one: one[..., None])


def _sum(x: Mixed) -> Mixed:
    return linear(x, lambda one: one.sum((-2, -1)))


def _sine(cosine: Tensor) -> Tensor:
    return ((1 - cosine) * (1 + cosine)).sqrt()


def _root(x: Mixed) -> Mixed:
    value = number(x).clamp_min(_NONE).sqrt()
    return chain(x, value, lambda: torch.where(number(x) > _NONE, 0.5 / value, 0))


def _arc(x: Mixed) -> Mixed:
    value = number(x)
    return chain(x, value.acos(), lambda: -(1 - value.square()).rsqrt())


def _sin(x: Mixed) -> Mixed:
    return chain(x, number(x).sin(), number(x).cos)


def _cos(x: Mixed) -> Mixed:
    return chain(x, number(x).cos(), lambda: -number(x).sin())


def _sinh(x: Mixed) -> Mixed:
    return chain(x, number(x).sinh(), number(x).cosh)


def _cosh(x: Mixed) -> Mixed:
    return chain(x, number(x).cosh(), number(x).sinh)
