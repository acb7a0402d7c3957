"""The design's floors: imports only point down, and rooms of one floor stay apart."""

import ast
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

import torchbrdf

ROOT = Path(torchbrdf.__file__).parent

# Room -> floor. A room is a folder or a module of the package.
FLOORS = {
    "__main__": 7,
    "cli": 6,
    "recipes": 5,
    "recipe": 4,
    "report": 4,
    "fitting": 3,
    "render": 3,
    "study": 3,
    "perception": 3,
    "psychophysics": 3,
    "measured": 2,
    "lobes": 1,
    "losses": 1,
    "solvers": 1,
    "images": 1,
    "pairs": 0,
    "registry": 0,
    "errors": 0,
    "files": 0,
    "parallel": 0,
    "assets": 0,  # data
}
# Who may see whom on one floor: a study works in a run folder; pairs, the registry and files raise errors.
NEIGHBOURS = {("report", "recipe"), ("pairs", "errors"), ("registry", "errors"), ("files", "errors")}


def imported(tree: ast.Module, package: str) -> Iterator[tuple[int, str]]:
    """The line and the full name of everything imported anywhere in a module of `package`, names included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")
                base = ".".join([*parts[: len(parts) - node.level + 1], *([base] if base else [])])
            yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)


def room_of(name: str) -> str | None:
    """The room that a full name lives in; None for other people's packages and for the package itself."""
    head, *rest = name.split(".")
    if head != "torchbrdf" or not rest:
        return None
    return torchbrdf._HOME.get(rest[0], rest[0])


def violations(root: Path) -> Iterator[str]:
    """Every import that does not point down, in the modules of a package folder."""
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        if parts == ("__init__",):
            continue  # names the parts for type checkers and imports them at first use
        package = ".".join(["torchbrdf", *parts[:-1]])
        for line, name in imported(ast.parse(path.read_text()), package):
            here, there = parts[0], room_of(name)
            if name.startswith("torchbrdf.__") or there in (None, here) or (here, there) in NEIGHBOURS:
                continue
            where = f"{path.relative_to(root)}:{line}: {here} imports {there}"
            if here not in FLOORS or there not in FLOORS:
                yield f"{where}, of which one has no floor"
            elif FLOORS[here] <= FLOORS[there]:
                yield f"{where}, which is not below it"


def test_imports_point_down() -> None:
    assert list(violations(ROOT)) == []


def test_every_room_has_a_floor() -> None:
    rooms = {path.stem for path in ROOT.iterdir() if path.suffix == ".py" or any(path.glob("*.py"))}
    assert rooms - {"__init__"} <= set(FLOORS)


@pytest.mark.parametrize(
    ("module", "code", "expected"),
    [
        ("__main__.py", "from torchbrdf.cli import main", []),
        ("report/study.py", "from torchbrdf.recipe import RunFolder", []),
        ("losses/rms.py", "from torchbrdf.measured import load", ["losses/rms.py:1: losses imports measured"]),
        ("losses/rms.py", "from torchbrdf import Measured", ["losses/rms.py:1: losses imports measured"]),
        ("losses/rms.py", "from torchbrdf import lobes", ["losses/rms.py:1: losses imports lobes"]),
        ("losses/rms.py", "import torchbrdf.lobes.ward as w", ["losses/rms.py:1: losses imports lobes"]),
        ("losses/rms.py", "from ..images import tonemap", ["losses/rms.py:1: losses imports images"]),
        ("losses/rms.py", "from .. import fitting", ["losses/rms.py:1: losses imports fitting"]),
        (
            "images/deep/er.py",
            "from ...pairs import Pairs\nfrom ... import cli",
            ["images/deep/er.py:2: images imports"],
        ),
        ("render/scene.py", "def f():\n    from torchbrdf.fitting import fit", ["render/scene.py:2: render imports"]),
        ("recipe.py", "import torchbrdf.report", ["recipe.py:1: recipe imports report"]),
        ("pairs.py", "import torchbrdf.registry", ["pairs.py:1: pairs imports registry"]),
        ("recipe.py", "import torchbrdf.recipes", ["recipe.py:1: recipe imports recipes, which is not below it"]),
        ("losses/rms.py", "from torchbrdf.losses import base\nfrom . import log\nfrom .base import Loss", []),
        ("losses/rms.py", "from torchbrdf.pairs import Pairs\nimport torch, torch.nn\nimport torchbrdf", []),
        ("measured/gloss.py", "from torchbrdf.lobes import Ward", []),
        ("recipe.py", "from torchbrdf import __version__, fit, losses", []),
        ("cli.py", "import torchbrdf.recipe\nfrom torchbrdf.render import render", []),
        ("__init__.py", "from torchbrdf.cli import main", []),
    ],
)
def test_what_counts_as_pointing_down(tmp_path: Path, module: str, code: str, expected: list[str]) -> None:
    path = tmp_path / module
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(textwrap.dedent(code))
    found = list(violations(tmp_path))
    assert len(found) == len(expected)
    for line, start in zip(found, expected, strict=True):
        assert line.startswith(start)
