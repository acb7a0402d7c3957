"""Fitted models as records: each a material, a model and its parameters, as `fits.json` has them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import torch

from torchbrdf.errors import DataError, TorchbrdfError, shown
from torchbrdf.lobes.base import LOBES, RGB
from torchbrdf.lobes.model import JOIN, SHARE, from_parameters, model_name
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
# Fields of text that people are shown, and how long they may be.
TEXTS = {
    "loss": 200, "strategy": 2000, "chosen": 2000, "status": 200, "diffuse": 200, "reason": 2000, "scene": 2000,
    "at_bounds": 200, "undetermined": 200,
}  # fmt: skip
REACHED = 1.2
"""An error up to so many times that of the noise alone has reached it."""


@dataclass
class FitRecord:
    """One fit of one material, as `fits.json` holds it; or a model that stands in for a material.

    Args:
        material: Name of the material.
        model: Registered name of the specular lobes, or of all components, joined by +, or of a whole material; behind
            a colon the parameters that lobes share.
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
        undetermined: Parameters that the error leaves open, see `torchbrdf.fitting.undetermined`.
        seconds: Of work, its share of the batch.
        max_theta: Largest angle from the normal of the pairs that counted, in degrees.
        samples: How many pairs the solver saw; None: every one.
        seed: Of the subset.
        channels: Of values: 3 of linear RGB, or as many as there are bands.
        wavelengths: Of the bands, nm; None of linear RGB, and where nobody knows them.
        reading: How the measurement's file was read: its format and name, what the reader was told, what was believed,
            and what became of bands and colours.
        scene: What a rendered loss saw.
        chosen: The loss whose fit was kept, where the strategy fits under several.
        diffuse: `45:0`, where the diffuse albedo was measured and held, or `fit`.
        iterations: Of the solver.
        errors: Errors on every valid pair by the name of a loss.
        outlier: Whether another loss's fit has the lower error under this one's loss: a local minimum.
        intervals: Of parameters, their `level`, and by method (`gauss_newton`, `bootstrap`) `low` and `high` ends, as
            `parameters` has values; None where there is none: held, at a bound, or at no minimum.
        differences: Image differences of its picture by name.
        pictures: The same for each of several scenes.
        noise: Of the measurement: its `share` of the value, `by` what it was told and from how many `samples`, and the
            `error` of a fit that is off by nothing else.
        extra: What a file says besides, which is kept.

    Example:
        >>> from torchbrdf.lobes import read_fits
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
    undetermined: list[str] = field(default_factory=list)
    seconds: float = 0.0
    max_theta: float | None = None
    samples: int | None = None
    seed: int | None = None
    channels: int = RGB
    wavelengths: list[float] | None = None
    reading: dict[str, Any] = field(default_factory=dict)
    scene: str = ""
    chosen: str = ""
    diffuse: str = ""
    iterations: int = 0
    errors: dict[str, float] = field(default_factory=dict)
    outlier: bool | None = None
    intervals: dict[str, Any] = field(default_factory=dict)
    differences: dict[str, float] = field(default_factory=dict)
    pictures: dict[str, dict[str, float]] = field(default_factory=dict)
    noise: dict[str, Any] = field(default_factory=dict)
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def has_reached_noise(self) -> bool:
        """Whether the error is no more than that of the measurement's noise, or little more: `REACHED` times."""
        alone = self.noise.get("error")
        return isinstance(alone, int | float) and self.error <= REACHED * alone

    def to_json(self) -> dict[str, Any]:
        """The record by the keys of `fits.json`, in their order, without what is not known."""
        found: dict[str, Any] = {key: getattr(self, key) for key in ("material", "model", "lobes")}
        for key in FITTED:
            if key == "diffuse":
                found |= {name: text for name in ("scene", "chosen") if (text := getattr(self, name))}
            if self.strategy or not _is_default(self, key):
                found[key] = getattr(self, key)
        found |= {
            key: getattr(self, key)
            for key in ("undetermined", "channels", "wavelengths", "reading")
            if not _is_default(self, key)
        }
        found["parameters"] = self.parameters
        for key in ("intervals", "errors", "outlier", "differences", "pictures", "noise"):
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
            DataError: Something that is needed is not there, of another type, or cannot be.
        """
        import msgspec  # late: not every fit is read from a file

        missing = [key for key in NEEDED if key not in values]
        if missing:
            raise DataError(f"{where} lacks {', '.join(missing)}")
        known = {one.name for one in fields(cls)} - {"extra"}
        own = {key: _with_nan(value) if key in NUMBERS else value for key, value in values.items() if key in known}
        try:
            record = msgspec.convert(own, cls)
        except msgspec.ValidationError as error:
            raise DataError(f"{where}: {_said(error)}") from None
        record.extra = {key: value for key, value in values.items() if key not in known}
        record._check(where)
        return record

    def to_model(self, dtype: torch.dtype | None = None) -> Sum:
        """The model, of one material.

        Args:
            dtype: Of the parameters; torch's default if not given.

        Raises:
            DataError: Parameters are not those of the model that is named.
            UsageError: There is no such model, or it has no such channels.

        Example:
            >>> from torchbrdf.lobes import read_fits
            >>> from torchbrdf.measured import standins
            >>> len(read_fits(standins())[7].to_model().components())
            2
        """
        return from_parameters(self.model, self.parameters, dtype, self.channels)

    def _check(self, where: str) -> None:
        """A DataError if what is said cannot be."""
        lengths = self.wavelengths
        if lengths is not None and (len(lengths) != self.channels or not _grow(lengths)):
            expected = f"expected {self.channels} growing numbers, in nm"
            raise DataError(f"{where}: wavelengths: {expected}, found {shown(lengths)}")
        check_name(self.material, f"{where}: material")
        for key, longest in TEXTS.items():
            for text in [value] if isinstance(value := getattr(self, key), str) else value:
                if not text.isprintable() or len(text) > longest:
                    raise DataError(
                        f"{where}: {key}: expected at most {longest} printable characters, found {shown(text)}"
                    )
        unknown = [part for part in self.model.partition(SHARE)[0].split(JOIN) if part not in LOBES]
        if unknown:
            raise DataError(f"{where}: model: expected one of {', '.join(LOBES)}, found {shown(unknown[0])}")
        try:
            made = model_name(self.to_model())[1]
        except TorchbrdfError as error:
            raise DataError(f"{where}: {error}") from None
        if made != self.lobes:
            raise DataError(f"{where}: lobes: expected {made}, as parameters has, found {self.lobes}")


def model_of(records: Sequence[FitRecord], dtype: torch.dtype | None = None) -> Sum:
    """The batched model of several records with the same kind and number of lobes.

    Args:
        records: M of them.
        dtype: Of the parameters; torch's default if not given.

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
    models = [record.to_model(dtype) for record in records]
    values = [get_parameters(model) for model in models]
    kinds = [(record.model, len(own), record.channels) for record, own in zip(records, values, strict=True)]
    for record, kind in zip(records, kinds, strict=True):
        if kind != kinds[0]:
            raise DataError(f"{record.material}: expected lobes as {records[0].material} has, found {kind[0]}")
    return with_parameters(models[0], {name: torch.stack([own[name] for own in values]) for name in values[0]})


def _said(error: Exception) -> str:
    """msgspec's message, such as "Expected `str`, got `null` - at `$.material`", with the place in front."""
    text, _, place = str(error).partition(" - at ")
    place = place.strip("`").removeprefix("$").removeprefix(".")
    return f"{place}: {text[:1].lower()}{text[1:]}" if place else text


def _grow(lengths: Sequence[float]) -> bool:
    """Whether they are wavelengths, each longer than the one before."""
    return all(0 < one < other for one, other in zip(lengths, (*lengths[1:], math.inf), strict=True))


def _with_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    return math.nan if value is None else value


def _is_default(record: FitRecord, key: str) -> bool:
    value, default = getattr(record, key), getattr(_BARE, key)
    return bool(value == default) or (value != value and default != default)  # nan is nan


_BARE = FitRecord("", "", 0, {})
