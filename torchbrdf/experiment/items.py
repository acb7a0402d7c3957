"""What files hold to be looked at: materials and their fits, with labels, file names, and who is a fit of whom."""

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from torchbrdf.experiment.labels import diffuse_label, loss_label, model_label
from torchbrdf.measured import Measured, StandIn
from torchbrdf.measured.load import number_repeats
from torchbrdf.names import LONGEST_NAME, clean_name, file_stem


@dataclass(frozen=True)
class Item:
    """A material, or a fit of one.

    Args:
        label: What it is, for people, such as `nickel: Ward, 2 lobes, cube root, global`.
        material: The name of the material that it is, or is a fit of.
        kind: Whether it is a measurement, a model in its place, or a fit.
        reference: The place in a list of items of the material that a fit is a fit of; None if that is not there.
        stem: A name for its files, without suffix.
    """

    label: str
    material: str
    kind: Literal["measured", "stand-in", "fit"]
    reference: int | None = None
    stem: str = ""


def list_items(groups: Sequence[Measured], reserved: Sequence[str] = ()) -> list[Item]:
    """The items of some groups, in their order, each with a label and a file name of its own.

    A record of a fits.json that says by which strategy it was made is a fit; another is a stand-in for a material.

    Args:
        groups: Loaded files.
        reserved: File names, without suffix, that no item may have.

    Returns:
        One item for each material of each group.
    """
    items = [_item(group, row) for group in groups for row in range(len(group))]
    references: dict[str, int] = {}
    for kind in ("stand-in", "measured"):  # so that a measured one takes its stand-in's place
        references |= {item.material: k for k, item in reversed(list(enumerate(items))) if item.kind == kind}
    labels = number_repeats([item.label for item in items], " #")
    there = {item.material for item in items if item.kind == "measured"}
    wanted = [
        f"{item.stem}-stand-in" if item.kind == "stand-in" and item.material in there else item.stem for item in items
    ]
    stems = distinct_stems(wanted, reserved)
    return [
        replace(item, label=label, stem=stem, reference=references.get(item.material) if item.kind == "fit" else None)
        for item, label, stem in zip(items, labels, stems, strict=True)
    ]


def distinct_stems(names: Sequence[str], reserved: Sequence[str] = ()) -> list[str]:
    """Names of files in one folder, without suffix, no two the same, also where case does not count.

    They are `names.file_stem`s; one that is taken gets a number behind, and none is hidden by a dot in front.
    """
    taken = {same_file(name) for name in reserved}
    made = []
    for name in names:
        plain = file_stem(name).lstrip(".") or "_"
        number, stem = 1, plain
        while same_file(stem) in taken:
            number += 1
            end = f"-{number}"
            stem = clean_name(plain, LONGEST_NAME - len(end)) + end
        taken.add(same_file(stem))
        made.append(stem)
    return made


def same_file(stem: str) -> str:
    """What is the same for names that are one file on some system: those that differ in case, or in how accents are."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", stem).casefold())


def _item(group: Measured, row: int) -> Item:
    source, material = group.source, group.materials[row]
    if not isinstance(source, StandIn):
        name = source.names[material]
        return Item(f"{name} (measured)", name, "measured", stem=name)
    record = source.records[material]
    name = record.material
    if not record.strategy:
        return Item(f"{name} (stand-in)", name, "stand-in", stem=name)
    whole = "diffuse" not in record.parameters  # a material, whose lobes nobody counts
    lobes = "" if whole else f"{record.lobes} lobe{'' if record.lobes == 1 else 's'}"
    how = [model_label(record.model), lobes, loss_label(record.loss), record.strategy, diffuse_label(record.diffuse)]
    stem = [name, record.model, lobes.replace(" ", "-"), record.loss, record.strategy]
    return Item(clean_name(f"{name}: {', '.join(filter(None, how))}"), name, "fit", stem="-".join(filter(None, stem)))
