"""What files hold to be looked at: materials and their fits, with labels, file names, and who is a fit of whom."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from torchbrdf.experiment.labels import diffuse_label, loss_label, model_label
from torchbrdf.lobes import FitRecord
from torchbrdf.measured import Measured, StandIn
from torchbrdf.measured.load import number_repeats
from torchbrdf.names import clean_name, distinct_stems

Kind = Literal["measured", "stand-in", "model", "fit"]
# What an item is compared with, if it is there: best a measurement.
BESIDE: dict[Kind, tuple[Kind, ...]] = {
    "measured": (),
    "stand-in": (),
    "model": ("measured", "stand-in"),
    "fit": ("measured", "stand-in", "model"),
}


@dataclass(frozen=True)
class Item:
    """A material, or a fit of one.

    Args:
        label: What it is, for people, such as `nickel: Ward, 2 lobes, cube root, global`.
        material: The name of the material that it is, or is a fit of.
        kind: Whether it is a measurement, a model in its place, one that says of what it is a model, or a fit.
        reference: The place in a list of items of the material that a fit or a model is of; None if that is not there.
        stem: A name for its files, without suffix.
    """

    label: str
    material: str
    kind: Kind
    reference: int | None = None
    stem: str = ""


def list_items(groups: Sequence[Measured], reserved: Sequence[str] = ()) -> list[Item]:
    """The items of some groups, in their order, each with a label and a file name of its own.

    A record of a fits.json that says by which strategy it was made is a fit; one that says its `source`, as those of
    the zoo do, is a model of a material; another is a stand-in for one.

    Args:
        groups: Loaded files.
        reserved: File names, without suffix, that no item may have.

    Returns:
        One item for each material of each group.
    """
    models = _models_of_standins(groups)
    items = [_item(group, row, models) for group in groups for row in range(len(group))]
    first: dict[tuple[str, str], int] = {}
    for k, item in enumerate(items):
        first.setdefault((item.material, item.kind), k)
    labels = number_repeats([item.label for item in items], " #")
    there = {item.material for item in items if item.kind == "measured"}
    wanted = [
        f"{item.stem}-stand-in" if item.kind == "stand-in" and item.material in there else item.stem for item in items
    ]
    stems = distinct_stems(wanted, reserved)
    references = [[first.get((item.material, kind)) for kind in BESIDE[item.kind]] for item in items]
    return [
        replace(item, label=label, stem=stem, reference=next((k for k in of if k is not None), None))
        for item, label, stem, of in zip(items, labels, stems, references, strict=True)
    ]


def _models_of_standins(groups: Sequence[Measured]) -> Mapping[str, set[tuple[str, int]]]:
    """By which models and numbers of lobes there are stand-ins for each material."""
    found: dict[str, set[tuple[str, int]]] = {}
    for group in groups:
        if isinstance(group.source, StandIn):
            for record in (group.source.records[material] for material in group.materials):
                if _kind(record) == "stand-in":
                    found.setdefault(record.material, set()).add((record.model, record.lobes))
    return found


def _kind(record: FitRecord) -> Kind:
    if record.strategy:
        return "fit"
    return "model" if isinstance(record.extra.get("source"), str) else "stand-in"


def _item(group: Measured, row: int, standins: Mapping[str, set[tuple[str, int]]]) -> Item:
    source, material = group.source, group.materials[row]
    if not isinstance(source, StandIn):
        name = source.names[material]
        return Item(f"{name} (measured)", name, "measured", stem=name)
    record = source.records[material]
    name, kind = record.material, _kind(record)
    if kind == "stand-in" and len(standins[name]) == 1:
        return Item(f"{name} (stand-in)", name, kind, stem=name)
    whole = "diffuse" not in record.parameters  # a material, whose lobes nobody counts
    lobes = "" if whole else f"{record.lobes} lobe{'' if record.lobes == 1 else 's'}"
    how, stem = [model_label(record.model), lobes], [name, record.model, lobes.replace(" ", "-")]
    if kind == "fit":
        how += [loss_label(record.loss), record.strategy, diffuse_label(record.diffuse)]
        stem += [record.loss, record.strategy]
    mark = "" if kind == "fit" else f" ({kind})"
    label = clean_name(f"{name}: {', '.join(filter(None, how))}{mark}")
    return Item(label, name, kind, stem="-".join(filter(None, stem)))
