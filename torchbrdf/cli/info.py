"""`torchbrdf info`: what files hold, and what this machine offers."""

import importlib.metadata
import importlib.util
import platform
import sys
from collections.abc import Iterator
from statistics import fmean
from typing import Any

from torchbrdf.cli.common import (
    Commands,
    Options,
    add_bands,
    add_reading,
    check_files,
    described,
    read_settings,
    say,
    short,
)
from torchbrdf.errors import DataError, UsageError

# Of a picture made of characters, among facts.
PLOT = "plot"
DESCRIPTION = """\
Say what measured BRDF files hold: format, size, invalid entries, whether a file is MERL's own, diffuse and gloss.

  torchbrdf info nickel.binary
  torchbrdf info paint.astm --json
  torchbrdf info --zoo
  torchbrdf info zoo:nickel:gltf
  torchbrdf info --system
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("info", help="say what a file holds"), DESCRIPTION, "files")
    parser.add_argument("files", nargs="*", help="measured BRDFs, or folders of them")
    parser.add_argument(
        "--zoo", action="store_true", help="list the models that come with torchbrdf, and how near they are"
    )
    parser.add_argument("--json", action="store_true", help="print what files hold as JSON, by path")
    parser.add_argument("--system", action="store_true", help="say what this machine offers: torch, CUDA, OpenGL, ...")
    add_reading(parser)
    add_bands(parser)
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf info`."""
    from torchbrdf.files import json_text

    settings = read_settings(options)
    if not (options.system or options.zoo):
        check_files(options.files)
    from torchbrdf.measured import describe
    from torchbrdf.measured.find import find_files

    if not (options.files or options.system or options.zoo):
        raise UsageError("info: expected files, --zoo or --system")
    if options.json and (options.system or options.zoo or not options.files):
        raise UsageError("info: --json: expected files, and neither --zoo nor --system")
    if options.system:
        _print_facts(_system_facts(), "")
    if options.zoo:
        say(*_zoo_lines())
    bad: list[DataError] = []
    files = find_files(options.files, bad) if options.files else []
    found: dict[str, object] = {}
    for k, path in enumerate(files):
        try:
            facts = describe(path, settings)
        except DataError as error:
            bad.append(error)
            continue
        if options.json:
            found[str(path)] = _plain(facts)
            continue
        if k or options.system or options.zoo:
            print()
        say(path)
        _print_facts(facts, "  ")
    if options.json and (found or not bad):
        print(json_text(found), end="")
    for one in bad:
        say(f"torchbrdf: {one}", to=sys.stderr)
    return 1 if bad else 0


def _plain(facts: dict[str, Any]) -> dict[str, Any]:
    """Facts as JSON has them: without pictures."""
    return {key: _plain(value) if isinstance(value, dict) else value for key, value in facts.items() if key != PLOT}


def _print_facts(facts: dict[str, object], indent: str) -> None:
    from torchbrdf.measured.coverage import lines_of

    for key, value in facts.items():
        if key == PLOT and isinstance(value, list):
            say(*(f"{indent}{line}" for line in lines_of(value, sys.stdout.encoding)))
        elif isinstance(value, dict):
            say(f"{indent}{key}")
            _print_facts(value, indent + "  ")
        else:
            say(f"{indent}{key:42s} {short(value)}")


def _zoo_lines() -> Iterator[str]:
    """Every material of the zoo, with the mean Delta E 76 of each of its models over the scenes that judged it."""
    from torchbrdf.lobes.zoo import SCHEME, zoo_names, zoo_records

    records = zoo_records()
    for name in zoo_names():
        own = [record for record in records if record["material"] == name]
        parts = [f"{record['model']} {_mean_delta_e(record):.1f}" for record in own]
        yield f"{SCHEME}{name:28s} {'  '.join(f'{part:12s}' for part in parts)}  {own[0]['source']}"
    yield f"Behind each model its mean Delta E 76 in pictures; {SCHEME}NAME is the first, {SCHEME}NAME:MODEL another."


def _mean_delta_e(record: dict[str, Any]) -> float:
    return fmean(scene["delta_e76"] for scene in record["pictures"].values())


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
