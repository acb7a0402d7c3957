"""What lies on other layers: how much light they leave to what is below them, by fits to their albedos.

A renderer scales what is below a layer by 1 - E(cos_o), of the viewer alone, by which light and viewer cannot be
exchanged, which all of torchbrdf (and glTF's specification) takes for granted. Here the lower of both directions
counts as the viewer, as in glTF's sheen. So materials are reciprocal, and where the light is the higher one, values are
the renderers' own.
"""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._sloped import Value
from torchbrdf.pairs import Pairs

Table = tuple[tuple[float, float, float], ...]


def lower_cosine(pairs: Pairs) -> Tensor:
    """The cosine of the lower direction, `(..., N)`, from 0 to 1."""
    return pairs.cached(lower_cosine, lambda: torch.minimum(pairs.cos_i, pairs.cos_o).clamp(0, 1))


def higher_cosine(pairs: Pairs) -> Tensor:
    """The cosine of the higher direction, `(..., N)`, from 0 to 1."""
    return pairs.cached(higher_cosine, lambda: torch.maximum(pairs.cos_i, pairs.cos_o).clamp(0, 1))


def ggx_albedo(cosine: Tensor, alpha: Value, f0: Value) -> Value:
    """Share of light that a GGX lobe with Schlick's Fresnel reflects; heights correlated.

    Source: the rational fit to a Monte Carlo integration in MaterialX 1.39, https://materialx.org.
    """
    above = (0.1003, -0.6303, 29.34), (9.748, -2.038, -26.44), (-8.245, 19.99, -5.448)
    below = (1.0, -1.765, 28.96), (8.263, 11.53, -36.11), (-7.507, 15.86, 33.37)
    normal = _ratio(cosine, alpha, above, below)
    above = (0.9345, -2.323, 1.424), (2.229, -3.748, 1.436), (-0.7684, 0.2913, 0.6286)
    below = (1.0, 0.2281, 13.08), (15.94, -55.83, 54.9), (41.26, 300.2, -285.1)
    return normal * f0 + _ratio(cosine, alpha, above, below)


def charlie_albedo(cosine: Tensor, alpha: Value) -> Value:
    """Share of light that the sheen `charlie` reflects.

    Source: the rational fit to a Monte Carlo integration in MaterialX 1.39, https://materialx.org.
    """
    above = (13.673, -68.78018, 60.28956), (799.08825, -905.00061, 0.0), (1086.96473, 0.0, 0.0)
    below = (1.0, 61.57746, 121.81241), (442.78211, 2597.49308, 0.0), (3045.55075, 0.0, 0.0)
    return _ratio(cosine, alpha, above, below)


def _ratio(x: Tensor, y: Value, above: Table, below: Table) -> Value:
    """Of two polynomials, within 0 and 1; a table has a row for each power of y, in which each is by powers of x."""
    return (_polynomial(x, y, above) / _polynomial(x, y, below)).clamp(0, 1)


def _polynomial(x: Tensor, y: Value, table: Table) -> Value:
    # The powers of y first, which are one number a material.
    first, second, third = (y * (y * high + middle) + low for low, middle, high in zip(*table, strict=True))
    return first + x * (second + x * third)


def fuzz_albedo(cosine: Tensor, y: Value) -> Value:
    """Share of light that `fuzz` of the roughness y reflects, by the fit of MaterialX 1.39, https://materialx.org."""
    width = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y))
    middle = y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y * y))) / (0.046391 + y)
    least = y * (0.000654023 + y * (-0.0207818 + 0.119681 * y)) / (1.26264 + y * (-1.92021 + y))
    away = ((cosine - middle) / width) ** 2
    # Beyond 150 it is nothing.
    return (away.clamp(0, 150) * -0.5).exp() / (width * math.sqrt(2 * math.pi)) + least


def fuzz(pairs: Pairs, y: Value) -> Value:
    """Light that fibres scatter: a cosine that is transformed linearly, times `fuzz_albedo`, the viewer the lower one.

    Source: T. Zeltner, B. Burley and M. J.-Y. Chiang, Practical Multiple-Scattering Sheen Using Linearly Transformed
    Cosines, 2022, doi:10.1145/3532836.3536240; its matrix in the rational fit of MaterialX 1.39.
    """
    x, light = lower_cosine(pairs), higher_cosine(pairs)
    a = (2.58126 * x + 0.813703 * y) * y / (1 + 0.310327 * x * x + 2.60994 * x * y)
    # b is sqrt(1 - x) times this; the light's tangent along the viewer's is slant / sin, sin = sqrt(1 - x^2).
    b = (y - 1) * y**3 / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y)
    slant = 2 * pairs.cos_d.square() - 1 - pairs.cos_i * pairs.cos_o
    height = light.square()
    along = 2 * slant * light / (1 + x).sqrt()
    length = a * a * (1 - height) + a * b * along + (b * b * (1 - x) + 1) * height
    return fuzz_albedo(x, y) * (a / length) ** 2 * (1 / math.pi)
