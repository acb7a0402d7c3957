"""What the documents show works: examples in docstrings, Python blocks, command lines, links."""

import contextlib
import doctest
import importlib
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

import torchbrdf
from torchbrdf.cli.commands import build_parser
from torchbrdf.registry import Registry

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path(torchbrdf.__file__).parent
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
# Pages that fit on whole tables.
SLOW = {"README.md", "docs/start.md", "docs/how-to/fit.md", "docs/how-to/match.md", "docs/how-to/compare-metrics.md"}


def page(path: Path) -> str:
    """How a page is called in the list of tests."""
    return str(path.relative_to(ROOT))


def blocks(path: Path, language: str) -> Iterator[tuple[int, str]]:
    """The fenced blocks of a page in one language, with the line that each begins in."""
    text = path.read_text(encoding="utf-8")
    for found in re.finditer(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        yield text[: found.start(1)].count("\n"), found[1]


def runnable() -> Iterator[object]:
    """Pages with Python in them."""
    for path in PAGES:
        if any(blocks(path, "python")):
            marks = [pytest.mark.slow] if page(path) in SLOW else []
            yield pytest.param(path, id=page(path), marks=marks)


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that pages speak of: nickel.binary, and a folder MERL/ with two tables."""
    from torchbrdf import load
    from torchbrdf.measured import standins, write_merl
    from torchbrdf.pairs import Pairs

    folder = tmp_path_factory.mktemp("files")
    (folder / "MERL").mkdir()
    h, d, phi = ((torch.arange(n, dtype=torch.float64) + 0.5) / n for n in (90, 90, 180))
    angles = torch.meshgrid(h.square() * torch.pi / 2, d * torch.pi / 2, phi * torch.pi, indexing="ij")
    measured = load(standins(), dtype=torch.float64)
    for name in ("aluminium", "nickel"):
        values = measured.batch([measured.names.index(name)]).at(
            Pairs.from_half_diff(*(a.reshape(1, -1) for a in angles))
        )
        write_merl(folder / "MERL" / f"{name}.binary", values.reshape(90, 90, 180, 3))
    (folder / "nickel.binary").hardlink_to(folder / "MERL" / "nickel.binary")
    return folder


@pytest.mark.parametrize("path", list(runnable()))
def test_python_blocks_run(
    path: Path, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The blocks of a page one after the other, as a reader would paste them."""
    code = list(blocks(path, "python"))
    if "MERL/" in "".join(block for _, block in code) or page(path) == "README.md":
        for file in request.getfixturevalue("files").iterdir():
            (tmp_path / file.name).symlink_to(file)
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(0)
    if any(".register(" in block for _, block in code):
        # In a process of its own: what it registers is not for other tests.
        script = tmp_path / "page.py"
        script.write_text("\n".join(block for _, block in code), encoding="utf-8")
        done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.fail(done.stderr, pytrace=False)
        return
    namespace: dict[str, object] = {"__name__": page(path)}
    with contextlib.redirect_stdout(io.StringIO()):
        for line, block in code:
            exec(compile("\n" * line + block, str(path), "exec"), namespace)  # errors name the line of the page


def modules_with_examples() -> Iterator[str]:
    """The modules of the package whose docstrings have examples."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if ">>> " in path.read_text(encoding="utf-8"):
            parts = ("torchbrdf", *path.relative_to(PACKAGE).with_suffix("").parts)
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.parametrize("name", list(modules_with_examples()))
def test_docstring_examples(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module(name)
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    report = io.StringIO()
    for example in doctest.DocTestFinder(exclude_empty=True).find(module):
        torch.manual_seed(0)
        runner.run(example, out=report.write)
    assert not runner.failures, report.getvalue()
    assert runner.tries


def prose(path: Path) -> str:
    """A page without its fenced blocks, whose lines are left empty."""
    text = path.read_text(encoding="utf-8")
    return re.sub(r"^```.*?^```$", lambda block: "\n" * block[0].count("\n"), text, flags=re.MULTILINE | re.DOTALL)


def commands(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The command lines of torchbrdf in the shell blocks of a page, and the runs that its sentences name."""
    lines = []
    for line, block in blocks(path, "sh"):
        for number, text in enumerate(block.splitlines(), start=line + 1):
            lines += [(number, part) for part in text.split("&&")]
    text = prose(path)
    for found in re.finditer(r"`(torchbrdf run [^`]+)`", text):
        lines.append((text[: found.start()].count("\n") + 1, found[1]))
    for number, text in lines:
        words = shlex.split(text, comments=True)
        if words[:1] == ["torchbrdf"]:
            yield number, words[1:]


def listed(registry: Registry[Any], name: str) -> None:
    """Refuses a name that the registry does not list, former names that it still finds included."""
    if name not in list(registry):
        raise LookupError(f"unknown {registry.kind} {name}")


@pytest.mark.parametrize("path", PAGES, ids=page)
def test_command_lines_are_understood(path: Path) -> None:
    """Options are known, and the names in them are registered."""
    from torchbrdf.cli.fit import OF_PICTURES
    from torchbrdf.images import DIFFERENCES
    from torchbrdf.lobes import LOBES
    from torchbrdf.losses import LOSSES
    from torchbrdf.perception import FORMULAS
    from torchbrdf.recipe import configure, find_recipe

    for number, words in commands(path):
        try:
            options = build_parser().parse_args(words)
            if words[0] == "fit":
                listed(LOBES, options.model)
                if options.loss in OF_PICTURES:
                    listed(DIFFERENCES, options.difference or "delta_e76")
                else:
                    listed(LOSSES, options.loss)
            if words[0] == "run" and words[1] not in ("list", "my_recipe.py"):
                settings = dict(setting.split("=", 1) for setting in options.settings)
                if "help" not in settings:
                    recipe = configure(find_recipe(options.recipe), settings)
                    for name in getattr(recipe, "losses", ()):
                        if ":" not in name and name not in FORMULAS:  # a metric of one's own, or a benchmark's
                            listed(LOSSES, name)
        except (Exception, SystemExit) as error:
            pytest.fail(f"{page(path)}:{number}: torchbrdf {shlex.join(words)}: {error!r}", pytrace=False)


def test_there_is_something_to_run() -> None:
    """A change of form must not turn the tests above into tests of nothing."""
    assert sum(1 for path in PAGES for _ in blocks(path, "python")) >= 25
    assert sum(1 for path in PAGES for _ in commands(path)) >= 30


@pytest.mark.parametrize("path", PAGES, ids=page)
def test_links_lead_somewhere(path: Path) -> None:
    """In the repository as it is; the site's own links are checked by `mkdocs build --strict`."""
    for link in re.findall(r"\]\(([^)#\s]+)[^)]*\)", prose(path)):
        if re.match(r"\w+:", link):
            continue
        assert (path.parent / link).exists(), f"{page(path)}: {link} leads nowhere"
