"""Fitted models as files: a list of records, each a material, a model and its parameters (`fits.json`)."""

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import torch

from torchbrdf.errors import DataError, TorchbrdfError, shown
from torchbrdf.files import write_json
from torchbrdf.lobes.base import LOBES, RGB
from torchbrdf.lobes.model import JOIN, SHARE, from_parameters, model_name
from torchbrdf.lobes.parameter_dict import get_parameters, outside_bounds, with_parameters
from torchbrdf.lobes.sum import Sum
from torchbrdf.lobes.zoo import is_zoo, zoo_record
from torchbrdf.names import check_name
from torchbrdf.pairs import Pairs
from torchbrdf.reading import read_json

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
# Of a model, in 1/sr: beyond what any surface reflects.
LARGEST_VALUE = 1e20
# Models whose values are looked at together.
_CHECKED = 1000


class OutsideBoundsWarning(UserWarning):
    """A file of fits has parameters that no fit would end at; they are kept as they are.

    Example:
        >>> import warnings
        >>> warnings.simplefilter("ignore", OutsideBoundsWarning)
    """


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


def read_fits(path: Path | str, bad: list[DataError] | None = None) -> list[FitRecord]:
    """Read and check fits. Parameters outside their bounds are kept, with an `OutsideBoundsWarning`.

    Args:
        path: A `fits.json`, or the folder of `torchbrdf fit`; or a name in the zoo, such as `zoo:nickel`, for its one
            record.
        bad: A list that takes the errors of bad records, so that the others are read; None raises the first.

    Returns:
        Its records; `model_of` makes models of those with one kind and number of lobes.

    Raises:
        DataError: It cannot be read, holds no list of fits, or, where `bad` is None, one that is none or whose values
            are not finite; says where and what was expected.

    Example:
        >>> from torchbrdf.measured import standins
        >>> [record.material for record in read_fits(standins())][:3]
        ['alum-bronze', 'aluminium', 'blue-acrylic']
    """
    found: dict[int, FitRecord] = {}
    errors: dict[int, DataError] = {}
    places: list[str] = []
    for k, (where, record) in enumerate(_listed(path, bad)):
        places.append(where)
        try:
            found[k] = FitRecord.from_json(record, where)
        except DataError as error:
            if bad is None:
                raise
            errors[k] = error
    for k in _not_finite(found):
        errors[k] = DataError(f"{places[k]}: parameters of {found[k].model}: {_why_not_finite(found.pop(k))}")
        if bad is None:
            raise errors[k]
    kept = list(found.values())
    if bad is None:
        _warn_outside(path, kept)
    else:  # whoever takes what is bad one by one sees to parameters, too
        bad += [errors[k] for k in sorted(errors)]
    return kept


def _listed(path: Path | str, bad: list[DataError] | None) -> Iterator[tuple[str, dict[str, Any]]]:
    """The records that a path names as they are written, each with where it is."""
    from torchbrdf.lobes.parts import FITS, FitFolder, fit_folder  # late: it makes records

    folder = None if is_zoo(path) else fit_folder(Path(path))
    records: Iterable[tuple[str, dict[str, Any]]]
    if folder is not None:
        records = FitFolder(folder).every(bad)
    elif is_zoo(path):
        records = [(f"{path}: fit 0", zoo_record(path))]
    else:
        path = Path(path) / FITS if Path(path).is_dir() else path
        found: list[dict[str, Any]] = read_json(path, list[dict[str, Any]], "a list of fits")
        records = ((f"{path}: fit {k}", record) for k, record in enumerate(found))
    is_empty = True
    for one in records:
        is_empty = False
        yield one
    if is_empty and not bad:
        raise DataError(f"{path}: expected a list of fits, found an empty one")


def _warn_outside(path: Path | str, records: Sequence[FitRecord]) -> None:
    """One line for a file with parameters outside their bounds."""
    models = [record.to_model(torch.float64) for record in records]
    outside = [
        (record.material, said) for record, model in zip(records, models, strict=True) for said in outside_bounds(model)
    ]
    if outside:
        material, said = outside[0]
        rest = f" (the first of {len(outside)})" if len(outside) > 1 else ""
        warnings.warn(
            f"{path}: parameters outside their bounds are kept as they are: {said}, of {material}{rest}",
            OutsideBoundsWarning,
            stacklevel=3,
        )


def _not_finite(records: Mapping[int, FitRecord]) -> list[int]:
    """The records whose models' values are not finite: nothing could be done with them.

    In either precision: a lobe that is far too narrow overflows in float32 only.
    """
    kinds: dict[tuple[str, int, int], list[int]] = {}
    for k, record in records.items():
        kinds.setdefault((record.model, record.lobes, record.channels), []).append(k)
    bad: set[int] = set()
    for rows in (own[k : k + _CHECKED] for own in kinds.values() for k in range(0, len(own), _CHECKED)):
        model = model_of([records[k] for k in rows], torch.float64)
        for dtype in (torch.float64, torch.float32):
            with torch.no_grad():
                values = model.to(dtype)(_probes().to(dtype=dtype))
            finite = (values.abs() <= LARGEST_VALUE).flatten(1).all(-1)
            bad |= {k for k, good in zip(rows, finite.tolist(), strict=True) if not good}
    return sorted(bad)


def _why_not_finite(record: FitRecord) -> str:
    """What was expected and found: a parameter outside its bounds, where there is one, is what can be mended."""
    outside = outside_bounds(record.to_model(torch.float64))
    if outside:
        every = "; ".join(outside[:4])
        return f"expected them within their bounds, found {every}, with which values are not finite"
    limit = f"{LARGEST_VALUE:g} / sr"
    return f"expected those of a model with values of at most {limit}, found others for {record.material}"


def _probes() -> Pairs:
    """Pairs all over the hemisphere, the normal, the mirror's direction and the horizon among them, `(1, N)`."""
    steps = torch.linspace(0, 1, 7, dtype=torch.float64, device="cpu")
    theta_h, theta_d, phi_d = (part.reshape(1, -1) for part in torch.meshgrid(steps**2, steps, steps, indexing="ij"))
    phi_h = torch.arange(theta_h.shape[1], dtype=torch.float64, device="cpu")  # all round, in no order
    return Pairs.from_half_diff(theta_h * (math.pi / 2), theta_d * (math.pi / 2) * 0.999, phi_d * math.pi, phi_h)


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
