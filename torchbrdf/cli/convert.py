"""`torchbrdf convert`."""

import sys

from torchbrdf.cli.common import Commands, Options, add_bands, add_reading, described, read_settings, say
from torchbrdf.cli.progress import progress_bar
from torchbrdf.kinds import EXPORTERS

DESCRIPTION = """\
Write a measured BRDF, or a fit, as a file of another format, read it back, and say how near it is to the original.

  torchbrdf convert paint.astm paint.binary
  torchbrdf convert nickel.binary nickel.bsdf
  torchbrdf convert paints/ as-csv/ --to csv --read angles=degrees

  merl  .binary  a MERL table        rgl   .bsdf  a tensor file: Mitsuba 3, pbrt-v4
  ssdd  .ssdd    BSDF Processor      astm  .astm  ASTM E1392 text      csv  .csv  named columns

The suffix of OUT tells the format, or --to. Scattered samples stay as they are in astm and csv; all else is resampled:
it says at how many places, and how many of those were never measured. A folder becomes a folder; a bad file in it is
said, and the others are converted.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("convert", help="write measured files in another format"), DESCRIPTION)
    parser.add_argument("source", metavar="IN", help="a measured BRDF, a fits.json, or a folder of them")
    parser.add_argument("out", metavar="OUT", help="the file, or a folder for several")
    parser.add_argument("--to", help="merl, rgl, ssdd, astm, csv, ...; by default told by the suffix of OUT")
    add_reading(parser)
    add_bands(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf convert`."""
    if options.to is not None:
        EXPORTERS.check(options.to)

    from torchbrdf.errors import TorchbrdfError
    from torchbrdf.export.convert import convert

    bad: list[TorchbrdfError] = []
    found = convert(
        options.source,
        options.out,
        options.to,
        settings=read_settings(options),
        bad=bad,
        progress=progress_bar("materials"),
    )
    for one in found:
        say(*one.lines())
    for error in bad:
        say(f"torchbrdf: left out: {error}", to=sys.stderr)
    return 1 if bad or not found else 0
