"""Smith's shadowing and masking, G / (4 cos_i cos_o), and its derivatives by the roughness.

G = 1 / (1 + Lambda(wi) + Lambda(wo)) with correlated heights, which most renderers have, and
1 / ((1 + Lambda(wi)) (1 + Lambda(wo))) without, which Mitsuba has. Source: E. Heitz, Understanding the
Masking-Shadowing Function in Microfacet-Based BRDFs, 2014, JCGT 3(2), eq. 98, 99 and its table of Lambda.
"""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import clamp_cosine
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_ratio


def ggx_visibility(pairs: Pairs, roughness: Tensor) -> Tensor:
    """G / (4 cos_i cos_o) of the GGX distribution: 1 / (2 (cos_o s_i + cos_i s_o)), s^2 = a^2 + (1 - a^2) cos^2."""
    cos_i, cos_o, s_i, s_o = _ggx_terms(pairs, roughness)
    return safe_ratio(0.5, cos_o * s_i + cos_i * s_o)


def ggx_visibility_and_log_derivative(pairs: Pairs, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """The same, and the derivative of its logarithm by a.

    That is -a (cos_o sin_i^2 / s_i + cos_i sin_o^2 / s_o) / (cos_o s_i + cos_i s_o).
    """
    cos_i, cos_o, s_i, s_o = _ggx_terms(pairs, roughness)
    total = cos_o * s_i + cos_i * s_o
    slope = cos_o * (1 - cos_i.square()) / s_i + cos_i * (1 - cos_o.square()) / s_o
    return safe_ratio(0.5, total), slope * -roughness / total


def ggx_separable_visibility_and_log_derivative(pairs: Pairs, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """G / (4 cos_i cos_o) of GGX with uncorrelated heights, 1 / ((cos_i + s_i) (cos_o + s_o)).

    And the derivative of its logarithm by a, -a (sin_i^2 / (s_i (cos_i + s_i)) + sin_o^2 / (s_o (cos_o + s_o))).
    """
    cos_i, cos_o, s_i, s_o = _ggx_terms(pairs, roughness)
    sum_i, sum_o = cos_i + s_i, cos_o + s_o
    slope = (1 - cos_i.square()) / (s_i * sum_i) + (1 - cos_o.square()) / (s_o * sum_o)
    return (sum_i * sum_o).reciprocal(), slope * -roughness


def _ggx_terms(pairs: Pairs, roughness: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Cosines, and s = sqrt(a^2 + (1 - a^2) cos^2), whose smallest value is the smallest a."""
    cos_i, cos_o = clamp_cosine(pairs.cos_i), clamp_cosine(pairs.cos_o)
    square = roughness.square()
    rest = 1 - square
    return cos_i, cos_o, (square + rest * cos_i.square()).sqrt(), (square + rest * cos_o.square()).sqrt()


def beckmann_visibility_and_log_derivative(pairs: Pairs, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """G / (4 cos_i cos_o) of Beckmann's distribution, and the derivative of its logarithm by m.

    That is 1 / (4 (cos_i cos_o + cos_i l_o + cos_o l_i)), l = cos Lambda, 2 Lambda = exp(-v^2) / (v sqrt(pi)) -
    erfc(v), v = cos / (m sin); the derivative of l is sin exp(-v^2) / (2 sqrt(pi)).
    """
    cos_i, cos_o = clamp_cosine(pairs.cos_i), clamp_cosine(pairs.cos_o)
    masked_i, slope_i = _beckmann_masked(cos_i, roughness)
    masked_o, slope_o = _beckmann_masked(cos_o, roughness)
    total = cos_i * cos_o + cos_i * masked_o + cos_o * masked_i
    return safe_ratio(0.25, total), -(cos_i * slope_o + cos_o * slope_i) / total


def _beckmann_masked(cosine: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """cos Lambda, which is finite at grazing directions, and 0 for those along the normal; its derivative by m."""
    # Where the sine is 0 so is everything; a small one keeps quotient and gradient finite. Beyond v = 9 exp(-v^2) and
    # erfc(v) are nothing.
    sine = (1 - cosine.square()).clamp_min(1e-12).sqrt()
    v = (cosine / (roughness * sine)).clamp_max(9)
    tail = (-v.square()).exp() * sine
    masked = 0.5 * (tail * (roughness / math.sqrt(math.pi)) - cosine * torch.special.erfc(v))
    return masked, tail / (2 * math.sqrt(math.pi))
