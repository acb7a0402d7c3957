"""Grains for programs whose materials have one along the tangent or across it, and no rotation."""

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

from torchbrdf.errors import DataError
from torchbrdf.export.base import Material, numbers
from torchbrdf.export.refit import refit
from torchbrdf.export.shading import visible
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import get_parameters

# Of a quarter of a turn: materials have no rotation but quarters, which exchange the widths.
QUARTER = 1e-6
# The same of a model that was fitted, whose rotation has an error of its own.
STRAIGHT = 0.02


class Straight(NamedTuple):
    """A model whose grain lies along the tangent or across it, and what was changed to get there, one line each."""

    model: Lobe
    notes: list[str]


def quarters(lobe: Lobe) -> int | None:
    """Whether a lobe's grain lies along the tangent, 0, or across it, 1; None if it lies otherwise."""
    turns = _turns(lobe) if lobe.is_anisotropic else 0.0
    return round(turns) % 2 if abs(turns - round(turns)) < QUARTER else None


def along_the_tangent(
    material: Material, model: Lobe, has: Callable[[list[Lobe]], bool], nearest: str, to: str
) -> Straight:
    """The model itself, if a program has it; else the nearest one, whose grain lies along the tangent or across it.

    Args:
        material: What is exported.
        model: Its BRDF, a model with a grain.
        has: Whether the program has a model of these lobes, wherever their grains lie.
        nearest: What is fitted, where it has not.
        to: Name of the exporter.

    Raises:
        DataError: Its lobes have grains in several directions, or it cannot be fitted.
    """
    notes = list[str]()
    if not has(visible(model)):
        found = refit(material, nearest)
        model, notes = found.model, [found.note]
        for part in model.components():
            if part.is_anisotropic and abs(off := _turns(part) - round(_turns(part))) < STRAIGHT:
                part.rotation = (_turns(part) - off) * math.pi / 2
    model = copy.deepcopy(model)
    grains = [part for part in visible(model) if part.is_anisotropic]
    if all(quarters(part) is not None for part in grains):
        return Straight(model, notes)
    for part in grains:
        for name, value in type(part).canonical(get_parameters(part)).items():
            setattr(part, name, value)
    first, *others = [numbers(part.rotation)[0] for part in grains]  # type: ignore[arg-type]
    if any(abs(math.sin(2 * (other - first))) > QUARTER for other in others):
        angles = ", ".join(f"{angle:.3g}" for angle in (first, *others))
        raise DataError(f"{material.name}: expected one direction of the grain for {to}, found rotations {angles}")
    for part, own in zip(grains, (first, *others), strict=True):
        part.rotation = round((own - first) / (math.pi / 2)) % 2 * math.pi / 2
    turn = f"{math.degrees(first):.4g} degrees counterclockwise"
    return Straight(model, [*notes, f"without the rotation of the grain: turn the texture coordinates by {turn}"])


def _turns(lobe: Lobe) -> float:
    """The rotation of a lobe's grain in quarters of a turn."""
    return float(lobe.rotation.item() / (math.pi / 2))  # type: ignore[operator]
