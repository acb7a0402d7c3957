"""A whole database, batch after batch, each written as it is done."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.fitting.api import fit
from torchbrdf.fitting.result import write_fits_csv
from torchbrdf.fitting.strategy import strategy_name
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import FitRecord, Lobe, model_name, read_fits, write_fits
from torchbrdf.losses import LOSSES, Loss, as_loss
from torchbrdf.measured import Measured
from torchbrdf.progress import Progress, part_of, quiet

# Materials of a batch for each core: few enough that little is lost when it is stopped.
SIZE = 4


class Batches:
    """Fit one model under one loss to any number of materials, with `fits.json` and `fits.csv` in a folder.

    Materials that the folder's `fits.json` holds already, with the same settings, are not fitted again.

    Args:
        model: Where every fit starts.
        loss: What is minimised.
        out: The folder; None writes nothing.
        settings: Those of `fit`.

    Raises:
        DataError: The folder holds fits with other settings: nothing is mixed.

    Example:
        >>> from torchbrdf import load
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import RMSLoss
        >>> from torchbrdf.measured import standins
        >>> batches = Batches(make_model("ward", 1), RMSLoss(), samples=200, max_theta=20)
        >>> [record.material for record in batches.run([load(standins()).batch([6, 7])])]
        ['nickel', 'nylon']
    """

    def __init__(
        self, model: Lobe, loss: Loss | Callable[..., Tensor], *, out: Path | None = None, **settings: Any
    ) -> None:
        self.model, self.loss, self.out, self.settings = model, as_loss(loss), out, settings
        self.done: dict[str, FitRecord] = {}
        if out is not None and (out / "fits.json").exists():
            for record in read_fits(out / "fits.json"):
                self._check(record)
                self.done[record.material] = record

    def run(self, groups: Sequence[Measured], progress: Progress = quiet) -> list[FitRecord]:
        """The records of all materials, in their order.

        Raises:
            DataError: Two materials have the same name, and the fits are to be written.
        """
        names = [name for group in groups for name in group.names]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice and self.out is not None:
            raise DataError(f"{twice[0]}: comes twice; give each file a name of its own")
        found: list[FitRecord] = []
        for group in groups:
            left = [k for k, name in enumerate(group.names) if name not in self.done]
            done = len(found) + len(group) - len(left)
            progress(done, len(names))
            size = SIZE * torch.get_num_threads()
            made: dict[int, FitRecord] = {}
            for start in range(0, len(left), size):
                rows = left[start : start + size]
                part = part_of(progress, done + start, len(names))
                result = fit(self.model, group.batch(rows), self.loss, **self.settings, progress=part)
                made |= zip(rows, result.records(), strict=True)
                self._write(made)
            found += [made[k] if k in made else self.done[name] for k, name in enumerate(group.names)]
        return found

    def _write(self, made: dict[int, FitRecord]) -> None:
        if self.out is not None:
            self.done |= {record.material: record for record in made.values()}
            write_fits(self.out / "fits.json", list(self.done.values()))
            write_fits_csv(self.out / "fits.csv", list(self.done.values()))

    def _check(self, record: FitRecord) -> None:
        model, lobes = model_name(self.model)
        wanted = {"model": model, "lobes": lobes, "loss": self.loss.registered_name, **self.settings}
        wanted["scene"] = self.loss.scene_summary
        if record.samples is None:  # every pair: as asked for, or because there were no more
            wanted["samples"] = None
        former = record.loss.removeprefix("rendered_")
        own = LOSSES.canonical(former) if former == record.loss else f"rendered_{DIFFERENCES.canonical(former)}"
        record = replace(record, loss=own)
        if "strategy" in wanted:
            wanted["strategy"] = strategy_name(wanted["strategy"])
        for key in ("model", "lobes", "loss", "strategy", "diffuse", "max_theta", "samples", "seed", "scene"):
            if key in wanted and getattr(record, key) != wanted[key]:
                had = shown(getattr(record, key)) if getattr(record, key) != "" else "that the file does not say"
                raise DataError(
                    f"{self.out}/fits.json: {record.material} was fitted with {key} {had}, not {shown(wanted[key])}; "
                    "give another folder"
                )
