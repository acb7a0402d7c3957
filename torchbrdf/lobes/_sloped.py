"""Values that carry their derivatives, of which whole materials make their terms.

Forward differentiation of a material as a whole takes all of it again for each scalar. Here each factor has derivatives
only by what it knows, in a closed form where that is short.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor

from torchbrdf.lobes import _anisotropic_ggx
from torchbrdf.lobes._microfacet import tangent
from torchbrdf.lobes.base import Lobe
from torchbrdf.lobes.fresnel import dielectric, dielectric_derivative
from torchbrdf.lobes.ggx import ggx_distribution
from torchbrdf.lobes.separable import Slopes
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_sqrt

Visibility = Callable[[Pairs, Tensor], tuple[Tensor, Tensor]]


class Sloped:
    """A number of each material, or of each pair, and its derivatives by the scalars that it knows, by their names.

    Torch's own forward differentiation goes through Python at every operation on a tensor without a derivative, and so
    takes as long for a number as for a thousand pairs.
    """

    def __init__(self, value: Tensor, slopes: dict[str, Tensor] | None = None) -> None:
        self.value, self.slopes = value, slopes or {}

    def chain(self, value: Tensor, derivative: Callable[[], Tensor]) -> "Sloped":
        """A function of it, whose derivative by it is worked out only where one is wanted."""
        if not self.slopes:
            return Sloped(value)
        steep = derivative()
        return Sloped(value, {name: steep * slope for name, slope in self.slopes.items()})

    def __add__(self, other: "Sloped | Tensor | float") -> "Sloped":
        if not isinstance(other, Sloped):
            return Sloped(self.value + other, self.slopes)
        return Sloped(self.value + other.value, _total(self.slopes, other.slopes))

    def __mul__(self, other: "Sloped | Tensor | float") -> "Sloped":
        if not isinstance(other, Sloped):
            return Sloped(self.value * other, {name: slope * other for name, slope in self.slopes.items()})
        first = {name: slope * other.value for name, slope in self.slopes.items()}
        second = {name: slope * self.value for name, slope in other.slopes.items()}
        return Sloped(self.value * other.value, _total(first, second))

    def __pow__(self, power: float) -> "Sloped":
        return self.chain(self.value**power, lambda: power * self.value ** (power - 1))

    __radd__ = __add__
    __rmul__ = __mul__

    def __neg__(self) -> "Sloped":
        return self * -1.0

    def __sub__(self, other: "Sloped | Tensor | float") -> "Sloped":
        return self + -other

    def __rsub__(self, other: Tensor | float) -> "Sloped":
        return -self + other

    def __truediv__(self, other: "Sloped | Tensor | float") -> "Sloped":
        return self * (other**-1)

    def __rtruediv__(self, other: Tensor | float) -> "Sloped":
        return self**-1 * other

    def exp(self) -> "Sloped":
        """e to the power of it."""
        value = self.value.exp()
        return self.chain(value, lambda: value)

    def clamp(self, lower: float, upper: float) -> "Sloped":
        """It within bounds."""
        inside = (self.value > lower) & (self.value < upper)
        return self.chain(self.value.clamp(lower, upper), lambda: inside.to(self.value.dtype))


Value = TypeVar("Value", Tensor, Sloped)
"""Formulas are the same of tensors, which torch may differentiate and compile, and of numbers with slopes."""
Mixed = Any
"""A tensor or a `Sloped`, of formulas in which both come together."""


def _total(first: dict[str, Tensor], second: dict[str, Tensor]) -> dict[str, Tensor]:
    both = {name: first[name] + second[name] for name in first.keys() & second.keys()}
    return {**first, **second, **both}


def chain(x: Value, value: Tensor, derivative: Callable[[], Tensor]) -> Value:
    """A function of x that has this value, and this derivative by x."""
    return x.chain(value, derivative) if isinstance(x, Sloped) else value


def number(x: "Tensor | Sloped") -> Tensor:
    """It without derivatives."""
    return x.value if isinstance(x, Sloped) else x


def root(x: Value) -> Value:
    """Square root, with slope 0 at 0."""
    value = safe_sqrt(number(x))
    return chain(x, value, lambda: torch.where(value > 0, 0.5 / value, 0))


def of_several(value: Tensor, *by: tuple[Mixed, Callable[[], Tensor]]) -> Mixed:
    """A function of some numbers that has this value, and by each of them this derivative."""
    if not any(isinstance(x, Sloped) for x, _ in by):
        return value
    slopes: dict[str, Tensor] = {}
    for x, steep in by:
        slopes = _total(slopes, _sloped(x).chain(value, steep).slopes)
    return Sloped(value, slopes)


def linear(x: Value, function: Callable[[Tensor], Tensor]) -> Value:
    """A linear function of all of its numbers, such as a sum over a dimension."""
    if not isinstance(x, Sloped):
        return function(x)
    return Sloped(function(x.value), {name: function(slope.expand_as(x.value)) for name, slope in x.slopes.items()})


def larger(x: Mixed, y: Mixed) -> Mixed:
    """The larger of both."""
    if not isinstance(x, Sloped) and not isinstance(y, Sloped):
        return torch.maximum(x, y)
    one, other = _sloped(x), _sloped(y)
    first = one.value > other.value
    own = {name: torch.where(first, slope, 0) for name, slope in one.slopes.items()}
    others = {name: torch.where(first, 0, slope) for name, slope in other.slopes.items()}
    return Sloped(torch.where(first, one.value, other.value), _total(own, others))


def smaller(x: Mixed, y: Mixed) -> Mixed:
    """The smaller of both."""
    return -larger(-x, -y)


def _sloped(x: Tensor | Sloped) -> Sloped:
    return x if isinstance(x, Sloped) else Sloped(x)


def facets(pairs: Pairs, alpha: Value, visibility: Visibility) -> Value:
    """D G / (4 cos_i cos_o) of GGX; d/da = itself (2 / a - 4 a / (a^2 + tan2_h) + d log G / da)."""
    a, tan2 = number(alpha), tangent(pairs)
    seen, slope = visibility(pairs, a)
    value = ggx_distribution(a, tan2) * seen
    return chain(alpha, value, lambda: value * (slope + 2 / a - 4 * a / (a.square() + tan2)))


def grain_facets(pairs: Pairs, a_x: Mixed, a_y: Mixed, rotation: Mixed) -> Mixed:
    """D G / (4 cos_i cos_o) of GGX with a grain."""
    numbers = (number(a_x), number(a_y), number(rotation))
    own = _anisotropic_ggx.facets(
        _anisotropic_ggx.distribution(pairs, *numbers), _anisotropic_ggx.visibility(pairs, *numbers)
    )
    x, y, turn = (partial(own.value.mul, slope) for slope in own[1:])
    return of_several(own.value, (a_x, x), (a_y, y), (rotation, turn))


def fresnel_of(pairs: Pairs, ior: Value) -> Value:
    """`dielectric` on pairs."""
    index = number(ior)
    return chain(ior, dielectric(index, pairs.cos_d), lambda: dielectric_derivative(index, pairs.cos_d))


class LayeredMaterial(Lobe):
    """A whole material, which declares its terms as `layers`."""

    is_material: ClassVar[bool] = True

    @classmethod
    def layers(cls, pairs: Pairs, *scalars: Any) -> list[Any]:
        """The terms, of the scalars of `scalars_of_terms`, in that order: tensors of tensors, else `Sloped`."""
        raise NotImplementedError

    @classmethod
    def terms(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """Those of `layers`."""
        return cls.layers(pairs, *scalars)

    @classmethod
    def terms_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> tuple[list[Tensor], Slopes]:
        """Those of `layers`, with their derivatives."""
        names = [spec.name for spec in cls.term_scalars()]
        own = [Sloped(value, {name: torch.ones_like(value)}) for name, value in zip(names, scalars, strict=True)]
        found = cls.layers(pairs, *own)
        slopes = [getattr(one, "slopes", {}) for one in found]
        return [number(one) for one in found], [[own.get(name) for own in slopes] for name in names]
