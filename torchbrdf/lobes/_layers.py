"""What lies on other layers: how much light they leave to what is below them, by fits to their albedos.

A renderer scales what is below a layer by 1 - E(cos_o), of the viewer alone, by which light and viewer cannot be
exchanged, which all of torchbrdf (and glTF's specification) takes for granted. Here the lower of both directions
counts as the viewer, as in glTF's sheen. So materials are reciprocal, and where the light is the higher one, values are
the renderers' own.
"""

import math

import torch
from torch import Tensor

from torchbrdf.pairs import Pairs


def lower_cosine(pairs: Pairs) -> Tensor:
    """The cosine of the lower direction, `(..., N)`, from 0 to 1."""
    return pairs.cached(lower_cosine, lambda: torch.minimum(pairs.cos_i, pairs.cos_o).clamp(0, 1))


def higher_cosine(pairs: Pairs) -> Tensor:
    """The cosine of the higher direction, `(..., N)`, from 0 to 1."""
    return pairs.cached(higher_cosine, lambda: torch.maximum(pairs.cos_i, pairs.cos_o).clamp(0, 1))


def ggx_albedo(cosine: Tensor, alpha: Tensor, f0: Tensor) -> Tensor:
    """Share of light that a GGX lobe with Schlick's Fresnel reflects; heights correlated.

    Source: the rational fit to a Monte Carlo integration in MaterialX 1.39, https://materialx.org.
    """
    x, y = cosine, alpha
    x2, y2, xy = x * x, y * y, x * y
    square = x2 * y2
    a = 0.1003 - 0.6303 * x + 9.748 * y - 2.038 * xy + 29.34 * x2 - 8.245 * y2
    a = a - 26.44 * x2 * y + 19.99 * x * y2 - 5.448 * square
    b = 0.9345 - 2.323 * x + 2.229 * y - 3.748 * xy + 1.424 * x2 - 0.7684 * y2
    b = b + 1.436 * x2 * y + 0.2913 * x * y2 + 0.6286 * square
    below_a = 1 - 1.765 * x + 8.263 * y + 11.53 * xy + 28.96 * x2 - 7.507 * y2
    below_a = below_a - 36.11 * x2 * y + 15.86 * x * y2 + 33.37 * square
    below_b = 1 + 0.2281 * x + 15.94 * y - 55.83 * xy + 13.08 * x2 + 41.26 * y2
    below_b = below_b + 54.9 * x2 * y + 300.2 * x * y2 - 285.1 * square
    return f0 * (a / below_a).clamp(0, 1) + (b / below_b).clamp(0, 1)


def charlie_albedo(cosine: Tensor, alpha: Tensor) -> Tensor:
    """Share of light that the sheen `charlie` reflects.

    Source: the rational fit to a Monte Carlo integration in MaterialX 1.39, https://materialx.org.
    """
    x, y = cosine, alpha
    above = 13.673 - 68.78018 * x + 799.08825 * y - 905.00061 * x * y + 60.28956 * x * x + 1086.96473 * y * y
    below = 1 + 61.57746 * x + 442.78211 * y + 2597.49308 * x * y + 121.81241 * x * x + 3045.55075 * y * y
    return (above / below).clamp(0, 1)


def fuzz_albedo(cosine: Tensor, roughness: Tensor) -> Tensor:
    """Share of light that `fuzz` reflects.

    Source: as that; the fit is that of MaterialX 1.39, https://materialx.org.
    """
    y = roughness
    width = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y))
    middle = y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y * y))) / (0.046391 + y)
    least = y * (0.000654023 + y * (-0.0207818 + 0.119681 * y)) / (1.26264 + y * (-1.92021 + y))
    away = ((cosine - middle) / width).square()
    return (-0.5 * away.clamp_max(150)).exp() / (width * math.sqrt(2 * math.pi)) + least


def fuzz(pairs: Pairs, roughness: Tensor) -> Tensor:
    """Light that fibres scatter: a cosine that is transformed linearly, times `fuzz_albedo`, the viewer the lower one.

    Source: T. Zeltner, B. Burley and M. J.-Y. Chiang, Practical Multiple-Scattering Sheen Using Linearly Transformed
    Cosines, 2022, doi:10.1145/3532836.3536240; its matrix in the rational fit of MaterialX 1.39.
    """
    x, light, y = lower_cosine(pairs), higher_cosine(pairs), roughness
    a = (2.58126 * x + 0.813703 * y) * y / (1 + 0.310327 * x * x + 2.60994 * x * y)
    # b is sqrt(1 - x) times this; the light's tangent along the viewer's is slant / sin, sin = sqrt(1 - x^2).
    b = (y - 1) * y**3 / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y)
    slant = 2 * pairs.cos_d.square() - 1 - pairs.cos_i * pairs.cos_o
    square, height = a * a, light * light
    length = square * (1 - height) + 2 * a * b * slant * light / (1 + x).sqrt() + (b * b * (1 - x) + 1) * height
    return fuzz_albedo(x, y) / math.pi * (a / length).square()
