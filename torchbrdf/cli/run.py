"""`torchbrdf run`."""

from pathlib import Path

from torchbrdf.cli.common import Commands, Options, add_memory, described
from torchbrdf.cli.progress import progress_bar
from torchbrdf.errors import UsageError, shown

DESCRIPTION = """\
Run a recipe: a short Python file that says what to do and which settings it has. A file runs as the program that it
is, with all that you may do: give only files that you trust. Its settings are data, and nothing in them runs.

  torchbrdf run fores2012
  torchbrdf run fores2012 quick=true
  torchbrdf run fores2012 materials=MERL/ environment=rnl_probe.hdr models=ward,cook_torrance
  torchbrdf run my_recipe.py --out results

Run it again with the same settings and folder, and it takes up what is finished.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("run", help="run a recipe, such as fores2012"), DESCRIPTION, "settings")
    parser.add_argument(
        "recipe", help="a recipe's name (`list` shows them), or a Python file that holds one, which runs"
    )
    parser.add_argument(
        "settings", nargs="*", metavar="key=value", help="settings; `torchbrdf run NAME help=` shows them"
    )
    parser.add_argument("--out", help="folder of the run (default: runs/NAME)")
    add_memory(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf run`."""
    from torchbrdf.recipe import RECIPES, configure, describe, find_recipe, run

    if options.recipe == "list":
        for name, kind in RECIPES.items():
            print(f"{name:20s} {(kind.__doc__ or '').splitlines()[0]}")
        return 0
    kind = find_recipe(options.recipe)
    settings = {}
    for text in options.settings:
        key, separator, value = text.partition("=")
        if not separator:
            raise UsageError(f"{kind.name}: expected key=value, found {shown(text)}")
        if key in settings:
            raise UsageError(f"{kind.name}: {shown(key)}: expected once, found twice")
        settings[key] = value
    if "help" in settings:
        print(describe(kind))
        return 0
    recipe = configure(kind, settings)
    print(run(recipe, options.out or Path("runs") / kind.name, progress_bar))
    return 0
