"""`torchbrdf view`."""

from pathlib import Path

from torchbrdf.cli.common import (
    Commands,
    Options,
    add_backend,
    add_memory,
    add_reading,
    check_files,
    described,
    load_files,
    read_settings,
    say,
    whole,
)
from torchbrdf.cli.progress import progress_bar
from torchbrdf.errors import UsageError
from torchbrdf.kinds import BACKENDS, check_word

DESCRIPTION = """\
Draw measured BRDFs and fits from all around, and write one page to look at them: turn the object, wipe between a
material and its fit, see their difference. The page needs no network, and nothing beside it.

  torchbrdf view nickel.binary fits/fits.json
  torchbrdf view MERL/ --environment grove rnl_probe.hdr --steps 24 --out nickel.html --open
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(
        commands.add_parser("view", help="write a page to compare measured BRDFs and fits"), DESCRIPTION, "files"
    )
    parser.add_argument("files", nargs="+", help="measured BRDFs, fits.json, or folders of them")
    parser.add_argument(
        "--environment", nargs="+", default=["grove"], help="grove (default), studio, or .exr or .hdr light probes"
    )
    parser.add_argument("--shape", default="blob", help="blob (default), sphere, or a mesh file")
    parser.add_argument("--size", type=whole(1, 1024), default=320, help="pixels of a side, 1 to 1024 (default 320)")
    parser.add_argument(
        "--steps", type=whole(1, 360), default=12, help="sides that it is seen from, all around, 1 to 360 (default 12)"
    )
    add_backend(parser)
    add_memory(parser)
    parser.add_argument("--out", default="view.html", help="the page (default: view.html)")
    parser.add_argument("--open", action="store_true", help="open it in the browser")
    add_reading(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf view`."""
    check_word("backend", options.backend, BACKENDS)
    if "none" in options.environment:
        raise UsageError("view: expected light probes, found none; without light a picture is black")
    check_files(options.files)

    from torchbrdf.files import writable_file
    from torchbrdf.measured.load import number_repeats
    from torchbrdf.names import clean_name
    from torchbrdf.render import Environment, find_mesh
    from torchbrdf.report.viewer import write_viewer

    out = writable_file(options.out)
    mesh = find_mesh(options.shape)
    lights = [Environment.find(name) for name in options.environment]
    names = number_repeats([clean_name(Path(name).stem) for name in options.environment], " #")
    groups, complete = load_files(options.files, read_settings(options))
    if not groups:
        return 1
    write_viewer(
        out,
        groups,
        dict(zip(names, lights, strict=True)),
        mesh,
        size=options.size,
        steps=options.steps,
        backend=options.backend,
        progress=progress_bar("sides"),
    )
    pictures = sum(map(len, groups)) * len(lights) * options.steps
    say(f"{pictures} pictures, {out.stat().st_size / 1e6:.1f} MB", out)
    if options.open:
        import webbrowser

        webbrowser.open(out.resolve().as_uri())
    return 0 if complete else 1
