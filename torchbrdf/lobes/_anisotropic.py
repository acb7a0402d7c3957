"""What anisotropic lobes share: the half vector in the frame of the grain, and one way to say where the grain lies."""

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import TAN2_CEILING
from torchbrdf.lobes.base import Lobe
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.pairs import Pairs

# Beyond this a slope no longer changes anything, as TAN2_CEILING.
_CEILING = math.sqrt(TAN2_CEILING)


def rotation_of_the_grain() -> BoundedParameter:
    """Declare the azimuth of a lobe's own x axis, from the tangent on, counterclockwise about the normal.

    The bounds are a whole turn, though half of one has all there is: solvers do not end at a bound in the middle.
    """
    return BoundedParameter(
        start=0.0, lower=-math.pi, upper=math.pi, doc="azimuth of the lobe's x axis from the tangent, radians"
    )


def width(axis: str, start: float, upper: float = 1.0) -> BoundedParameter:
    """Declare alpha along an axis of a lobe's own."""
    return BoundedParameter(start=start, lower=0.001, upper=upper, log=True, doc=f"alpha along the lobe's {axis} axis")


def root_of_width(axis: str, start: float) -> BoundedParameter:
    """Declare the roughness of a whole material along an axis of its own, the square root of alpha."""
    return BoundedParameter(
        start=start, lower=0.032, upper=1.0, log=True, doc=f"the square root of alpha along the lobe's {axis} axis"
    )


def in_the_grain(x: Tensor, y: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor]:
    """Components along the lobe's own axes of vectors with components along tangent and bitangent, `(..., N)`."""
    cos, sin = rotation.cos(), rotation.sin()
    return x * cos + y * sin, y * cos - x * sin


def half_slopes(pairs: Pairs, rotation: Tensor) -> tuple[Tensor, Tensor]:
    """The half vector's slopes along the lobe's own axes, finite at half vectors on the horizon."""
    x = pairs.cached(half_slopes, lambda: pairs.slope_x.clamp(-_CEILING, _CEILING), "x")
    y = pairs.cached(half_slopes, lambda: pairs.slope_y.clamp(-_CEILING, _CEILING), "y")
    return in_the_grain(x, y, rotation)


class AnisotropicLobe(Lobe):
    """A lobe that is wider along one axis of the surface than along the other.

    A quarter of a turn with both widths exchanged is the same lobe, and so is half of one; fits give the one whose x
    axis is the narrow one, which lies along the scratches of a brushed surface, with a rotation above -pi/2 and at most
    pi/2.
    """

    is_anisotropic: ClassVar[bool] = True
    axes: ClassVar[tuple[str, str]] = ("roughness_x", "roughness_y")
    """The parameters that say how wide the lobe is along x and along y."""
    rises_with_width: ClassVar[bool] = True
    """Whether those are widths; if not, they are exponents."""

    @classmethod
    def canonical(cls, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The same lobe with its x axis along the grain."""
        first, second = (parameters[name] for name in cls.axes)
        exchanged = (first > second) == cls.rises_with_width
        exchanged = exchanged & (first != second)
        rotation = torch.where(exchanged, parameters["rotation"] + math.pi / 2, parameters["rotation"])
        return {
            **parameters,
            cls.axes[0]: torch.where(exchanged, second, first),
            cls.axes[1]: torch.where(exchanged, first, second),
            "rotation": _within_half_a_turn(rotation),
        }

    @classmethod
    def other_starts(cls, parameters: Mapping[str, Tensor]) -> list[dict[str, Tensor]]:
        """Eighths of a turn further: with both widths in order, one of the four is no farther off than a sixteenth."""
        turns = (_within_half_a_turn(parameters["rotation"] + k * math.pi / 4) for k in (1, 2, 3))
        return [{**parameters, "rotation": turn} for turn in turns]


def _within_half_a_turn(rotation: Tensor) -> Tensor:
    """Above -pi/2 and at most pi/2."""
    return rotation - math.pi * torch.ceil(rotation / math.pi - 0.5)
