"""`torchbrdf check`."""

import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from torchbrdf.cli.common import Commands, Options, add_reading, check_files, described, load_files, read_settings, say
from torchbrdf.cli.progress import progress_bar
from torchbrdf.errors import DataError

if TYPE_CHECKING:
    from torchbrdf.measured import Measured, Plausibility

DESCRIPTION = """\
Say whether BRDFs could be a surface's: how much of the light from each direction they reflect (a white furnace),
whether exchanged directions agree (reciprocity), values below 0, and what was not measured.

  torchbrdf check nickel.binary
  torchbrdf check nickel.binary fits/fits.json --out checked/

With --out also albedo.png, albedo over the angle of the light, and check.json. What is odd is said and is no error:
measurements and models with a name are often a few percent off.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("check", help="energy, reciprocity, negative values"), DESCRIPTION, "files")
    parser.add_argument("files", nargs="+", help="measured BRDFs, or a fits.json")
    parser.add_argument("--out", help="a folder for albedo.png and check.json")
    add_reading(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf check`."""
    check_files(options.files)

    from torchbrdf.experiment.items import list_items
    from torchbrdf.files import destination, writable, write_json
    from torchbrdf.measured import check
    from torchbrdf.report.figures import albedo_figure

    out = writable(options.out) if options.out else None
    names = [destination(out / name) for name in ("albedo.png", "check.json")] if out else []
    groups, complete = load_files(options.files, read_settings(options))
    found: list[Plausibility] = []
    written: list[dict[str, object]] = []
    todo = [group.batch([k]) for group in groups for k in range(len(group))]
    labels = [item.label for item in list_items(groups)]
    progress = progress_bar("materials")
    width = max((len(label) for label in labels), default=0)
    for k, (material, label) in enumerate(zip(todo, labels, strict=True)):
        try:
            (one,) = check(material)
        except DataError as error:
            say(f"torchbrdf: left out: {error}", to=sys.stderr)
            complete = False
            continue
        if not found:
            say(f"{'material':{width}s}  albedo at 0   largest       not reciprocal  lowest, 1/sr")
        largest, angle = one.largest_albedo
        say(
            f"{label:{width}s}  {max(one.albedo[0]):11.3f}   {largest:.3f} at {angle:2.0f}  "
            f"{_reciprocity(material, one)}  {one.lowest:12.3g}"
        )
        for warning in one.warnings():
            say(f"{'':{width}s}  ! {warning}")
        found.append(replace(one, name=label))
        written.append({"label": label, **one.to_dict()})
        progress(k + 1, len(todo))
    if names and found:
        albedo_figure(names[0], found)
        write_json(names[1], written)
        say(*names)
    return 0 if complete and found else 1


def _reciprocity(material: "Measured", found: "Plausibility") -> str:
    """How far exchanged directions are apart; of scattered samples as they were measured, or "-"."""
    if found.reciprocity is not None:
        return f"{100 * found.reciprocity:12.1f} %"
    said = str(material.source.details(material.materials[0]).get("reciprocity error", "-"))
    return f"{said.partition(' (')[0]:>14s}"
