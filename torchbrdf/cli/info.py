"""`torchbrdf info`: what files hold, and what this machine offers."""

import importlib.metadata
import importlib.util
import platform
import sys

from torchbrdf.cli.common import Commands, Options, described, say, short
from torchbrdf.errors import DataError, UsageError

DESCRIPTION = """\
Say what measured BRDF files hold: format, size, invalid entries, whether a file is MERL's own, diffuse and gloss.

  torchbrdf info nickel.binary
  torchbrdf info --system
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("info", help="say what a file holds"), DESCRIPTION, "files")
    parser.add_argument("files", nargs="*", help="measured BRDFs, or folders of them")
    parser.add_argument("--system", action="store_true", help="say what this machine offers: torch, CUDA, OpenGL, ...")
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf info`."""
    from torchbrdf.measured import describe
    from torchbrdf.measured.load import find_files

    if not options.files and not options.system:
        raise UsageError("info: expected files, or --system")
    if options.system:
        _print_facts(_system_facts(), "")
    bad: list[DataError] = []
    files = find_files(options.files, bad) if options.files else []
    for k, path in enumerate(files):
        try:
            facts = describe(path)
        except DataError as error:
            bad.append(error)
            continue
        if k or options.system:
            print()
        say(path)
        _print_facts(facts, "  ")
    for one in bad:
        say(f"torchbrdf: {one}", to=sys.stderr)
    return 1 if bad else 0


def _print_facts(facts: dict[str, object], indent: str) -> None:
    for key, value in facts.items():
        if isinstance(value, dict):
            say(f"{indent}{key}")
            _print_facts(value, indent + "  ")
        else:
            say(f"{indent}{key:42s} {short(value)}")


def _system_facts() -> dict[str, object]:
    """Python, torch, and what pictures are made with: name -> what was found."""
    import torch  # late, because most of the package comes with it

    from torchbrdf.render.raster.backends import find_opengl

    found = find_opengl()
    return {
        "python": f"{platform.python_version()}, {platform.platform()}",
        "torch": f"{torch.__version__}, {torch.get_num_threads()} threads",
        "cuda": torch.cuda.get_device_name() if torch.cuda.is_available() else "not available",
        "pyrender": _version("pyrender"),
        "opengl": found.renderer or f"does not work: {found.reason}",
        "embreex": _version("embreex"),
    }


def _version(package: str) -> str:
    """Of what is installed, without importing it."""
    if importlib.util.find_spec(package) is None:
        return "not installed"
    return importlib.metadata.version(package)
