"""A whole database, batch after batch, each written as it is done."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, shown
from torchbrdf.files import destination, locked, write_text
from torchbrdf.fitting.api import diffuse_mode, fit
from torchbrdf.fitting.known import KnownMaterials
from torchbrdf.fitting.result import fits_csv
from torchbrdf.fitting.strategy import strategy_name
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import FitRecord, Lobe, model_name, read_fits, write_fits
from torchbrdf.losses import LOSSES, Loss, as_loss
from torchbrdf.measured import Measured
from torchbrdf.measured.bands import bands_in_words
from torchbrdf.progress import Progress, part_of, quiet
from torchbrdf.solvers import Status

# Materials of a batch for each core: few enough that little is lost when it is stopped.
SIZE = 4
FITS = "fits.json"
# Seconds; others hold the lock for as long as it takes to write the folder's two files.
LOCK_WAIT = 60.0


def _done(records: dict[str, FitRecord]) -> dict[str, FitRecord]:
    """Those that need not be made again."""
    return {name: record for name, record in records.items() if record.status != Status.LOST}


class Batches:
    """Fit one model under one loss to any number of materials, with `fits.json` and `fits.csv` in a folder.

    Materials that the folder's `fits.json` holds already, with the same settings, are not fitted again, but those whose
    process died are. Several processes may add to one folder at the same time.

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
        self.model, self.loss, self.out = model, as_loss(loss), out
        self.settings = settings | {"diffuse": diffuse_mode(settings.get("diffuse"), self.loss, model)}
        self._may_be_fitted = settings.get("diffuse") is None  # where there is no 45:0 reading
        self.stored = self._read()

    @property
    def done(self) -> dict[str, FitRecord]:
        """The fits that need not be made again, by material."""
        return _done(self.stored)

    def _read(self) -> dict[str, FitRecord]:
        """What the folder holds, by material."""
        if self.out is None or not (self.out / FITS).exists():
            return {}
        records = read_fits(self.out / FITS)
        for record in records:
            self._check(record)
        return {record.material: record for record in records}

    def run(self, groups: Sequence[Measured], progress: Progress = quiet) -> list[FitRecord]:
        """The records of all materials, in their order.

        Raises:
            DataError: Two materials have the same name, and the fits are to be written; or the folder has fits of
                another material of a name.
        """
        names = [name for group in groups for name in group.names]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice and self.out is not None:
            raise DataError(f"{twice[0]}: comes twice; give each file a name of its own")
        for group in groups:
            self._check_bands(group)
        if self.out is not None:
            known = KnownMaterials(self.out)
            for group in groups:
                for k, name in enumerate(group.names):
                    known.check(name, group.batch([k]))
            known.save()
        found: list[FitRecord] = []
        before = self.done
        for group in groups:
            left = [k for k, name in enumerate(group.names) if name not in before]
            done = len(found) + len(group) - len(left)
            progress(done, len(names))
            size = SIZE * torch.get_num_threads()
            made: dict[int, FitRecord] = {}
            for start in range(0, len(left), size):
                rows = left[start : start + size]
                part = part_of(progress, done + start, len(names))
                result = fit(self.model, group.batch(rows), self.loss, **self.settings, progress=part)
                new = result.records()
                made |= zip(rows, new, strict=True)
                self._add(new)
            found += [made[k] if k in made else before[name] for k, name in enumerate(group.names)]
        self._add([])
        return found

    def _check_bands(self, group: Measured) -> None:
        """Refuse fits of before that are of other bands."""
        for record in (self.stored[name] for name in group.names if name in self.stored):
            lengths = None if record.wavelengths is None else tuple(record.wavelengths)
            if (record.channels, lengths) != (group.channels, group.wavelengths):
                had, now = bands_in_words(record.channels, lengths), bands_in_words(group.channels, group.wavelengths)
                where = f"{self.out}/fits.json: {record.material}"
                raise DataError(f"{where} was fitted in {had}, not {now}; give another folder")

    def _add(self, records: list[FitRecord]) -> None:
        """Write records beside what the folder holds by now: other processes may have added theirs."""
        if self.out is None:
            return
        # Where fits.json is a link, others may know its folder by another name.
        with locked(destination(self.out / FITS).parent, wait=LOCK_WAIT):
            there = self._read()
            new = {record.material: record for record in records if record.material not in _done(there)}
            self.stored = there | {name: one for name, one in self.stored.items() if name not in there} | new
            kept = list(self.stored.values())
            if new:
                write_fits(self.out / FITS, kept)
            table, text = destination(self.out / "fits.csv"), fits_csv(kept)
            # It is missing, or an old one, where a process was killed before it wrote it.
            if kept and not (table.exists() and table.read_bytes() == text.encode()):
                write_text(table, text)

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
            if key == "diffuse" and self._may_be_fitted and record.diffuse == "fit":
                continue
            if key in wanted and getattr(record, key) != wanted[key]:
                had = shown(getattr(record, key)) if getattr(record, key) != "" else "that the file does not say"
                raise DataError(
                    f"{self.out}/fits.json: {record.material} was fitted with {key} {had}, not {shown(wanted[key])}; "
                    "give another folder"
                )
