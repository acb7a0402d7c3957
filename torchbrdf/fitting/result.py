"""What a fit found, and its files."""

import csv
import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.files import write_text
from torchbrdf.fitting.strategy import Stage
from torchbrdf.lobes import Lambert, Lobe, model_name, model_of, number, parameters, read_fits, write_fits
from torchbrdf.losses import LOSSES
from torchbrdf.solvers import Status


@dataclass
class FitResult:
    """One model fitted to M materials under one loss.

    `model` is batched; `error` is scored on every valid sample within `max_theta`, `subset_error` on the samples that
    the solver saw, `(M,)` each; `status` says of each material whether the solver converged, and `reason` why not;
    `scene` says what a rendered loss saw; `starts` is how many starts the strategy tried, `ties` how many other minima
    of each material came within 1 % of the best on the subset; `history` has the stages. `seconds` is the time of the
    whole batch.
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
    history: list[Stage] = field(default_factory=list)

    def records(self) -> list[dict[str, Any]]:
        """One plain dictionary a material, as in `fits.json`."""
        name, lobes = model_name(self.model)
        return [
            {
                "material": material,
                "model": name,
                "lobes": lobes,
                "loss": self.loss,
                "strategy": self.strategy,
                "error": self.error[k].item(),
                "subset_error": self.subset_error[k].item(),
                "status": str(self.status[k]),
                "reason": self.reason[k],
                "starts": self.starts,
                "ties": self.ties[k],
                "at_bounds": at_bounds(self.model, k, self.diffuse == "fit"),
                "seconds": self.seconds / len(self.names),
                "max_theta": self.max_theta,
                "samples": self.samples,
                "seed": self.seed,
                **({"scene": self.scene} if self.scene else {}),
                "diffuse": self.diffuse,
                "iterations": sum(stage.iterations[k] for stage in self.history),
                "parameters": parameters(self.model, k),
            }
            for k, material in enumerate(self.names)
        ]

    def save(self, path: Path | str) -> None:
        """Write `fits.json`: a list of `records`."""
        write_fits(path, self.records())

    @classmethod
    def load(cls, path: Path | str) -> "FitResult":
        """Read what `save` wrote; the stages are not kept in the file."""
        records = read_fits(path)
        common = ("model", "lobes", "loss", "strategy", "diffuse", "max_theta", "samples", "seed")
        mixed = [key for key in common if len({record[key] for record in records}) != 1]
        if mixed:
            raise DataError(f"{path}: expected the fits of one model under one loss, found several: {', '.join(mixed)}")
        first = records[0]
        return cls(
            names=[record["material"] for record in records],
            model=model_of(records),
            loss=LOSSES.canonical(first["loss"]),
            strategy=first["strategy"],
            diffuse=first["diffuse"],
            error=torch.tensor([number(record["error"]) for record in records], dtype=torch.float64),
            subset_error=torch.tensor([number(record["subset_error"]) for record in records], dtype=torch.float64),
            status=[Status(record["status"]) for record in records],
            reason=[record.get("reason", "") for record in records],
            starts=first.get("starts", 1),
            ties=[record.get("ties", 0) for record in records],
            seconds=sum(record["seconds"] for record in records),
            max_theta=first["max_theta"],
            samples=first["samples"],
            seed=first["seed"],
            scene=first.get("scene", ""),
        )


def at_bounds(model: Lobe, material: int, diffuse: bool) -> list[str]:
    """Which fitted parameters ended at a bound, such as `roughness[1] = 0.5` for the second lobe's."""
    lower, upper = model.bounds
    packed = model.pack()[material]
    count = -1
    found: list[str] = []
    names: list[str | None] = []
    for part in model.parts():
        held = isinstance(part, Lambert)
        count += not held
        for name, bounded in part.declared.items():
            names += [None if held and not diffuse else "diffuse" if held else f"{name}[{count}]"] * bounded.size
    for label, value, low, high in zip(names, packed.tolist(), lower.tolist(), upper.tolist(), strict=True):
        close = 1e-6 * max(abs(low), abs(high))
        if label and (value <= low + min(close, 1e-3 * abs(low)) or value >= high - close):
            text = f"{label} = {value:g}"
            found += [text] if text not in found else []
    return found


def write_csv(path: Path | str, records: list[dict[str, Any]]) -> None:
    """Write records flat: one column a number."""
    rows = [_flat(record) for record in records]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


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
