"""Conventions of roughness: what other programs and papers call so, as alpha, the width that lobes have here."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.registry import unknown

Number = TypeVar("Number", float, Tensor)


@dataclass(frozen=True)
class RoughnessConvention:
    """What a program or a paper calls roughness.

    Args:
        meaning: a few words.
        formula: alpha, in terms of the value r.
        to_alpha: alpha of a tensor of values.
        from_alpha: the other way round.
    """

    meaning: str
    formula: str
    to_alpha: Callable[[Tensor], Tensor]
    from_alpha: Callable[[Tensor], Tensor]


def _same(meaning: str) -> RoughnessConvention:
    return RoughnessConvention(meaning, "r", lambda r: r, lambda a: a)


def _squared(meaning: str) -> RoughnessConvention:
    return RoughnessConvention(meaning, "r^2", torch.square, torch.sqrt)


ROUGHNESS: dict[str, RoughnessConvention] = {
    "alpha": _same("`roughness` of `ggx`, `beckmann`, `gtr`, `student_t`, `ward`, `cook_torrance` here"),
    "mitsuba": _same("`alpha` of Mitsuba's `roughconductor`, `roughplastic`, `roughdielectric`"),
    "pbrt_alpha": _same("`roughness` of pbrt where `remaproughness` is false"),
    "m": _same("m of Beckmann, Cook-Torrance and Ward: sqrt(2) times the standard deviation of a slope"),
    "slope_deviation": RoughnessConvention(
        "the standard deviation of the slopes in one direction, of Beckmann's distribution; GGX has none",
        "sqrt(2) r",
        lambda r: math.sqrt(2) * r,
        lambda a: a / math.sqrt(2),
    ),
    "gltf": _squared("`roughnessFactor` of glTF 2.0, also for clear coat and sheen"),
    "openpbr": _squared("`specular_roughness`, `coat_roughness` of OpenPBR and of MaterialX's standard surface"),
    "blender": _squared("`Roughness` of Blender's Principled and Glossy BSDF"),
    "disney": _squared("`roughness` of Disney's model, in BRDF Explorer and Mitsuba's `principled`"),
    "pbrt": RoughnessConvention(
        "`roughness` of pbrt-v4, unless `remaproughness` is false",
        "sqrt(r)",
        torch.sqrt,
        torch.square,
    ),
    "disney_gloss": RoughnessConvention(
        "`clearcoatGloss` of Disney's model, of a distribution with exponent 1",
        "0.1 - 0.099 r",
        lambda r: 0.1 - 0.099 * r,
        lambda a: (0.1 - a) / 0.099,
    ),
    "exponent": RoughnessConvention(
        "n of a lobe of half vectors, as `blinn_phong` and `ashikhmin_shirley`, as sharp as Beckmann's",
        "sqrt(2 / (n + 2))",
        lambda n: (2 / (n + 2)).sqrt(),
        lambda a: 2 / a.square() - 2,
    ),
    "mirror_exponent": RoughnessConvention(
        "n of a lobe about the mirror direction, Phong's and `lafortune`'s: a fourth of the other, where it is sharp",
        "sqrt(2 / (4 n + 2))",
        lambda n: (2 / (4 * n + 2)).sqrt(),
        lambda a: 0.5 / a.square() - 0.5,
    ),
}
"""The conventions by name."""


def roughness_to_alpha(roughness: Number, convention: str) -> Number:
    """Alpha, the width of a lobe here, of what another program calls roughness.

    Args:
        roughness: a number or a tensor of any shape.
        convention: a name in `ROUGHNESS`: "gltf", "blender", "pbrt", "exponent", ...

    Returns:
        A number for a number, a tensor of the same shape for a tensor.

    Raises:
        UsageError: the convention is unknown, or a value is below 0.

    Example:
        >>> from torchbrdf.lobes import roughness_to_alpha
        >>> roughness_to_alpha(0.5, "gltf"), roughness_to_alpha(198.0, "exponent")
        (0.25, 0.1)
    """
    return _converted(roughness, convention, lambda one: one.to_alpha)


def alpha_to_roughness(alpha: Number, convention: str) -> Number:
    """What another program calls roughness, of alpha, the width of a lobe here.

    Args:
        alpha: a number or a tensor of any shape.
        convention: a name in `ROUGHNESS`.

    Returns:
        A number for a number, a tensor of the same shape for a tensor. Beyond what the other program allows it is a
        value that it refuses, as an exponent below 0.

    Raises:
        UsageError: the convention is unknown, or a value is below 0.

    Example:
        >>> from torchbrdf.lobes import alpha_to_roughness
        >>> alpha_to_roughness(0.25, "blender"), alpha_to_roughness(0.25, "pbrt")
        (0.5, 0.0625)
    """
    return _converted(alpha, convention, lambda one: one.from_alpha)


def exponent_to_alpha(exponent: Number) -> Number:
    """Alpha of Beckmann's distribution that is as sharp as cos_h^n: sqrt(2 / (n + 2)).

    Args:
        exponent: n, a number or a tensor of any shape.

    Returns:
        A number for a number, a tensor of the same shape for a tensor.

    Source: B. Walter, S. Marschner, H. Li and K. Torrance, Microfacet Models for Refraction through Rough Surfaces,
    2007, doi:10.2312/EGWR/EGSR07/195-206, of Phong's distribution.

    Example:
        >>> from torchbrdf.lobes import exponent_to_alpha
        >>> exponent_to_alpha(6.0)
        0.5
    """
    return roughness_to_alpha(exponent, "exponent")


def alpha_to_exponent(alpha: Number) -> Number:
    """The n of cos_h^n that is as sharp as Beckmann's distribution: 2 / alpha^2 - 2.

    Args:
        alpha: a number or a tensor of any shape.

    Returns:
        A number for a number, a tensor of the same shape for a tensor.

    Example:
        >>> from torchbrdf.lobes import alpha_to_exponent
        >>> alpha_to_exponent(0.5)
        6.0
    """
    return alpha_to_roughness(alpha, "exponent")


def _converted(value: Number, name: str, pick: Callable[[RoughnessConvention], Callable[[Tensor], Tensor]]) -> Number:
    """By one of a convention's formulas; numbers are worked on in float64."""
    if name not in ROUGHNESS:
        raise unknown("convention of roughness", name, ROUGHNESS)
    tensor = value if isinstance(value, Tensor) else torch.tensor(value, dtype=torch.float64, device="cpu")
    if not bool((tensor >= 0).all()):
        raise UsageError(f"roughness: expected numbers of at least 0, found {float(tensor.min())}")
    found = pick(ROUGHNESS[name])(tensor)
    return found if isinstance(value, Tensor) else found.item()
