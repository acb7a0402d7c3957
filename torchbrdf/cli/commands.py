"""The commands: their parser, and how what they raise is said."""

import io
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from torchbrdf import __version__, memory
from torchbrdf.cli import (
    check,
    collect,
    compare,
    convert,
    export,
    fit,
    info,
    match,
    render,
    run,
    score,
    study,
    texels,
    view,
)
from torchbrdf.cli.common import Options, Parser, described
from torchbrdf.cli.progress import reporting
from torchbrdf.cli.signals import GRACE, ending
from torchbrdf.errors import TorchbrdfError, UsageError, one_line, printable, said_once
from torchbrdf.files import noting_replaced, without_empty_folders

DESCRIPTION = """\
Fit BRDF models to measured materials, and measure which error metric gives the fit that looks right.

  torchbrdf run fores2012                       the study of Fores, Ferwerda and Gu (2012), to a report
  torchbrdf match nickel.binary --for mitsuba    the simplest material that looks like it
  torchbrdf fit nickel.binary --model ward      one fit, printed
  torchbrdf texels lights.csv                   a model fitted to every texel of a photometric stack, as maps
  torchbrdf collect fits-1/ fits-2/ --out fits/ the shares of a fit that several machines made
  torchbrdf render nickel.binary                a picture of a measured material, or of fits
  torchbrdf view nickel.binary fits.json        a page to turn them and to wipe between them
  torchbrdf compare nickel.binary fits.json     how far apart they are: metrics, pictures, slices
  torchbrdf export fits.json --to mitsuba       materials of other programs
  torchbrdf convert paint.astm paint.binary     a measured file in another format
  torchbrdf info nickel.binary                  what a file holds
  torchbrdf info --zoo                          materials that come with it: zoo:nickel stands in a file's place
  torchbrdf check nickel.binary fits.json       energy, reciprocity, negative values
  torchbrdf score --metric my_metrics:distance  how often a metric agrees with people
  torchbrdf study serve runs/fores2012          ask people which fit looks closer, and scale their answers
"""

COMMANDS = (run, match, fit, collect, texels, render, view, compare, export, convert, info, check, score, study)


# Whose files are what somebody asked for by name; other commands keep folders of their own, which they go on with.
WRITERS = (render, view, compare, export, convert, check)


def build_parser() -> Parser:
    """The parser of the whole command line."""
    parser = described(Parser(prog="torchbrdf"), DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"torchbrdf {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return parser


def perform(options: Options) -> int:
    """Do a command; its exit status, whatever it raises on purpose."""
    # Before torch is imported: threads that spin for long while they wait make a busy machine crawl.
    os.environ.setdefault("GOMP_SPINCOUNT", "3000")
    warnings.formatwarning = lambda message, *_args, **_options: f"torchbrdf: {message}\n"
    # A server ends its answers first, and says how many there are.
    patient = options.command.__module__ == study.__name__
    quiet = options.command is study.serve_command
    replaced: list[Path] = []
    try:
        with (
            noting_replaced() as replaced,
            nullcontext() if patient else ending(GRACE),
            nullcontext() if quiet else said_once(),
            nullcontext() if quiet else reporting(),
            without_empty_folders(),
            memory.limited(getattr(options, "memory", None)),
        ):
            status = int(options.command(options))
            sys.stdout.flush()
            return status
    except UsageError as error:
        print(f"torchbrdf: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever reads has seen enough, as head has
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left goes nowhere
        return 128 + 13  # as of SIGPIPE, which Windows has not
    except (TorchbrdfError, OSError) as error:
        print(f"torchbrdf: {one_line(str(error))}", file=sys.stderr)
        return 1
    finally:
        if replaced and options.command.__module__ in [command.__name__ for command in WRITERS]:
            _say_replaced(replaced)


def _say_replaced(files: Sequence[Path]) -> None:
    """Say which files were there, and are others now."""
    count = "1 file that was there" if len(files) == 1 else f"{len(files)} files that were there"
    rest = ", ..." if len(files) > 3 else ""
    print(f"torchbrdf: replaced {count}: {printable(', '.join(map(str, files[:3])))}{rest}", file=sys.stderr)


def make_streams_safe() -> None:
    """Escapes for what the terminal cannot show: one that knows only ASCII, or a path that is no UTF-8."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
