"""A whole database, batch after batch, each written as it is done."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.fitting.fit import fit
from torchbrdf.fitting.result import write_csv
from torchbrdf.fitting.strategy import strategy_name
from torchbrdf.lobes import Lobe, model_name, read_fits, write_fits
from torchbrdf.losses import LOSSES, Loss, as_loss
from torchbrdf.measured import Measured

# Materials of a batch for each core: few enough that little is lost when it is stopped.
SIZE = 4


class Batches:
    """Fit one model under one loss to any number of materials, with `fits.json` and `fits.csv` in a folder.

    Materials that the folder's `fits.json` holds already, with the same settings, are not fitted again.

    Args:
        model: as of `fit`.
        loss: as of `fit`.
        out: the folder; None: nothing is written.
        settings: the other arguments of `fit`.

    Raises:
        DataError: if the folder holds fits with other settings, so that nothing is mixed.

    Example:
        >>> import torch
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import RMSLoss
        >>> from torchbrdf.measured import load, standins
        >>> some = load(standins()).batch([0, 6], torch.arange(0, 900_000, 1000))
        >>> records = Batches(make_model("ward", 1), RMSLoss(), samples=None).run([some])
        >>> [record["material"] for record in records]
        ['alum-bronze', 'nickel']
    """

    def __init__(
        self, model: Lobe, loss: Loss | Callable[..., Tensor], *, out: Path | None = None, **settings: Any
    ) -> None:
        self.model, self.loss, self.out, self.settings = model, as_loss(loss), out, settings
        self.done: dict[str, dict[str, Any]] = {}
        if out is not None and (out / "fits.json").exists():
            for record in read_fits(out / "fits.json"):
                self._check(record)
                self.done[record["material"]] = record

    def run(self, groups: Sequence[Measured], progress: Callable[[int], None] | None = None) -> list[dict[str, Any]]:
        """The records of all materials, in their order."""
        names = [name for group in groups for name in group.names]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice and self.out is not None:
            raise DataError(f"{twice[0]}: comes twice; give each file a name of its own")
        found: list[dict[str, Any]] = []
        for group in groups:
            left = [k for k, name in enumerate(group.names) if name not in self.done]
            if progress is not None:
                progress(len(group) - len(left))
            size = SIZE * torch.get_num_threads()
            made: dict[int, dict[str, Any]] = {}
            for start in range(0, len(left), size):
                rows = left[start : start + size]
                result = fit(self.model, group.batch(rows), self.loss, **self.settings, progress=progress)
                made |= zip(rows, result.records(), strict=True)
                self._write(made)
            found += [made[k] if k in made else self.done[name] for k, name in enumerate(group.names)]
        return found

    def _write(self, made: dict[int, dict[str, Any]]) -> None:
        if self.out is not None:
            self.done |= {record["material"]: record for record in made.values()}
            write_fits(self.out / "fits.json", list(self.done.values()))
            write_csv(self.out / "fits.csv", list(self.done.values()))

    def _check(self, record: dict[str, Any]) -> None:
        model, lobes = model_name(self.model)
        wanted = {"model": model, "lobes": lobes, "loss": self.loss.registered_name, **self.settings}
        wanted["scene"] = self.loss.scene_summary or None
        if record.get("samples") is None:  # every pair: as asked for, or because there were no more
            wanted["samples"] = None
        record = {**record, "loss": LOSSES.canonical(record.get("loss", ""))}
        if "strategy" in wanted:
            wanted["strategy"] = strategy_name(wanted["strategy"])
        for key in ("model", "lobes", "loss", "strategy", "diffuse", "max_theta", "samples", "seed", "scene"):
            if key in wanted and record.get(key) != wanted[key]:
                raise DataError(
                    f"{self.out}/fits.json: {record['material']} was fitted with {key} {record.get(key)}, not "
                    f"{wanted[key]}; give another folder"
                )
