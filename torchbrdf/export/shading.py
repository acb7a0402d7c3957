"""A program's own material for a BRDF: the same where it has it, else what fits best."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.export.base import Brdf, Exported, Material
from torchbrdf.export.refit import refit
from torchbrdf.files import write_text
from torchbrdf.lobes import LOBES, Lambert, Lobe
from torchbrdf.measured import Measured

# How far beyond a limit a value may be by rounding, as a share of the limit, or of 1.
ROUNDING = 1e-5
# A factor of a lobe that is as good as 0: of the sharpest one nothing is seen.
BLACK = 1e-10

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

    def write(self, path: Path, text: str) -> Exported:
        """Write the one file that it comes to."""
        write_text(path, text)
        return Exported([path], self.exact, self.notes, self.shown)


@dataclass(frozen=True)
class Target:
    """What a program's material can be.

    Args:
        title: What notes call it.
        limits: Its parameters by the program's names.
        model: Registered name of the lobe that is a whole material, and is fitted to what the program does not have.
        translated: The program's parameters for that lobe's.
        differs: In what the program's own function differs from that lobe; nothing if it does not.
        simple: By the registered name of another lobe, such as "lambert", the parameters with which the program shows
            that lobe alone exactly; None where it cannot.
        name: Registered name of the exporter, for which `match` finds what is nearer than a refitted model; "" if none.
    """

    title: str
    limits: Mapping[str, Limits]
    model: str
    translated: Callable[[Any], Values]
    differs: str
    simple: Mapping[str, Callable[[Any], Values | None]]
    name: str = ""

    def shading(self, material: Material) -> Shading:
        """The program's parameters for a material.

        Raises:
            DataError: The material cannot be fitted.
        """
        if isinstance(material.brdf, Lobe):
            (part, *more) = visible(material.brdf) or [Lambert(albedo=0.0)]
            kind = None if more else LOBES.name_of(type(part))
            found = self._exactly(part, kind, material)
            if found is not None:
                return found
            if kind == self.model:
                return self._own(part, material.brdf, material.name, [])
        fitted = refit(material, self.model)
        (part,) = fitted.model.components()
        measured = self.name and isinstance(material.brdf, Measured)
        nearer = f"; torchbrdf match MEASUREMENT --for {self.name} finds a nearer one" if measured else ""
        return self._own(part, fitted.model, material.name, [fitted.note + nearer])

    def _exactly(self, lobe: Lobe, kind: str | None, material: Material) -> Shading | None:
        """The same function in the program's terms, if it has it within its limits."""
        simple = self.simple.get(kind or "")
        found = simple(lobe) if simple is not None else None
        if found is None:
            return None
        values, changes = within(found, self.limits, material.name)
        return None if changes else Shading(values, True, [f"exact: {self.title}"], material.brdf)

    def _own(self, lobe: Lobe, model: Lobe, name: str, notes: list[str]) -> Shading:
        """The lobe that is like the program's material."""
        values, changes = within(self.translated(lobe), self.limits, name)
        differs = [f"{self.title}: {self.differs}"] if self.differs else []
        exact = not (notes or changes or differs)
        return Shading(values, exact, [f"exact: {self.title}"] if exact else [*notes, *changes, *differs], model)


def visible(brdf: Lobe) -> list[Lobe]:
    """The components of a model that are not black, as a diffuse term beside a metal often is.

    Example:
        >>> from torchbrdf.lobes import GGX, Lambert, Sum
        >>> visible(Sum(Lambert(albedo=0.5), GGX(specular=0.0)))
        [Lambert(albedo=[0.5, 0.5, 0.5])]
    """
    return [part for part in brdf.components() if not _is_black(part)]


def _is_black(lobe: Lobe) -> bool:
    """Whether a factor of the lobe is 0, or what solvers leave of that."""
    factors = [
        name for name, spec in lobe.parameter_specs.items() if spec.linear or (lobe.is_diffuse and spec.size == 3)
    ]
    return any(bool((getattr(lobe, name).abs() <= BLACK).all()) for name in factors)


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
