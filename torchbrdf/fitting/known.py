"""Which materials a folder has fits of: names alone may be those of others."""

import hashlib
from pathlib import Path

import torch

from torchbrdf.errors import DataError
from torchbrdf.files import locked, write_json
from torchbrdf.measured import Measured
from torchbrdf.reading import read_json

MATERIALS = "materials.json"
# Samples that tell a table from another: one in so many of the first, where a MERL table has the highlight and is
# read in a moment.
_FIRST, _STEP = 20_000, 10


class KnownMaterials:
    """The materials that a folder has fits of, by digests of their values, in `materials.json`.

    Args:
        folder: Where; None keeps nothing, and tells materials of one name apart all the same.

    Raises:
        DataError: The file there is none of ours.

    Example:
        >>> from torchbrdf.measured import load, standins
        >>> known, both = KnownMaterials(None), load(standins())
        >>> known.check("nickel", both.batch([6]))
        >>> known.check("nickel", both.batch([7]))
        Traceback (most recent call last):
        torchbrdf.errors.DataError: nickel: expected the material of before, found another of that name
    """

    def __init__(self, folder: Path | None) -> None:
        self.path = None if folder is None else folder / MATERIALS
        self.digests = self._read()

    def _read(self) -> dict[str, str]:
        if self.path is None or not self.path.exists():
            return {}
        found: dict[str, str] = read_json(self.path, dict[str, str], "digests of materials")
        return found

    def check(self, name: str, measured: Measured) -> None:
        """Refuse a material if the folder's fits of that name are of another one.

        Args:
            name: Of the material.
            measured: The material.

        Raises:
            DataError: They are.
        """
        own = digest(measured)
        if self.digests.setdefault(name, own) != own:
            if self.path is None:
                raise DataError(f"{name}: expected the material of before, found another of that name")
            raise DataError(f"{name}: expected the material that {self.path} has, found another; give another folder")

    def save(self) -> None:
        """Write what is known now, beside what other processes found."""
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with locked(self.path.parent, wait=60.0):
                write_json(self.path, self._read() | self.digests)


def digest(measured: Measured) -> str:
    """A digest of the values of one material.

    Args:
        measured: The material.

    Example:
        >>> from torchbrdf.measured import load, standins
        >>> digest(load(standins()).batch([6])) == digest(load(standins()).batch([7]))
        False
    """
    count = len(measured.source.pairs if measured.samples is None else measured.samples)
    every = torch.arange(count, dtype=torch.int64, device="cpu")
    if not measured.on_merl_bins:  # without what a group of files of many sizes pads it with
        every = every[measured.weight[0, :, 0].cpu() > 0]
    some = every[:_FIRST:_STEP]
    values = measured.batch([0], some).values.float().cpu()
    return hashlib.sha256(values.numpy().tobytes()).hexdigest()[:16]
