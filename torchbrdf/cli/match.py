"""`torchbrdf match`."""

import sys

from torchbrdf.cli.common import Commands, Options, add_memory, add_reading, check_files, described, read_settings, say
from torchbrdf.cli.progress import progress_bar
from torchbrdf.kinds import EXPORTERS

DESCRIPTION = """\
Find for measured BRDFs the simplest model that a renderer has and whose pictures cannot be told from the measurement's,
or the best there is, and write it for that renderer.

  torchbrdf match nickel.binary --for mitsuba --out nickel/
  torchbrdf match MERL/ --for gltf --budget quick --out matches/

Candidates are fitted under the metric that was learned from people and to pictures, and judged in three scenes that no
fit saw: a sphere in a studio, a torus in a low sun, a knot in a room. With --out the folder gets a file a material,
match.html to look at them, and match.json with all numbers. What is there already is not fitted again.
"""

GUESSES = "Who would pick a match out knows which of two is the fit; the others guess, and are not counted."


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(
        commands.add_parser("match", help="find materials of a renderer that look like measured BRDFs"),
        DESCRIPTION,
        "files",
    )
    parser.add_argument("files", nargs="+", help="measured BRDFs, or folders of them")
    parser.add_argument(
        "--for",
        dest="target",
        default="mitsuba",
        help="mitsuba (default), pbrt, mtlx, gltf, blender, brdf, merl, rgl, ...",
    )
    parser.add_argument("--out", help="folder for the materials, match.html and match.json; without it nothing is kept")
    parser.add_argument(
        "--budget",
        default="default",
        help="how much is tried: quick, default, thorough, or seconds after which nothing else is begun",
    )
    add_memory(parser)
    add_reading(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf match`."""
    EXPORTERS.check(options.target)
    from torchbrdf.experiment.matching.candidates import find_budget

    find_budget(options.budget)
    check_files(options.files)

    from torchbrdf.errors import TorchbrdfError
    from torchbrdf.report.match import PAGE, match

    bad: list[TorchbrdfError] = []
    found = match(
        options.files,
        options.target,
        options.out,
        budget=options.budget,
        progress=progress_bar("fits"),
        bad=bad,
        settings=read_settings(options),
    )
    for error in bad:
        say(f"torchbrdf: left out: {error}", to=sys.stderr)
    for one in found:
        say(one.sentence)
        say(*(f"  ! {line}" for line in one.warnings), *(f"  {note}" for note in one.notes))
        say(*(f"  {path}" for path in one.files))
    if found:
        say(GUESSES)
    if found and options.out:
        from pathlib import Path

        say(Path(options.out) / PAGE)
    return 1 if bad or not found else 0
