"""What a fit found, and its files."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import Tensor

from torchbrdf.files import csv_text, write_text
from torchbrdf.fitting.intervals import LEVEL, Intervals
from torchbrdf.fitting.strategy import Stage
from torchbrdf.lobes import FitRecord, Lobe, model_name, parameters, write_fits
from torchbrdf.lobes.in_bands import channels_of
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names, with_parameters
from torchbrdf.solvers import Status


@dataclass
class FitResult:
    """One model fitted to M materials under one loss.

    Args:
        names: Of the materials.
        model: Batched, with the parameters that were found.
        loss: Registered name of the loss.
        strategy: Registered name of the strategy.
        diffuse: `45:0`, where the diffuse albedo was measured and held, or `fit`.
        error: On every valid sample within `max_theta`, `(M,)`, float64.
        subset_error: On the samples that the solver saw, `(M,)`, float64.
        status: Whether the solver converged, of each material.
        reason: Why it did not; empty where it did.
        starts: How many starts the strategy tried.
        ties: How many other minima of each material came within 1 % of the best on the subset.
        seconds: Of the whole batch.
        max_theta: Largest angle from the normal of the pairs that counted, in degrees.
        samples: How many pairs the solver saw; None: every one.
        seed: Of the subset.
        scene: What a rendered loss saw.
        chosen: Of each material, the loss whose fit was kept, where the strategy fits under several; else empty.
        intervals: 95 % intervals of the parameters by the method that gave them.
        wavelengths: Of the bands that were fitted, nm; None of linear RGB, and where nobody knows them.
        reading: Of each material, how its file was read.
        noise: Of each material's samples, and the error that it alone makes.
        undetermined: Of each number of the fitted parameters, whether the error leaves it open; see `undetermined`.
        history: The stages.

    Example:
        >>> from torchbrdf import fit, load
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import RMSLoss
        >>> from torchbrdf.measured import standins
        >>> nylon = load(standins()).batch([7])
        >>> result = fit(make_model("ward", 1), nylon, RMSLoss(), samples=200, max_theta=20)
        >>> [(record.material, record.status) for record in result.records()]
        [('nylon', 'converged')]
    """

    names: list[str]
    model: Lobe
    loss: str
    strategy: str
    diffuse: str
    error: Tensor
    subset_error: Tensor
    status: list[Status]
    reason: list[str]
    starts: int
    ties: list[int]
    seconds: float
    max_theta: float
    samples: int | None
    seed: int
    scene: str = ""
    chosen: list[str] = field(default_factory=list)
    intervals: dict[str, Intervals] = field(default_factory=dict)
    wavelengths: tuple[float, ...] | None = None
    reading: list[dict[str, Any]] = field(default_factory=list)
    noise: list[dict[str, Any]] = field(default_factory=list)
    undetermined: ParameterDict = field(default_factory=dict)
    history: list[Stage] = field(default_factory=list)

    def records(self) -> list[FitRecord]:
        """One record a material, as `fits.json` holds them."""
        name, lobes = model_name(self.model)
        ends = {
            method: {"low": with_parameters(self.model, both.low), "high": with_parameters(self.model, both.high)}
            for method, both in self.intervals.items()
        }
        return [
            FitRecord(
                material=material,
                model=name,
                lobes=lobes,
                parameters=parameters(self.model, k),
                loss=self.loss,
                strategy=self.strategy,
                error=self.error[k].item(),
                subset_error=self.subset_error[k].item(),
                status=str(self.status[k]),
                reason=self.reason[k],
                starts=self.starts,
                ties=self.ties[k],
                at_bounds=at_bounds(self.model, k, self.diffuse == "fit"),
                undetermined=self._open(k),
                seconds=self.seconds / len(self.names),
                max_theta=self.max_theta,
                samples=self.samples,
                seed=self.seed,
                scene=self.scene,
                chosen=self.chosen[k] if self.chosen else "",
                diffuse=self.diffuse,
                intervals=_plain_intervals(ends, k),
                channels=channels_of(self.model),
                wavelengths=None if self.wavelengths is None else list(self.wavelengths),
                reading=self.reading[k] if self.reading else {},
                noise=self.noise[k] if self.noise else {},
                iterations=sum(stage.iterations[k] for stage in self.history),
            )
            for k, material in enumerate(self.names)
        ]

    def _open(self, material: int) -> list[str]:
        """One material's parameters that are not determined, by their labels, such as `roughness[1]`."""
        names = component_names(self.model)
        found = {name for name, truths in self.undetermined.items() if truths[material].any()}
        return list(dict.fromkeys(label for k, name, label in _labels(self.model) if names[k][name] in found))

    def save(self, path: Path | str) -> None:
        """Write `fits.json`, of which `torchbrdf.read_fits` gives the records, and `torchbrdf.model_of` their model."""
        write_fits(path, self.records())


def _plain_intervals(ends: dict[str, dict[str, Lobe]], material: int) -> dict[str, Any]:
    """One material's intervals, as `fits.json` has them; nothing where there is not one."""
    found = {
        method: {end: _with_null(parameters(model, material)) for end, model in both.items()}
        for method, both in ends.items()
    }
    found = {
        method: both
        for method, both in found.items()
        if any(value is not None for value in _flat(both["low"]).values())
    }
    return {"level": LEVEL} | found if found else {}


def _with_null(value: Any) -> Any:
    """None in the place of nan."""
    if isinstance(value, dict):
        return {key: _with_null(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_null(item) for item in value]
    return None if value is None or value != value else value


def at_bounds(model: Lobe, material: int, diffuse: bool) -> list[str]:
    """Which fitted parameters ended at a bound, such as `roughness[1] = 0.5` for the second lobe's."""
    found: list[str] = []
    for k, name, label in _labels(model):
        component = model.components()[k]
        if component.is_diffuse and not diffuse:
            continue
        spec = component.parameter_specs[name]
        close = 1e-6 * max(abs(spec.lower), abs(spec.upper))
        low, high = spec.lower + min(close, 1e-3 * abs(spec.lower)), spec.upper - close
        values = getattr(component, name)[material].flatten().tolist()
        # Channels at the same bound are said once.
        found += dict.fromkeys(f"{label} = {value:g}" for value in values if value <= low or value >= high)
    return found


def _labels(model: Lobe) -> Iterator[tuple[int, str, str]]:
    """Of each parameter its component, its name there, and what people are told it by, as `roughness[1]`."""
    count = -1
    for k, component in enumerate(model.components()):
        count += not component.is_diffuse
        for name, spec in component.parameter_specs.items():
            label = name if component.is_material else f"{name}[{count}]"
            if component.is_diffuse:
                label = "diffuse" if spec.is_colour else f"diffuse_{name}"
            yield k, name, label


def write_fits_csv(path: Path | str, records: Iterable[FitRecord]) -> None:
    """Write records as CSV, one column a number: `roughness_1` is that of the second lobe.

    Args:
        path: The file.
        records: Of fits, of any models.
    """
    write_text(path, fits_csv(records))


def fits_csv(records: Iterable[FitRecord]) -> str:
    """The text that `write_fits_csv` writes."""
    return flat_csv([record.to_json() for record in records])


def flat_csv(records: Iterable[dict[str, Any]]) -> str:
    """The same of records as they are written."""
    return csv_text([flat_record(record) for record in records])


def flat_record(record: Any) -> dict[str, Any]:
    """A record, as it is written, as columns: a number each."""
    return _flat(record)


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    if isinstance(value, dict):
        items = value.items()
        return {
            k: v
            for key, item in items
            for k, v in _flat(item, key if name in ("", "parameters") else f"{name}_{key}").items()
        }
    if isinstance(value, list):
        return {k: v for i, item in enumerate(value) for k, v in _flat(item, f"{name}_{i}").items()}
    return {name: value}
