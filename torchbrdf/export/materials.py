"""The materials of files: every one that can be exported, and why another cannot."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from torchbrdf.errors import DataError, TorchbrdfError, UsageError, shown
from torchbrdf.export.api import material_of
from torchbrdf.export.base import Material
from torchbrdf.lobes import FitRecord, read_fits
from torchbrdf.measured import StandIn, load_all
from torchbrdf.measured.find import Paths, find_files, format_of
from torchbrdf.measured.load import check_settings

# What chooses among the fits of a file.
CHOICES = ("material", "model", "loss")


def find_materials(
    paths: Paths,
    bad: list[TorchbrdfError],
    *,
    material: str | None = None,
    model: str | None = None,
    loss: str | None = None,
    settings: Mapping[str, str] | None = None,
) -> list[Material]:
    """What files hold as materials with names of their own.

    Args:
        paths: Measured files, `fits.json` files, or folders of them.
        bad: Takes the errors of bad files and fits.
        material: Only this one.
        model: Only fits of this model.
        loss: Only fits under this loss.
        settings: What measured files do not say, as of `torchbrdf.load`.

    Returns:
        The materials; the fits of a material that has several are named with their model, lobes and loss.

    Raises:
        UsageError: The choice leaves nothing.

    Example:
        >>> from torchbrdf.export.materials import find_materials
        >>> from torchbrdf.measured import standins
        >>> [material.name for material in find_materials(standins(), [], material="nickel")]
        ['nickel']
    """
    unread: list[DataError] = []
    records: list[FitRecord] = []
    origin: list[Path] = []
    measured: list[Path] = []
    for path in find_files(paths, unread):
        try:
            if format_of(path) == StandIn.format:
                records += read_fits(path, unread)
                origin += [path] * (len(records) - len(origin))
            else:
                measured.append(path)
        except DataError as error:
            unread.append(error)
    bad += unread
    if records and not measured:
        check_settings([StandIn.format], settings)
    choice = dict(zip(CHOICES, (material, model, loss), strict=True))
    chosen = [
        (record, path)
        for record, path in zip(records, origin, strict=True)
        if all(want in (None, getattr(record, key)) for key, want in choice.items())
    ]
    found = [
        *_fits(chosen, bad, settings),
        *(_tables(measured, material, bad, settings) if model is None and loss is None else ()),
    ]
    if not found and not bad and (records or measured):
        raise _nothing(choice, records)
    return found


def _fits(
    records: Sequence[tuple[FitRecord, Path]], bad: list[TorchbrdfError], settings: Mapping[str, str] | None
) -> Iterator[Material]:
    names = [record.material for record, _ in records]
    for record, path in records:
        many = names.count(record.material) > 1
        name = "-".join([record.material, record.model, str(record.lobes), record.loss]) if many else record.material
        try:
            yield replace(material_of(record, name.rstrip("-"), settings), files=(path,))
        except TorchbrdfError as error:
            bad.append(error if str(path) in str(error) else type(error)(f"{path}: {error}"))


def _tables(
    paths: Sequence[Path], material: str | None, bad: list[TorchbrdfError], settings: Mapping[str, str] | None
) -> Iterator[Material]:
    unread: list[DataError] = []
    groups = load_all(paths, bad=unread, settings=settings) if paths else []
    bad += unread
    for group in groups:
        for k, name in enumerate(group.names):
            if material in (None, name):
                yield material_of(group.batch([k]), name)


def _nothing(choice: dict[str, str | None], records: Sequence[FitRecord]) -> UsageError:
    """The error for a choice that leaves nothing, with what there is."""
    asked = ", ".join(f"{key} {shown(want)}" for key, want in choice.items() if want is not None)
    there = [
        f"{key} {' or '.join(sorted({getattr(record, key) or 'none' for record in records}))}"
        for key, want in choice.items()
        if want is not None and records
    ]
    expected = ", ".join(there) or "a material of the measured files, which have no model or loss"
    return UsageError(f"export: expected {expected}, found {asked}")
