"""`torchbrdf collect`."""

from pathlib import Path

from torchbrdf.cli.common import Commands, Options, described, say

DESCRIPTION = """\
Put the folders of torchbrdf fit --shard together, and write their tables.

  torchbrdf fit MERL/ --out fits-1/ --shard 1/2        on one machine
  torchbrdf fit MERL/ --out fits-2/ --shard 2/2        on another
  torchbrdf collect fits-1/ fits-2/ --out fits/

All have to be of the same files and settings, and every part of one folder only; what is missing is said, and
torchbrdf fit MERL/ --out fits/ makes it. One folder, into which jobs wrote together, is collected in its place.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("collect", help="put shares of a fit together"), DESCRIPTION, "folders")
    parser.add_argument("folders", nargs="+", help="folders of torchbrdf fit --shard")
    parser.add_argument("--out", help="where they are put (default: the only folder itself)")
    parser.add_argument("--parquet", action="store_true", help="write fits.parquet, too (needs pyarrow)")
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf collect`."""
    from torchbrdf.errors import UsageError
    from torchbrdf.files import writable
    from torchbrdf.fitting.collecting import collect
    from torchbrdf.fitting.tables import check_parquet
    from torchbrdf.lobes.parts import FITS, part_name

    if options.parquet:
        check_parquet()
    if not options.out and len(options.folders) > 1:
        raise UsageError(f"collect: expected --out with {len(options.folders)} folders, found none")
    out = Path(options.out or options.folders[0])
    if options.out:
        writable(out)
    found = collect([Path(folder) for folder in options.folders], out, parquet=options.parquet)
    say(f"{found.fits} of {found.materials} fits, in {found.parts - len(found.missing)} of {found.parts} whole parts")
    if found.missing:
        first = ", ".join(part_name(part) for part in list(found.missing)[:3])
        rest = ", ..." if len(found.missing) > 3 else ""
        lacking = sum(found.missing.values())
        say(f"missing: {lacking} fits of {first}{rest}; torchbrdf fit with the same files and --out {out} makes them")
    say(out / FITS if (out / FITS).exists() else out)
    return 1 if found.missing else 0
