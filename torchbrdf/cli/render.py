"""`torchbrdf render`."""

from torchbrdf.cli.common import (
    Commands,
    Options,
    add_backend,
    add_memory,
    add_reading,
    check_files,
    described,
    load_files,
    number,
    read_settings,
    say,
    whole,
)
from torchbrdf.cli.progress import progress_bar
from torchbrdf.errors import UsageError
from torchbrdf.kinds import BACKENDS, check_word

DESCRIPTION = """\
Draw measured BRDFs, and the fits of a fits.json, under a light probe, to PNG (and linear EXR) files.

  torchbrdf render nickel.binary fits/fits.json --out pictures/
  torchbrdf render fits/fits.json --environment rnl_probe.hdr --shape sphere --rotate 15

All pictures of one command share a tone map, in tonemap.json, so that they can be compared; sheet.png has them side by
side, with maps of where each fit differs from its material.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("render", help="draw measured BRDFs or fits"), DESCRIPTION, "files")
    parser.add_argument("files", nargs="+", help="measured BRDFs, or a fits.json")
    parser.add_argument(
        "--environment", default="grove", help="grove (default), studio, none, or .exr or .hdr: lat-long or angular map"
    )
    parser.add_argument("--shape", default="blob", help="blob (default), sphere, or a mesh file")
    parser.add_argument(
        "--rotate", type=number(-3600, 3600), default=0.0, help="turn the view by so many degrees (default 0)"
    )
    parser.add_argument("--elevation", type=number(-89, 89), default=0.0, help="degrees to look down from (default 0)")
    parser.add_argument("--size", type=whole(1, 2048), default=400, help="pixels of a side, 1 to 2048 (default 400)")
    parser.add_argument(
        "--lamp", action="append", default=[], help="directional:X,Y,Z:COLOR or point:X,Y,Z:COLOR; may come again"
    )
    parser.add_argument("--shadows", action="store_true", help="the object casts shadows on itself (needs embreex)")
    add_backend(parser)
    add_memory(parser)
    parser.add_argument("--out", default=".", help="folder for the pictures (default: here)")
    add_reading(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf render`."""
    check_word("backend", options.backend, BACKENDS)
    if options.environment == "none" and not options.lamp:
        raise UsageError("render: expected an environment or a lamp, found neither")
    check_files(options.files)

    from torchbrdf.files import destination, writable
    from torchbrdf.render import Camera, Environment, Scene, find_mesh, parse_light
    from torchbrdf.report.sheet import SHEET, TONE_MAP, draw_groups

    out = writable(options.out)
    for name in (f"{SHEET}.png", f"{TONE_MAP}.json"):
        destination(out / name)
    light = None if options.environment == "none" else Environment.find(options.environment)
    scene = Scene(
        find_mesh(options.shape),
        Camera(options.rotate, elevation=options.elevation),
        light,
        size=options.size,
        punctual_lights=[parse_light(text) for text in options.lamp],
        shadows=options.shadows,
        backend=options.backend,
    )
    groups, complete = load_files(options.files, read_settings(options))
    if not groups:
        return 1
    for path, label in draw_groups(out, groups, scene, progress_bar("pixels")):
        say(f"{path}  {label}")
    return 0 if complete else 1
