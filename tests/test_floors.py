"""The floors of docs/architecture.md: imports only point down, and rooms of one floor stay apart."""

import ast
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import torchbrdf

ROOT = Path(torchbrdf.__file__).parent
DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "architecture.md"


@dataclass(frozen=True)
class Floors:
    """Room to floor, and who may see whom on one floor. A room is a folder or a module of the package."""

    floor: dict[str, int]
    neighbours: set[tuple[str, str]]


def floors(document: str) -> Floors:
    """The two tables of the section "Floors", each room in backquotes."""
    section = re.search(r"^## Floors\n(.*?)(?=^## |\Z)", document, re.MULTILINE | re.DOTALL)
    assert section, 'docs/architecture.md: expected a section "## Floors"'
    floor: dict[str, int] = {}
    neighbours = set()
    for line in section[1].splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|") or len(cells) < 2:
            continue
        rooms = re.findall(r"`(\w+)`", cells[1])
        if cells[0].isdigit():
            assert not set(rooms) & set(floor), f"docs/architecture.md: a room stands on two floors: {line}"
            floor |= dict.fromkeys(rooms, int(cells[0]))
        elif owner := re.fullmatch(r"`(\w+)`", cells[0]):
            neighbours |= {(owner[1], room) for room in rooms}
    return Floors(floor, neighbours)


FLOORS = floors(DOCUMENT.read_text(encoding="utf-8"))


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
    if rest[0] in torchbrdf.__all__:
        return str(getattr(torchbrdf, rest[0]).__module__.split(".")[1])
    return rest[0]


def modules(root: Path) -> Iterator[Path]:
    """Every module of a package folder, those of linked folders too."""
    for entry in sorted(root.iterdir()):
        yield from sorted(entry.rglob("*.py")) if entry.is_dir() else [entry] if entry.suffix == ".py" else []


def violations(root: Path, floors: Floors = FLOORS) -> Iterator[str]:
    """Every import that does not point down, in the modules of a package folder."""
    for path in modules(root):
        parts = path.relative_to(root).with_suffix("").parts
        if parts == ("__init__",):
            continue  # names the parts for type checkers and imports them at first use
        package = ".".join(["torchbrdf", *parts[:-1]])
        for line, name in imported(ast.parse(path.read_text(encoding="utf-8")), package):
            here, there = parts[0], room_of(name)
            if name.startswith("torchbrdf.__") or there in (None, here) or (here, there) in floors.neighbours:
                continue
            where = f"{path.relative_to(root)}:{line}: {here} imports {there}"
            if here not in floors.floor or there not in floors.floor:
                yield f"{where}, of which one has no floor"
            elif floors.floor[here] <= floors.floor[there]:
                yield f"{where}, which is not below it"


def test_imports_point_down() -> None:
    assert list(violations(ROOT)) == []


def test_linked_folders_are_looked_at() -> None:
    seen = {path.relative_to(ROOT).parts[0] for path in modules(ROOT)}
    assert {"recipes", "assets", "lobes", "pairs.py"} <= seen


def test_the_document_names_the_rooms_that_there_are() -> None:
    rooms = {path.stem for path in ROOT.iterdir() if path.suffix == ".py" or (path.is_dir() and any(path.glob("*.py")))}
    assert rooms - {"__init__"} == set(FLOORS.floor)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("| 1 | `lobes`, ", "| 1 | ", "lobes, of which one has no floor"),
        ("`pairs`, `quantities`", "`quantities`", "pairs, of which one has no floor"),
        ("| 8 | `cli` |", "| 3 | `cli` |", "cli imports fitting, which is not below it"),
        ("| 7 | `recipes` |", "| 2 | `recipes` |", "recipes imports fitting, which is not below it"),
        (
            "| `errors`, `precision`, `quantities` |",
            "| `files` |",
            "pairs imports errors, which is not below it",
        ),
    ],
)
def test_the_document_decides(old: str, new: str, expected: str) -> None:
    document = DOCUMENT.read_text(encoding="utf-8")
    assert document.count(old) == 1
    assert any(line.endswith(expected) for line in violations(ROOT, floors(document.replace(old, new))))


def test_a_room_stands_on_one_floor() -> None:
    with pytest.raises(AssertionError, match="a room stands on two floors"):
        floors("## Floors\n\n| 1 | `lobes` |\n| 0 | `lobes` |\n")


@pytest.mark.parametrize(
    ("module", "code", "expected"),
    [
        ("__main__.py", "from torchbrdf.cli import main", []),
        ("report/page.py", "from torchbrdf.recipe import RunFolder", []),
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
