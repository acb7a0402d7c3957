"""The command line, `torchbrdf run | fit | ...`. A command is a file here: `add` to the parser, and `command`."""

import os
import sys
import warnings
from collections.abc import Sequence

from torchbrdf import __version__
from torchbrdf.cli import fit, info, render, run, study, view
from torchbrdf.cli.common import Parser, described
from torchbrdf.errors import TorchbrdfError, UsageError, one_line

DESCRIPTION = """\
Fit BRDF models to measured materials, and measure which error metric gives the fit that looks right.

  torchbrdf run fores2012                       the study of Fores, Ferwerda and Gu (2012), to a report
  torchbrdf fit nickel.binary --model ward      one fit, printed
  torchbrdf render nickel.binary                a picture of a measured material, or of fits
  torchbrdf view nickel.binary fits.json        a page to turn them and to wipe between them
  torchbrdf info nickel.binary                  what a file holds
  torchbrdf study serve runs/fores2012          ask people which fit looks closer, and scale their answers
"""

COMMANDS = (run, fit, render, view, info, study)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; the exit status is 0, 1 (data or a run failed) or 2 (usage)."""
    # Before torch is imported: threads that spin for long while they wait make a busy machine crawl.
    os.environ.setdefault("GOMP_SPINCOUNT", "3000")
    options = build_parser().parse_args(arguments)
    warnings.formatwarning = lambda message, *_args, **_options: f"torchbrdf: {message}\n"
    try:
        return int(options.command(options))
    except UsageError as error:
        print(f"torchbrdf: {error}", file=sys.stderr)
        return 2
    except (TorchbrdfError, OSError) as error:
        print(f"torchbrdf: {one_line(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("torchbrdf: stopped", file=sys.stderr)
        return 1


def build_parser() -> Parser:
    """The parser of the whole command line."""
    parser = described(Parser(prog="torchbrdf"), DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"torchbrdf {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return parser
