"""A whole database, block after block, each written as it is done."""

import inspect
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, TorchbrdfError, shown
from torchbrdf.executors import Place, side_by_side
from torchbrdf.fitting.api import diffuse_mode, fit
from torchbrdf.fitting.blocks import FILE, Block, FitBlock, Fitted, Group, Judge, block_size, check_distinct, input_of
from torchbrdf.fitting.known import MATERIALS, digest
from torchbrdf.fitting.strategy import strategy_name
from torchbrdf.fitting.tables import write_tables
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import FitRecord, Lobe, model_name, parameters, read_fits
from torchbrdf.lobes.parts import FITS, FitFolder, Input, Manifest
from torchbrdf.losses import LOSSES, Loss, as_loss
from torchbrdf.measured import Measured, Unopened
from torchbrdf.measured.bands import bands_in_words
from torchbrdf.parallel import Lost
from torchbrdf.progress import Progress, quiet
from torchbrdf.reading import read_json
from torchbrdf.solvers import Status

log = logging.getLogger("torchbrdf")
# Settings of a fit that all fits of a folder share.
SHARED = ("strategy", "diffuse", "max_theta", "samples", "seed", "max_iterations")
DEFAULTS = {name: one.default for name, one in inspect.signature(fit).parameters.items() if name in SHARED}
# Those that old files say of each of their fits.
OLD = ("model", "lobes", "loss", "strategy", "diffuse", "max_theta", "samples", "seed", "scene")


@dataclass
class _Work:
    """What there is to do: blocks, and of how many materials all is done."""

    blocks: list[Block] = field(default_factory=list)
    done: int = 0
    total: int = 0


class Batches:
    """Fit one model under one loss to any number of materials, and write each block of them to a folder as it is done.

    Materials that the folder has fits of already, with the same settings, are not fitted again, but those whose process
    died are. Several processes may add to one folder at the same time.

    Args:
        model: Where every fit starts.
        loss: What is minimised.
        out: The folder; None writes nothing.
        reading: What readers were told of the files, as of `torchbrdf.load`.
        judge: What is asked of materials and the fits that are made, where they are; `judged` has what it says.
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
        self,
        model: Lobe,
        loss: Loss | Callable[..., Tensor],
        *,
        out: Path | None = None,
        reading: dict[str, str] | None = None,
        judge: Judge | None = None,
        **settings: Any,
    ) -> None:
        self.judge, self.judged = judge, dict[str, Any]()
        self.model, self.loss = model, as_loss(loss)
        self.folder = None if out is None else FitFolder(out)
        self._may_be_fitted = settings.get("diffuse") is None  # where there is no 45:0 reading
        self.settings = settings | {"diffuse": diffuse_mode(settings.get("diffuse"), self.loss, model)}
        self.shared = self._shared(reading or {})
        self._old = self._read_old()
        self.earlier: dict[str, str] = {}
        """How fits ended that the folder had already, of the materials of the last `fits`."""

    def _shared(self, reading: dict[str, str]) -> dict[str, Any]:
        """What all fits of the folder have in common, as its manifest has it."""
        own = DEFAULTS | {name: value for name, value in self.settings.items() if name in SHARED}
        name, lobes = model_name(self.model)
        found = {"model": name, "lobes": lobes, "loss": self.loss.registered_name, **own}
        found |= {"strategy": strategy_name(own["strategy"]), "max_theta": float(own["max_theta"])}
        return found | {"scene": self.loss.scene_summary, "reading": dict(reading)}

    def _read_old(self) -> list[FitRecord]:
        """The fits of a folder without a manifest, which has one later; of one with a manifest, its settings' check."""
        if self.folder is None:
            return []
        if self.folder.manifest_path.exists():
            self.folder.check_settings(self.folder.manifest(), self.shared)
            return []
        path = self.folder.path / FITS
        records = read_fits(path) if path.exists() else []
        for record in records:
            self._check_old(path, record)
        return list({record.material: record for record in records}.values())

    def run(
        self,
        groups: Sequence[Group],
        progress: Progress = quiet,
        *,
        executor: Place = None,
        bad: list[DataError] | None = None,
    ) -> list[FitRecord]:
        """The records of all materials, in their order.

        Args:
            groups: The materials.
            progress: Called with how many are done.
            executor: Where they are fitted: any `concurrent.futures.Executor`; "threads" or "processes" of this
                machine; None: of these what is quicker.
            bad: Takes the errors of materials that could not be fitted; None raises the first, when the rest is done.

        Raises:
            DataError: Two materials have the same name, and the fits are to be written; or the folder has fits of
                another material of a name.
        """
        found: dict[str, FitRecord] = {}
        wrong: list[DataError] = [] if bad is None else bad
        for records in self.fits(groups, progress, executor=executor, bad=wrong):
            found |= {record.material: record for record in records}
        self.write_tables()
        if bad is None and wrong:
            raise wrong[0]
        names = [name for group in groups for name in group.names]
        found |= {record.material: record for record in self.stored(set(self.earlier))}
        return [found[name] for name in names if name in found]

    @property
    def done(self) -> dict[str, FitRecord]:
        """The fits of the folder that need not be made again, by material."""
        records = self.stored() or self._old
        return {record.material: record for record in records if record.status != Status.LOST}

    def stored(self, names: set[str] | None = None) -> list[FitRecord]:
        """The records of some materials that the folder has.

        Args:
            names: Of the materials; None: all.
        """
        if self.folder is None or not self.folder.manifest_path.exists():
            return []
        every = self.folder.every() if names is None or names else []
        return [FitRecord.from_json(line, where) for where, line in every if names is None or line["material"] in names]

    def write_tables(self, *, parquet: bool = False) -> None:
        """Write the tables of all that the folder has.

        Args:
            parquet: Whether to write `fits.parquet`, too.
        """
        if self.folder is not None and self.folder.manifest_path.exists():
            write_tables(self.folder, parquet)

    def fits(
        self,
        groups: Sequence[Group],
        progress: Progress = quiet,
        *,
        executor: Place = None,
        shard: tuple[int, int] = (1, 1),
        bad: list[DataError],
    ) -> Iterator[list[FitRecord]]:
        """The records that are made now, a block at a time, as they are done and written.

        Args:
            groups: The materials.
            progress: Called with how many are done.
            executor: As of `run`.
            shard: Which of how many shares of the parts to do, from 1.
            bad: Takes the errors of materials that could not be fitted.
        """
        groups = [group for group in groups if len(group)]
        self.earlier = {}
        try:
            work = self._in_memory(groups) if self.folder is None else self._of_folder(self.folder, groups, shard, bad)
            done = work.done
            progress(done, work.total)
            for block, fitted in self._all_fitted(work.blocks, executor):
                if self.folder is not None and fitted.records:
                    self.folder.add(block.part, fitted.records, bad=(Status.LOST,))
                bad += fitted.left_out
                self.judged |= fitted.judged
                done += len(block.group)
                progress(done, work.total)
                yield fitted.records
        except TorchbrdfError:
            self._leave_nothing_empty()
            raise
        self._leave_nothing_empty()

    def _leave_nothing_empty(self) -> None:
        """Of work that nothing came of, such as a refused model, no manifest stays that would refuse another."""
        if self.folder is not None:
            self.folder.remove_if_empty()

    def _in_memory(self, groups: Sequence[Group]) -> _Work:
        rows = [(group, rows) for group in groups for rows in _cut(range(len(group)), block_size(group))]
        total = sum(len(group) for group in groups)
        return _Work([Block(k, group.batch(own)) for k, (group, own) in enumerate(rows)], 0, total)

    def _of_folder(
        self, folder: FitFolder, groups: Sequence[Group], shard: tuple[int, int], bad: list[DataError]
    ) -> _Work:
        """What a folder lacks of materials, in a share of its parts."""
        check_distinct(groups)
        if self._old:
            self._take_up(folder)
        self._check_bands(groups)
        manifest = folder.register(self.shared, _new_blocks(groups))
        work, digests = _Work(), dict[str, str]()
        kept: dict[int, dict[str, str]] = {}
        for group in groups:
            rows: dict[int, list[int]] = {}
            for row, name in enumerate(group.names):
                part, at = manifest.place[name]
                if part % shard[1] != shard[0] - 1:
                    continue
                work.total += 1
                if part not in kept:
                    kept[part] = _statuses(folder, part, manifest)
                is_made = kept[part].get(name, Status.LOST) != Status.LOST
                try:
                    digests |= self._known(manifest.inputs[at], group, row, is_made)
                except _OtherMaterialError:
                    raise
                except DataError as error:  # the file cannot be read
                    bad.append(error)
                    work.done += 1
                    continue
                if is_made:
                    work.done += 1
                    self.earlier[name] = kept[part][name]
                else:
                    rows.setdefault(part, []).append(row)
            work.blocks += [Block(part, group.batch(own)) for part, own in rows.items()]
        if digests:
            folder.note(digests)
        return work

    def _check_bands(self, groups: Sequence[Group]) -> None:
        """Refuse fits of before that are of other bands; of files the manifest has what readers were told."""
        own = {name: group for group in groups if isinstance(group, Measured) for name in group.names}
        for record in self.stored(set(own)):
            group = own[record.material]
            lengths = None if record.wavelengths is None else tuple(record.wavelengths)
            if (record.channels, lengths) != (group.channels, group.wavelengths):
                had, now = bands_in_words(record.channels, lengths), bands_in_words(group.channels, group.wavelengths)
                where = f"{self.folder.path if self.folder else ''}: {record.material}"
                raise DataError(f"{where} was fitted in {had}, not {now}; give another folder")

    def _known(self, known: Input, group: Group, row: int, is_made: bool) -> dict[str, str]:
        """The digest of a material, if the manifest does not have it; an error if there is a fit of another one."""
        own = input_of(group, row, known.name)
        other = own.digest
        if known.digest and not known.digest.startswith(FILE) and other.startswith(FILE):  # of an old folder
            part = group.batch([row])
            measured = part.opened([]) if isinstance(part, Unopened) else [part]
            other = digest(measured[0]) if measured else known.digest
        if is_made and known.digest and other != known.digest:
            assert self.folder is not None
            where = self.folder.manifest_path
            expected = f"{known.name}: expected the material that {where} has"
            raise _OtherMaterialError(f"{expected}, found another; give another folder")
        return {} if known.digest == own.digest else {known.name: own.digest}

    def _all_fitted(self, blocks: Sequence[Block], place: Place) -> Iterator[tuple[Block, Fitted]]:
        """What came of blocks; of one whose process died each material is tried alone."""
        work = FitBlock(self.model, self.loss, self.settings, self.judge)
        lost: list[Block] = []
        for index, answer in _map(work, blocks, place):
            if not isinstance(answer, Lost):
                yield blocks[index], answer
            elif len(blocks[index].group) == 1:
                yield blocks[index], self._lost(blocks[index], answer)
            else:
                lost += blocks[index].singly()
        if lost:
            yield from self._all_fitted(lost, place)

    def _lost(self, block: Block, lost: Lost) -> Fitted:
        """The record of a material over which processes died."""
        shared = {name: self.shared[name] for name in OLD if name not in ("model", "lobes")}
        start = parameters(self.model.batched(1), 0)
        name, lobes = model_name(self.model)
        record = FitRecord(block.group.names[0], name, lobes, start, **shared, status=Status.LOST, reason=lost.reason)
        return Fitted([record], [])

    def _take_up(self, folder: FitFolder) -> None:
        """Make parts of a folder that has a `fits.json` alone."""
        path = folder.path / MATERIALS
        digests: dict[str, str] = read_json(path, dict[str, str], "digests of materials") if path.exists() else {}
        inputs = [Input(record.material, digests.get(record.material, "")) for record in self._old]
        folder.take_up(self.shared, self._old, inputs)
        path.unlink(missing_ok=True)  # what it had is in the manifest
        self._old = []

    def _check_old(self, path: Path, record: FitRecord) -> None:
        """A DataError if a fit of a folder without a manifest is one with other settings."""
        wanted = {key: value for key, value in self.shared.items() if key in OLD}
        if record.samples is None:  # every pair: as asked for, or because there were no more
            wanted["samples"] = None
        former = record.loss.removeprefix("rendered_")
        own = LOSSES.canonical(former) if former == record.loss else f"rendered_{DIFFERENCES.canonical(former)}"
        record = replace(record, loss=own)
        for key in OLD:
            if key == "diffuse" and self._may_be_fitted and record.diffuse == "fit":
                continue
            if key in ("max_theta", "seed") and getattr(record, key) is None:  # the file does not say
                continue
            if getattr(record, key) != wanted[key]:
                had = shown(getattr(record, key)) if getattr(record, key) != "" else "that the file does not say"
                raise DataError(
                    f"{path}: {record.material} was fitted with {key} {had}, not {shown(wanted[key])}; "
                    "give another folder"
                )


class _OtherMaterialError(DataError):
    """A folder has fits of another material of a name."""


def _cut(rows: range, size: int) -> list[list[int]]:
    return [list(rows[k : k + size]) for k in range(0, len(rows), size)]


def _new_blocks(groups: Sequence[Group]) -> list[list[Input]]:
    """All materials in blocks, as a manifest lists them, without having read any."""
    blocks = []
    for group in groups:
        names = list(group.names)
        every = [input_of(group, row, name, with_digest=False) for row, name in enumerate(names)]
        blocks += [[every[row] for row in rows] for rows in _cut(range(len(every)), block_size(group))]
    return blocks


def _statuses(folder: FitFolder, part: int, manifest: Manifest) -> dict[str, str]:
    """How the fits of a part ended; none of a part that is bad, which is made again."""
    try:
        return folder.statuses(part, manifest)
    except DataError as error:
        log.warning("torchbrdf: %s; its fits are made again", error)
        folder.part_path(part).unlink(missing_ok=True)
        return {}


def _map(work: FitBlock, blocks: Sequence[Block], place: Place) -> Iterator[tuple[int, Fitted | Lost]]:
    """Blocks on all cores; on a GPU one after the other."""
    if place is None and any(torch.device(block.group.device or "cpu").type != "cpu" for block in blocks):
        for index, block in enumerate(blocks):
            with torch.no_grad():
                yield index, work(block)
        return
    yield from side_by_side(work, blocks, place)
