"""`torchbrdf export`."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from torchbrdf.cli.common import Commands, Options, add_memory, add_reading, check_files, described, read_settings, say
from torchbrdf.cli.progress import progress_bar
from torchbrdf.kinds import EXPORTERS, check_model

if TYPE_CHECKING:
    from torchbrdf.errors import TorchbrdfError
    from torchbrdf.export import Exported, Material
    from torchbrdf.render import Scene

DESCRIPTION = """\
Write fits and measured BRDFs as materials of other programs.

  torchbrdf export fits/fits.json --to mitsuba --out materials/
  torchbrdf export fits/fits.json --material nickel --model ggx --loss learned --to pbrt --out materials/
  torchbrdf export nickel.binary --to rgl --out materials/
  torchbrdf export fits/fits.json --to gltf --mesh sphere --out materials/

  mitsuba  XML for Mitsuba 3, whose root is one <bsdf>      pbrt     a named material for pbrt-v4
  mtlx     MaterialX: an OpenPBR surface                    gltf     a .glb of the blob, or of any mesh
  blender  a script for the Principled BSDF                 brdf     GLSL of Disney's BRDF Explorer
  merl     a MERL table                                     rgl      a tensor file: Mitsuba 3, pbrt-v4
  ssdd     a grid for BSDF Processor                        astm     ASTM E1392 text
  csv      named columns

Any BRDF goes to any of them. What a program has no model for is refitted to one that it has, or written as a table;
each line says what is exact and what is not, and by how much the picture differs: the colour difference between the
BRDF and what the program shows, on the blob in the default scene.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("export", help="write materials for other programs"), DESCRIPTION, "files")
    parser.add_argument("files", nargs="+", help="a fits.json, measured BRDFs, or folders of them")
    parser.add_argument("--to", required=True, help="mitsuba, pbrt, mtlx, gltf, blender, brdf, merl, rgl, ...")
    parser.add_argument("--out", required=True, help="folder for the files")
    parser.add_argument("--material", help="only the material of this name")
    parser.add_argument("--model", help="only fits of this model, such as ggx or oren_nayar+ggx")
    parser.add_argument("--loss", help="only fits under this loss, such as learned")
    parser.add_argument("--mesh", help="gltf: blob (default), sphere, or a mesh file")
    add_memory(parser)
    add_reading(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf export`."""
    EXPORTERS.check(options.to)
    if options.model is not None:
        check_model(options.model)
    check_files(options.files)

    from torchbrdf.errors import TorchbrdfError
    from torchbrdf.export.api import find_exporter, refuse_matches, write
    from torchbrdf.export.materials import find_materials
    from torchbrdf.files import writable
    from torchbrdf.render import Scene, blob, find_mesh

    exporter = find_exporter(options.to, None if options.mesh is None else find_mesh(options.mesh))
    bad: list[TorchbrdfError] = []
    chosen = {key: getattr(options, key) for key in ("material", "model", "loss")}
    materials = find_materials(options.files, bad, settings=read_settings(options), **chosen)
    for error in bad:
        _left_out(error)
    if not materials:
        return 1
    out = writable(options.out)
    scene = Scene(blob(), size=128)
    failed = 0
    progress = progress_bar("materials")
    for k, material in enumerate(_with_stems(materials)):
        progress(k, len(materials))
        try:
            refuse_matches(exporter, material, out)
            done = write(exporter, material, out)
            say(*_lines(material, done, scene))
        except TorchbrdfError as error:
            _left_out(error, material.name)
            failed += 1
    progress(len(materials), len(materials))
    return 1 if bad or failed else 0


def _left_out(error: "TorchbrdfError", name: str = "") -> None:
    said = str(error) if not name or str(error).startswith(f"{name}:") else f"{name}: {error}"
    say(f"torchbrdf: left out: {said}", to=sys.stderr)


def _with_stems(materials: Sequence["Material"]) -> list["Material"]:
    """The materials under names that are files of their own in one folder."""
    from torchbrdf.names import distinct_stems

    stems = distinct_stems([material.name for material in materials])
    return [replace(material, name=stem) for material, stem in zip(materials, stems, strict=True)]


def _lines(material: "Material", done: "Exported", scene: "Scene") -> list[str]:
    """What is said of an export: its file, what is exact and what not, and the picture's difference."""
    first, *others = done.files
    lines = [f"{first}  {material.name}: {'exact' if done.exact else 'not exact'}"]
    lines += [f"  {note}" for note in done.notes]
    lines += [f"  {path}" for path in others]
    return [*lines, f"  {_difference(material, done, scene)}"]


def _difference(material: "Material", done: "Exported", scene: "Scene") -> str:
    """The picture's difference, and the share of observers that would tell it, where that is known."""
    from torchbrdf.experiment.labels import difference_label
    from torchbrdf.export import picture_differences
    from torchbrdf.perception.discrimination.words import said

    if done.shown is material.brdf:
        return "the same picture" if done.exact else "the same picture but for that"
    found = picture_differences(material.brdf, done.shown, scene)
    parts = [f"{difference_label(name)} {value:.2f}" for name, value in found.items()]
    words = next((text for name, value in found.items() if (text := said(name, value))), "")
    return f"picture: {', '.join(parts)}" + (f"; {words}" if words else "")
