"""Fitted models as files: a list of records, each a material, a model and its parameters (`fits.json`)."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_origin

import torch

from torchbrdf.errors import DataError
from torchbrdf.files import write_json
from torchbrdf.lobes.model import from_parameters
from torchbrdf.lobes.parameter_dict import get_parameters, with_parameters
from torchbrdf.lobes.sum import Sum
from torchbrdf.names import check_name

NEEDED = ("material", "model", "lobes", "parameters")
# What a record of a fit has besides, in the order in which files have it; a model that nobody fitted lacks most of it.
FITTED = (
    "loss", "strategy", "error", "subset_error", "status", "reason", "starts", "ties", "at_bounds", "seconds",
    "max_theta", "samples", "seed", "diffuse", "iterations",
)  # fmt: skip
# Fields of numbers that may not be finite, for which JSON has null.
NUMBERS = ("error", "subset_error", "errors", "differences", "pictures")


@dataclass
class FitRecord:
    """One fit of one material, as `fits.json` holds it; or a model that stands in for a material.

    Args:
        material: Name of the material.
        model: Registered name of the specular lobes.
        lobes: How many of them there are.
        parameters: As `torchbrdf.lobes.parameters` gives them: `diffuse`, and a value a lobe for every other name.
        loss: Registered name of the loss that was minimised.
        strategy: Registered name of the strategy; a record without one is no fit but a model in a material's place.
        error: Of every valid pair within `max_theta`; nan if there is none.
        subset_error: Of the pairs that the solver saw.
        status: Whether the solver converged, a word of `torchbrdf.fitting.Status`.
        reason: Why it did not.
        starts: How many starts the strategy tried.
        ties: How many other minima came within 1 % of the best.
        at_bounds: Parameters that ended at a bound.
        seconds: Of work, its share of the batch.
        max_theta: Largest angle from the normal of the pairs that counted, in degrees.
        samples: How many pairs the solver saw; None: every one.
        seed: Of the subset.
        scene: What a rendered loss saw.
        diffuse: `45:0`, where the diffuse albedo was measured and held, or `fit`.
        iterations: Of the solver.
        errors: Errors on every valid pair by the name of a loss.
        outlier: Whether another loss's fit has the lower error under this one's loss: a local minimum.
        differences: Image differences of its picture by name.
        pictures: The same for each of several scenes.
        extra: What a file says besides, which is kept.

    Example:
        >>> from torchbrdf.measured import standins
        >>> record = read_fits(standins())[7]
        >>> record.material, record.model, record.lobes
        ('nylon', 'distribution_based', 1)
        >>> FitRecord.from_json(record.to_json()).to_json() == record.to_json()
        True
    """

    material: str
    model: str
    lobes: int
    parameters: dict[str, Any]
    loss: str = ""
    strategy: str = ""
    error: float = math.nan
    subset_error: float = math.nan
    status: str = ""
    reason: str = ""
    starts: int = 1
    ties: int = 0
    at_bounds: list[str] = field(default_factory=list)
    seconds: float = 0.0
    max_theta: float | None = None
    samples: int | None = None
    seed: int | None = None
    scene: str = ""
    diffuse: str = ""
    iterations: int = 0
    errors: dict[str, float] = field(default_factory=dict)
    outlier: bool | None = None
    differences: dict[str, float] = field(default_factory=dict)
    pictures: dict[str, dict[str, float]] = field(default_factory=dict)
    extra: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The record by the keys of `fits.json`, in their order, without what is not known."""
        found: dict[str, Any] = {key: getattr(self, key) for key in ("material", "model", "lobes")}
        for key in FITTED:
            if key == "diffuse" and self.scene:
                found["scene"] = self.scene
            if self.strategy or not _is_default(self, key):
                found[key] = getattr(self, key)
        found["parameters"] = self.parameters
        for key in ("errors", "outlier", "differences", "pictures"):
            if not _is_default(self, key):
                found[key] = getattr(self, key)
        return found | self.extra

    @classmethod
    def from_json(cls, values: Mapping[str, Any], where: str = "fit") -> "FitRecord":
        """The record that `to_json` gave. Keys that are not known are kept in `extra`.

        Args:
            values: An object of a `fits.json`.
            where: What to call it in an error.

        Raises:
            DataError: Something that is needed is not there, or is of another type.
        """
        missing = [key for key in NEEDED if key not in values]
        if missing:
            raise DataError(f"{where} lacks {', '.join(missing)}")
        known = {one.name: one.type for one in fields(cls) if one.name != "extra"}
        own = {
            key: _checked(values[key], kind, f"{where}: {key}", key in NUMBERS)
            for key, kind in known.items()
            if key in values
        }
        check_name(own["material"], f"{where}: material")
        return cls(**own, extra={key: value for key, value in values.items() if key not in known})


def model_of(records: Sequence[FitRecord]) -> Sum:
    """The batched model of several records with the same kind and number of lobes.

    Args:
        records: M of them.

    Returns:
        A model of M materials, in their order.

    Raises:
        DataError: Parameters are not those of the model that is named, or records differ in kind or number of lobes.

    Example:
        >>> from torchbrdf.lobes import Ward, Lambert, Sum, parameters
        >>> paint = FitRecord("paint", "ward", 1, parameters(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward())))
        >>> model_of([paint, paint])
        Sum(
          (lobes): ModuleList(
            (0): Lambert(albedo=<2 x 3>)
            (1): Ward(specular=<2 x 3>, roughness=<2 x 1>)
          )
        )
    """
    models = [from_parameters(record.model, record.parameters) for record in records]
    values = [get_parameters(model) for model in models]
    kinds = [(record.model, len(own)) for record, own in zip(records, values, strict=True)]
    for record, kind in zip(records, kinds, strict=True):
        if kind != kinds[0]:
            raise DataError(f"{record.material}: expected lobes as {records[0].material} has, found {kind[0]}")
    return with_parameters(models[0], {name: torch.stack([own[name] for own in values]) for name in values[0]})


def write_fits(path: Path | str, records: Iterable[FitRecord]) -> None:
    """Write records as JSON, whole or not at all; a number that is not finite is null.

    Args:
        path: The file.
        records: Of fits or stand-ins, of any models.

    Example:
        >>> import tempfile
        >>> from torchbrdf.measured import standins
        >>> records = read_fits(standins())
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_fits(f"{folder}/fits.json", records)
        ...     [record.material for record in read_fits(f"{folder}/fits.json")] == [one.material for one in records]
        True
    """
    write_json(path, [record.to_json() for record in records])


def read_fits(path: Path | str) -> list[FitRecord]:
    """Read and check a `fits.json`.

    Args:
        path: The file.

    Returns:
        Its records; `model_of` makes models of those with one kind and number of lobes.

    Raises:
        DataError: It cannot be read, or holds no list of fits; says where and what was expected.

    Example:
        >>> from torchbrdf.measured import standins
        >>> [record.material for record in read_fits(standins())][:3]
        ['alum-bronze', 'aluminium', 'blue-acrylic']
    """
    try:
        records = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: expected the JSON of fits, found {error}") from None
    if not isinstance(records, list) or not records or not all(isinstance(record, dict) for record in records):
        size = f" of {len(records)}" if isinstance(records, list | dict) else ""
        raise DataError(f"{path}: expected a list of fits, found {type(records).__name__}{size}")
    return [FitRecord.from_json(record, f"{path}: fit {k}") for k, record in enumerate(records)]


_NULL = type(None)
# What JSON may have for a field of each type, and what that is called in an error.
_TYPES: dict[Any, tuple[tuple[type, ...], str]] = {
    str: ((str,), "text"),
    int: ((int,), "a whole number"),
    float: ((int, float, _NULL), "a number or null"),
    bool | None: ((bool, _NULL), "true or false"),
    int | None: ((int, _NULL), "a whole number or null"),
    float | None: ((int, float, _NULL), "a number or null"),
    list: ((list,), "a list"),
    dict: ((dict,), "an object"),
}


def _checked(value: Any, kind: Any, where: str, numbers: bool) -> Any:
    """A value from JSON for a field of some type; `numbers`: null is nan in all of it."""
    types, said = _TYPES[get_origin(kind) if get_origin(kind) in (list, dict) else kind]
    if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
        raise DataError(f"{where}: expected {said}, found {str(value)[:60]!r}")
    return _with_nan(value) if numbers else value


def _with_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    return math.nan if value is None else value


def _is_default(record: FitRecord, key: str) -> bool:
    value, default = getattr(record, key), getattr(_BARE, key)
    return bool(value == default) or (value != value and default != default)  # nan is nan


_BARE = FitRecord("", "", 0, {})
