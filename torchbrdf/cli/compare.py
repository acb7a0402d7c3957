"""`torchbrdf compare`."""

import sys

from torchbrdf.cli.common import Commands, Options, add_memory, add_reading, described, read_settings, say, whole
from torchbrdf.cli.progress import progress_bar

DESCRIPTION = """\
Say how far measured BRDFs and fits are from the first of them: every metric, differences of pictures in two scenes and
what people would see of those, and at which angles they differ most.

  torchbrdf compare nickel.binary fits/fits.json
  torchbrdf compare paint.astm paint.binary --out compared/
  torchbrdf compare zoo:nickel zoo:nickel:gltf zoo:chrome --json

With --out the folder gets compare.html: the same, with slices that can be moved and the pictures. What was never
measured counts in no metric; on the page it is hatched or dashed.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(
        commands.add_parser("compare", help="say how far apart materials or fits are"), DESCRIPTION, "files"
    )
    parser.add_argument("files", nargs="+", help="measured BRDFs, fits.json, or folders; the first is the reference")
    parser.add_argument("--json", action="store_true", help="print it all as JSON")
    parser.add_argument("--out", help="folder for compare.html")
    parser.add_argument("--size", type=whole(16, 512), default=128, help="pixels of a side, 16 to 512 (default 128)")
    add_memory(parser)
    add_reading(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf compare`."""
    from pathlib import Path

    from torchbrdf.errors import TorchbrdfError
    from torchbrdf.files import json_text
    from torchbrdf.report.compare import PAGE, compare

    bad: list[TorchbrdfError] = []
    try:
        found = compare(
            *options.files,
            out=options.out,
            size=options.size,
            bad=bad,
            settings=read_settings(options),
            progress=progress_bar("materials"),
        )
    finally:
        for error in bad:
            say(f"torchbrdf: left out: {error}", to=sys.stderr)
    if options.json:
        print(json_text(found.to_dict()), end="")
    else:
        say(*found.lines())
        if options.out and found.others:
            say("", Path(options.out) / PAGE)
    return 1 if bad else 0
