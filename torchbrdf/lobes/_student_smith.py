"""Smith's shadowing of Student's t-distribution of slopes, G / (4 cos_i cos_o), and its derivatives.

With a = gamma - 1 and s = sigma sqrt(a), one slope alone has the density K s^(2a) (s^2 + p^2)^(-a - 1/2), where
K = Gamma(a + 1/2) / (sqrt(pi) Gamma(a)). For a direction let q^2 = cos^2 + s^2 sin^2 and c = s sin / q. Then

    cos (Lambda + 1/2) = q (x / 2 + K c^(2a) (1 / (2a - 1) - x H / (2a))),
    x = cos / q,  H = 2F1(2a, 1; a + 1; (1 - x) / 2),

and cos_i cos_o / G, with heights correlated, is the sum of cos_i times that of o and cos_o times that of i: nothing is
subtracted from its like. H is analytic in t = 2 x / (1 + x), with no other singularity nearby, and `DEGREE` + 1
Chebyshev coefficients give all its digits for every a up to 39; they depend on a alone, as power series of which all
terms are above 0.
"""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import clamp_cosine
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio

DEGREE = 19
# The least gamma: at 1.5 the mean slope, and with it the shadowing, is infinite.
LEAST = 1.501
# Terms of the power series, beyond which all are below 1e-17 of the sum.
_TERMS = 160


def _coefficients_of_powers(like: Tensor) -> Tensor:
    """Chebyshev coefficients in 2 t - 1 of (1 - x)^k, for each k: the cosine transform of its values at their nodes."""
    count = torch.arange(DEGREE + 1, dtype=like.dtype, device=like.device)
    angles = (count + 0.5) * (math.pi / (DEGREE + 1))
    nodes = (angles.cos() + 1) / 2
    powers = (1 - nodes / (2 - nodes))[:, None] ** torch.arange(_TERMS, dtype=like.dtype, device=like.device)
    transform = (angles[:, None] * count).cos() * (2 - (count == 0).to(like.dtype)) / (DEGREE + 1)
    return powers.mT @ transform


def student_visibility(pairs: Pairs, roughness: Tensor, exponent: Tensor) -> Tensor:
    """G / (4 cos_i cos_o)."""
    values = _coefficients(exponent)[0]
    cos_i, cos_o = clamp_cosine(pairs.cos_i), clamp_cosine(pairs.cos_o)
    masked_i = _masked(cos_i, roughness, exponent, values)
    masked_o = _masked(cos_o, roughness, exponent, values)
    return safe_ratio(0.25, cos_i * masked_o + cos_o * masked_i)


def student_visibility_and_log_derivatives(
    pairs: Pairs, roughness: Tensor, exponent: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The same, and the derivatives of its logarithm by sigma and by gamma."""
    cos_i, cos_o = clamp_cosine(pairs.cos_i), clamp_cosine(pairs.cos_o)
    both = _coefficients(exponent)
    of_i, of_o = (_masked_and_slopes(cosine, roughness, exponent, *both) for cosine in (cos_i, cos_o))
    total, by_roughness, by_exponent = (cos_i * o + cos_o * i for i, o in zip(of_i, of_o, strict=True))
    return safe_ratio(0.25, total), -by_roughness / total, -by_exponent / total


def _coefficients(exponent: Tensor) -> tuple[Tensor, Tensor]:
    """Chebyshev coefficients of H and of its derivative by a, `(..., DEGREE + 1)`.

    The coefficient of (1 - x)^k is (2a)_k / (2^k (a + 1)_k).
    """
    a = exponent.double() - 1
    k = torch.arange(_TERMS - 1, dtype=a.dtype, device=a.device)
    ratios, by_a = (a + k / 2) / (a + 1 + k), 1 / (a + k / 2) - 1 / (a + 1 + k)
    start = torch.zeros_like(a)
    powers = torch.cat([start, ratios.log().cumsum(-1)], -1).exp()
    matrix = _coefficients_of_powers(a)
    slopes = powers * torch.cat([start, by_a.cumsum(-1)], -1)
    return (powers @ matrix).to(exponent.dtype), (slopes @ matrix).to(exponent.dtype)


def _terms(cosine: Tensor, roughness: Tensor, a: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """q, x, log(c^2) and K c^(2a)."""
    scaled = roughness.square() * a * ((1 - cosine).clamp_min(0) * (1 + cosine))
    square = cosine.square() + scaled
    root = square.sqrt()
    # Along the normal c is 0, and so is its power.
    log_square = (scaled / square).clamp_min(torch.finfo(square.dtype).tiny).log()
    log_height = torch.lgamma(a + 0.5) - torch.lgamma(a) - 0.5 * math.log(math.pi)
    return root, cosine / root, log_square, (a * log_square + log_height).exp()


def _masked(cosine: Tensor, roughness: Tensor, exponent: Tensor, values: Tensor) -> Tensor:
    """cos (Lambda + 1/2)."""
    a = exponent - 1
    root, x, _, tail = _terms(cosine, roughness, a)
    return root * (x / 2 + tail * (1 / (2 * a - 1) - x * _series(values, x) / (2 * a)))


def _masked_and_slopes(
    cosine: Tensor, roughness: Tensor, exponent: Tensor, values: Tensor, slopes: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """cos (Lambda + 1/2), and its derivatives by sigma and by gamma.

    By sigma: q K c^(2a) / ((2a - 1) sigma), as the derivative by p of the mean slope beyond p is a share.
    """
    a = exponent - 1
    root, x, log_square, tail = _terms(cosine, roughness, a)
    height, by_a = x * _series(values, x) / (2 * a), x * _series(slopes, x) / (2 * a)
    rest = 1 / (2 * a - 1)
    by_scale = root * tail * rest
    growth = torch.digamma(a + 0.5) - torch.digamma(a) + log_square
    by_exponent = growth * (rest - height) - 2 * rest.square() - by_a + height / a
    value = root * (x / 2 + tail * (rest - height))
    return value, by_scale / roughness, root * tail * by_exponent + by_scale / (2 * a)


def _series(coefficients: Tensor, x: Tensor) -> Tensor:
    """The Chebyshev series in 2 t - 1 by Clenshaw's recurrence."""
    u = 4 * x / (1 + x) - 1
    twice = 2 * u
    last, before = torch.zeros_like(u), torch.zeros_like(u)
    for k in range(DEGREE, 0, -1):
        last, before = torch.addcmul(coefficients[..., k : k + 1] - before, twice, last), last
    return torch.addcmul(coefficients[..., :1] - before, u, last)
