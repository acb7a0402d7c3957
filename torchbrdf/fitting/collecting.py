"""Folders of shares of a fit, made by jobs that know nothing of each other, put together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torchbrdf.errors import DataError
from torchbrdf.fitting.tables import write_tables
from torchbrdf.lobes.parts import FITS, MANIFEST, FitFolder, Input, Manifest, part_bytes, part_name
from torchbrdf.solvers import Status


@dataclass(frozen=True)
class Collected:
    """What came together.

    Args:
        fits: How many fits there are now.
        missing: Parts that no folder has whole, and of each how many of its materials lack a fit.
        materials: How many there are to be.
        parts: How many parts there are to be.
    """

    fits: int
    missing: dict[int, int]
    materials: int
    parts: int


def collect(folders: Sequence[Path | str], out: Path | str | None = None, *, parquet: bool = False) -> Collected:
    """Put the parts of several folders into one, and write its tables.

    Args:
        folders: Of `torchbrdf fit --shard`, of the same files and settings.
        out: Where they are put; by default the only folder itself, or the first.
        parquet: Whether to write `fits.parquet`, too.

    Raises:
        DataError: A folder is no folder of fits; has other settings or materials; a part is cut short, changed, or
            comes from two folders. Nothing is written then.

    Example:
        >>> import tempfile
        >>> from torchbrdf.fitting import Batches
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.losses import RMSLoss
        >>> from torchbrdf.measured import load, standins
        >>> with tempfile.TemporaryDirectory() as name:
        ...     batches = Batches(make_model("ward", 1), RMSLoss(), out=Path(name), samples=200, max_theta=20)
        ...     groups = [load(standins()).batch([6, 7])]
        ...     _ = [*batches.fits(groups, shard=(2, 2), bad=[])]
        ...     found = collect([name])
        >>> found.fits, found.missing
        (1, {0: 1})
    """
    every = [FitFolder(path) for path in folders]
    target = FitFolder(every[0].path if out is None else out)
    manifests = [_manifest(folder) for folder in every]
    whole = _joined(every, manifests)
    if target.manifest_path.exists():
        whole = _joined([target, every[0]], [_manifest(target), whole])
    found = _parts(every, whole, target)
    target.put(whole, {part: part_bytes(part, whole.hash, lines) for part, lines in found.items()})
    write_tables(target, parquet)
    missing = {}
    there = 0
    for part in range(len(whole.parts)):
        made = [line for line in target.lines(part, whole) if line.get("status") != Status.LOST]
        there += len(made)
        if lacking := len(whole.block(part)) - len(made):
            missing[part] = lacking
    return Collected(there, missing, len(whole.inputs), len(whole.parts))


def _manifest(folder: FitFolder) -> Manifest:
    if not folder.manifest_path.exists():
        found = f"{FITS} alone: fit into it once more" if (folder.path / FITS).exists() else "none"
        raise DataError(f"{folder.path}: expected a folder of torchbrdf fit with a {MANIFEST}, found {found}")
    return folder.manifest()


def _joined(folders: Sequence[FitFolder], manifests: Sequence[Manifest]) -> Manifest:
    """One manifest of all, with every digest that any of them knows."""
    first, whole = folders[0], manifests[0]
    inputs = list(whole.inputs)
    for folder, manifest in zip(folders[1:], manifests[1:], strict=True):
        folder.check_settings(manifest, whole.settings, f"those of {first.manifest_path}")
        where = folder.manifest_path
        if manifest.parts != whole.parts or len(manifest.inputs) != len(inputs):
            there, here = (f"{len(one.inputs)} in {len(one.parts)} parts" for one in (whole, manifest))
            raise DataError(f"{where}: expected the materials of {first.manifest_path}, {there}, found {here}")
        for k, one in enumerate(manifest.inputs):
            inputs[k] = _same(inputs[k], one, where, first.manifest_path)
    return replace(whole, inputs=inputs)


def _same(known: Input, one: Input, where: Path, first: Path) -> Input:
    if one.name != known.name or (one.digest and known.digest and one.digest != known.digest):
        what = "another material of that name" if one.name == known.name else one.name
        raise DataError(f"{where}: expected {known.name} as in {first}, found {what}")
    return known if known.digest else one


def _parts(folders: Sequence[FitFolder], whole: Manifest, target: FitFolder) -> dict[int, list[dict[str, object]]]:
    """The parts that the target lacks."""
    owner: dict[int, FitFolder] = {}
    found: dict[int, list[dict[str, object]]] = {}
    for folder in folders:
        for part in range(len(whole.parts)):
            lines = folder.lines(part, whole)
            if not lines:
                continue
            if (other := owner.setdefault(part, folder)) is not folder:
                raise DataError(f"{folder.path}: {part_name(part)}: comes twice: {other.path} has it, too")
            if folder.path.resolve() != target.path.resolve():
                found[part] = lines
    for part in list(found):
        there = target.lines(part, whole)
        if there == found[part]:
            del found[part]  # of an earlier call
        elif len([line for line in there if line.get("status") != Status.LOST]) >= len(found[part]):
            raise DataError(f"{target.part_path(part)}: expected the fits of {owner[part].path}, found others")
    return found
