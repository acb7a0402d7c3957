"""Blocks of materials: what one core fits at a time, wherever it is."""

import hashlib
import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchbrdf.errors import DataError, ShapeError, TorchbrdfError, UsageError
from torchbrdf.fitting.api import fit
from torchbrdf.fitting.known import digest as values_digest
from torchbrdf.lobes import FitRecord, Lobe
from torchbrdf.lobes.parts import Input
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured, Samples, StandIn, Unopened

# A block has so many pairs times materials, or bytes of files: four MERL tables, which take seconds to fit.
PAIRS, BYTES = 4_000_000, 128 << 20
# Materials of a block of small ones: a tenth of the time that each takes alone is what a larger one could still save.
MOST = 512
# Blocks that the fewest materials make, so that many cores have work.
LEAST_BLOCKS = 16
# Bytes of a file that tell it from another: its first and last ones.
_HASHED = 1 << 16
FILE = "file:"

log = logging.getLogger("torchbrdf")
Group = Measured | Unopened
Judge = Callable[[Measured, list[FitRecord]], dict[str, Any]]


def block_size(group: Group) -> int:
    """How many materials of a group are fitted together: by what they are, whatever the machine.

    Args:
        group: The materials.
    """
    if isinstance(group, Unopened):
        most = int(BYTES // max(group.mean_size, 1))
    else:
        most = PAIRS // max(len(group.source.pairs if group.samples is None else group.samples), 1)
    return max(1, min(most, MOST, -(-len(group) // LEAST_BLOCKS)))


def input_of(group: Group, row: int, name: str, *, with_digest: bool = True) -> Input:
    """A material of a group as a manifest lists it.

    Args:
        group: The materials.
        row: Which of them.
        name: Of the material.
        with_digest: Whether to read what tells it from others.

    Raises:
        DataError: Its file cannot be read.
    """
    path: Path | None
    if isinstance(group, Unopened):
        path = Path(group.paths[row])
        return Input(name, file_digest(path) if with_digest else "", str(path))
    paths, at = group.source.paths, group.materials[row]
    path = Path(paths[at]) if at < len(paths) else None
    known = path if group.source.one_a_file else None
    digest = "" if not with_digest else file_digest(known) if known else values_digest(group.batch([row]))
    return Input(name, digest, str(path or ""))


def file_digest(path: Path) -> str:
    """What tells a file from another: of small ones all bytes, of others the size and some of both ends."""
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            found = hashlib.sha256(str(size).encode())
            found.update(file.read(_HASHED))
            if size > 2 * _HASHED:
                file.seek(-_HASHED, os.SEEK_END)
            found.update(file.read(_HASHED))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from None
    return FILE + found.hexdigest()[:16]


@dataclass
class Block:
    """Some materials of a group, of one part of a folder: what is sent to whoever fits them.

    Args:
        part: Its number.
        group: The materials.
    """

    part: int
    group: Group

    def singly(self) -> list["Block"]:
        """A block of each of its materials."""
        return [Block(self.part, self.group.batch([k])) for k in range(len(self.group))]

    def __getstate__(self) -> dict[str, Any]:
        """Of what is in memory only these materials."""
        group = self.group
        if isinstance(group, Measured) and type(group.source) in (Samples, StandIn):
            source = group.source.select(group.materials)  # type: ignore[attr-defined]
            group = Measured(source, None, group.samples, group.max_theta, group.dtype, group.device)
        return {"part": self.part, "group": group}


@dataclass
class Fitted:
    """What came of a block.

    Args:
        records: Its fits.
        left_out: Why there are none of its other materials.
        judged: What the judge says of them, by material.
    """

    records: list[FitRecord]
    left_out: list[DataError]
    judged: dict[str, Any] = field(default_factory=dict)


@dataclass
class FitBlock:
    """The fits of blocks.

    Args:
        model: Where every fit starts.
        loss: What is minimised.
        settings: Those of `fit`.
        judge: What is asked of materials and their fits while their values are there; a function of a module.
    """

    model: Lobe
    loss: Loss
    settings: dict[str, Any]
    judge: Judge | None = None

    def __call__(self, block: Block) -> Fitted:
        """The fits of a block; one that fails leaves the others be.

        Args:
            block: The materials.

        Raises:
            UsageError: A setting is none.
            ShapeError: Model, loss and values do not fit together.
        """
        bad: list[DataError] = []
        opened = block.group.opened(bad) if isinstance(block.group, Unopened) else [block.group]
        found = Fitted([], bad)
        for measured in opened:
            own = self._fitted(measured)
            found.records += own.records
            found.left_out += own.left_out
            if self.judge is not None and own.records:
                found.judged |= self.judge(measured, own.records)
        return found

    def _fitted(self, measured: Measured) -> Fitted:
        try:
            return Fitted(fit(self.model, measured.batch(), self.loss, **self.settings).records(), [])
        except (UsageError, ShapeError):
            raise
        except Exception as error:  # whatever one of a million materials may bring about
            log.debug("torchbrdf: %s: not fitted", ", ".join(measured.names), exc_info=True)
            if len(measured) == 1:
                return Fitted([], [_said(measured.names[0], error)])
        alone = [self._fitted(measured.batch([k])) for k in range(len(measured))]
        return Fitted([one for own in alone for one in own.records], [one for own in alone for one in own.left_out])


def _said(name: str, error: Exception) -> DataError:
    if isinstance(error, TorchbrdfError):
        said = str(error)
        return DataError(said if said.startswith(name) else f"{name}: {said}")
    return DataError(f"{name}: the fit failed: {type(error).__name__}: {error}")


def check_distinct(groups: Sequence[Group]) -> None:
    """Refuse materials of one name, of which only one could be written.

    Args:
        groups: The materials.

    Raises:
        DataError: There are some.
    """
    names: set[str] = set()
    for name in (name for group in groups for name in group.names):
        if name in names:
            raise DataError(f"{name}: comes twice; give each file a name of its own")
        names.add(name)
