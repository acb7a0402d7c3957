"""Fits of a grid that is not finished: parts of them, as `torchbrdf fit` writes, until `fits.json` has them all."""

import logging
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError
from torchbrdf.lobes import FitRecord
from torchbrdf.lobes.parts import MANIFEST, FitFolder, Input, settings_hash

FOLDER = "unfinished"
# What fits of one folder of parts have in common, by the fields of their records.
SHARED = ("model", "loss", "lobes", "strategy")

log = logging.getLogger("torchbrdf")


@dataclass(frozen=True)
class Unfinished:
    """The fits that a run has made since `fits.json` was written.

    Args:
        path: The folder of the run.

    Example:
        >>> import tempfile
        >>> from torchbrdf.lobes import Lambert, Sum, Ward, parameters
        >>> record = FitRecord("paint", "ward", 1, parameters(Sum(Lambert(), Ward())), loss="rms", strategy="global")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     Unfinished(Path(folder)).add([record])
        ...     [(one.material, one.loss) for one in Unfinished(Path(folder)).records()]
        [('paint', 'rms')]
    """

    path: Path

    def add(self, records: Sequence[FitRecord]) -> None:
        """Keep fits of the same materials, of one model by one strategy; those of one loss become a part."""
        for loss in dict.fromkeys(record.loss for record in records):
            own = [record for record in records if record.loss == loss]
            settings: dict[str, Any] = {name: getattr(own[0], name) for name in SHARED}
            folder = FitFolder(self.path / FOLDER / settings_hash(settings))
            manifest = folder.register(settings, [[Input(record.material) for record in own]])
            folder.add(manifest.place[own[0].material][0], own)

    def records(self) -> Iterator[FitRecord]:
        """What is kept; parts that are bad are left out, and said, so that their fits are made again."""
        for manifest in sorted((self.path / FOLDER).glob(f"*/{MANIFEST}")):
            bad: list[DataError] = []
            try:
                for where, line in FitFolder(manifest.parent).every(bad):
                    yield FitRecord.from_json(line, where)
            except DataError as error:
                bad.append(error)
            for one in bad:
                log.warning("torchbrdf: %s; its fits are made again", one)
            if bad:
                shutil.rmtree(manifest.parent)

    def remove(self) -> None:
        """Remove all of it: `fits.json` has it."""
        shutil.rmtree(self.path / FOLDER, ignore_errors=True)
