"""A program's own material for a BRDF: the same where it has it, else what fits best."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.export.base import Brdf, Material
from torchbrdf.export.refit import refit
from torchbrdf.lobes import LOBES, Lambert, Lobe

# How far beyond a limit a value may be by rounding, as a share of the limit, or of 1.
ROUNDING = 1e-5

Value = float | list[float]
"""A number, or a linear RGB colour."""
Values = dict[str, Value]


class Limits(NamedTuple):
    """What a program's parameter may be."""

    lower: float = 0.0
    upper: float = 1.0
    size: int = 1
    """Numbers: 3 of a colour."""


UNIT = Limits()
COLOUR = Limits(size=3)


@dataclass(frozen=True)
class Shading:
    """A program's own material.

    Args:
        values: Of its parameters, within their limits, by the program's names.
        exact: Whether it is the same function as the BRDF.
        notes: What is exact and what was changed, one line each.
        shown: The BRDF that is seen.
    """

    values: Values
    exact: bool
    notes: list[str]
    shown: Brdf


@dataclass(frozen=True)
class Target:
    """What a program's material can be.

    Args:
        title: What notes call it.
        limits: Its parameters by the program's names.
        model: Registered name of the lobe that is fitted to what it does not have.
        simple: By the registered name of a lobe, such as "lambert", the parameters with which the program shows that
            lobe alone exactly; None where it cannot.
    """

    title: str
    limits: Mapping[str, Limits]
    model: str
    simple: Mapping[str, Callable[[Any], Values | None]]

    def shading(self, material: Material) -> Shading:
        """The program's parameters for a material.

        Raises:
            DataError: The material cannot be fitted.
        """
        found = self._exactly(material.brdf) if isinstance(material.brdf, Lobe) else None
        if found is not None:
            values, changes = within(found, self.limits, material.name)
            return Shading(values, not changes, changes or [f"exact: {self.title}"], material.brdf)
        fitted = refit(material, self.model)
        (lobe,) = fitted.model.components()
        values, changes = within(self._own(lobe), self.limits, material.name)
        return Shading(values, False, [fitted.note, *changes], fitted.model)

    def _exactly(self, brdf: Lobe) -> Values | None:
        parts = visible(brdf) or [Lambert(albedo=0.0)]
        name = LOBES.name_of(type(parts[0])) if len(parts) == 1 else None
        return self.simple[name](parts[0]) if name in self.simple else None

    def _own(self, lobe: Lobe) -> Values:
        found = self.simple[self.model](lobe)
        if found is None:
            raise UsageError(f"{self.title}: expected parameters of {self.model}, found none")
        return found


def visible(brdf: Lobe) -> list[Lobe]:
    """The components of a model that are not black, as a diffuse term beside a metal often is.

    Example:
        >>> from torchbrdf.lobes import GGX, Lambert, Sum
        >>> visible(Sum(Lambert(albedo=0.5), GGX(specular=0.0)))
        [Lambert(albedo=[0.5, 0.5, 0.5])]
    """
    return [part for part in brdf.components() if not _is_black(part)]


def _is_black(lobe: Lobe) -> bool:
    """Whether a factor of the lobe is 0."""
    factors = [
        name for name, spec in lobe.parameter_specs.items() if spec.linear or (lobe.is_diffuse and spec.size == 3)
    ]
    return any(not bool(getattr(lobe, name).any()) for name in factors)


def within(values: Mapping[str, Value], limits: Mapping[str, Limits], where: str) -> tuple[Values, list[str]]:
    """Values of a program's parameters, moved into their limits, and a note for each that was moved.

    Args:
        values: By the program's names.
        limits: Of all parameters that the program has.
        where: Whose they are, for messages.

    Raises:
        UsageError: There is no such parameter.
        DataError: A value has another shape, or is not finite.

    Example:
        >>> within({"baseColorFactor": [0.5, 1.25, 0.0]}, {"baseColorFactor": COLOUR}, "gold")
        ({'baseColorFactor': [0.5, 1.0, 0.0]}, ['baseColorFactor: moved from 1.25 to its limit 1'])
    """
    found: Values = {}
    notes: list[str] = []
    for name, value in values.items():
        if name not in limits:
            raise UsageError(f"{where}: expected one of {', '.join(limits)}, found {shown(name)}")
        limit = limits[name]
        numbers = _numbers(value, limit.size, f"{where}: {name}")
        moved = [min(max(number, limit.lower), limit.upper) for number in numbers]
        notes += dict.fromkeys(
            f"{name}: moved from {number:g} to its limit {inside:g}"
            for number, inside in zip(numbers, moved, strict=True)
            if abs(number - inside) > ROUNDING * max(abs(inside), 1.0)
        )
        digits = [float(f"{one:.7g}") for one in moved]  # of single precision
        found[name] = digits if limit.size > 1 else digits[0]
    return found, notes


def _numbers(value: Value, size: int, where: str) -> list[float]:
    numbers = list(value) if isinstance(value, list | tuple) else [value]
    good = [isinstance(one, int | float) and not isinstance(one, bool) and math.isfinite(one) for one in numbers]
    if len(numbers) != size or not all(good):
        expected = "a number" if size == 1 else f"{size} numbers"
        raise DataError(f"{where}: expected {expected}, found {shown(value)}")
    return [float(one) for one in numbers]


def numbers_of(value: Any) -> Value:
    """A parameter of a lobe as a number, or a colour.

    Example:
        >>> import torch
        >>> numbers_of(torch.tensor([0.5])), numbers_of(torch.tensor([0.5, 0.25, 0.0]))
        (0.5, [0.5, 0.25, 0.0])
    """
    found: list[float] = value.detach().double().flatten().tolist()
    return found[0] if len(found) == 1 else found
