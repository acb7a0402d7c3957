"""What the site shows and nobody has to write twice: runs the examples, lists the public names, takes in other files.

MkDocs calls the functions by their names, see https://www.mkdocs.org/dev-guide/plugins/#events.
"""

import ast
import os
import posixpath
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "torchbrdf"
# Pages whose text stands elsewhere, for people who read the repository.
ELSEWHERE = {
    "benchmarks.md": "benchmarks/README.md",
    "changelog.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
}
IN_REPOSITORY = {source: page for page, source in ELSEWHERE.items()}
REFERENCE = """\
# `{name}`

::: {name}
    options:
      members: [{members}]
"""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Puts the examples and the reference into the navigation."""
    for section in config.nav:
        if isinstance(section, dict) and "Examples" in section:
            section["Examples"] = [f"examples/{script.stem}.md" for script in _examples()]
        if isinstance(section, dict) and "Reference" in section:
            section["Reference"] = [f"reference/{name}.md" for name in _public_modules()]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are made, and the pictures of the repository."""
    for page, source in ELSEWHERE.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    for name, members in _public_modules().items():
        text = REFERENCE.format(name=name, members=", ".join(members))
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    for picture in sorted([*ROOT.glob("assets/*.jpg"), *ROOT.glob("assets/*.png")]):
        files.append(File.generated(config, f"assets/{picture.name}", abs_src_path=str(picture)))
    with ThreadPoolExecutor(2) as pool:
        for made in pool.map(lambda script: _run(script, config), _examples()):
            for file in made:
                files.append(file)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns links that hold in the repository into those of the site."""
    here = page.file.src_uri
    folder = posixpath.dirname(ELSEWHERE.get(here, f"docs/{here}"))

    def on_the_site(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, link[1]))
        target = re.sub(r"^(docs/examples/\w+)\.py$", r"\1.md", target)  # the page that is made of a script
        target = IN_REPOSITORY.get(target, target.removeprefix("docs/"))
        if files.get_file_from_path(target) is None:
            return link[0]
        return f"]({posixpath.relpath(target, posixpath.dirname(here) or '.')}"

    return re.sub(r"\]\(([^)#:\s]+)(?=[)#])", on_the_site, markdown)


def _public_modules() -> dict[str, list[str]]:
    """The package, and every module in it with what it offers; a module that a package offers comes after it."""
    found: dict[str, list[str]] = {}
    pending = [("torchbrdf", PACKAGE)]
    pending += [(f"torchbrdf.{path.stem}", path) for path in sorted(PACKAGE.iterdir()) if not path.name.startswith("_")]
    while pending:
        name, path = pending.pop(0)
        source = path / "__init__.py" if path.is_dir() else path
        if source.suffix != ".py" or not source.is_file():
            continue
        body = ast.parse(source.read_text(encoding="utf-8")).body
        modules = [
            alias.name
            for node in body
            if isinstance(node, ast.ImportFrom) and node.module == name
            for alias in node.names
        ]
        names = _names(body, source)
        pending[:0] = [(f"{name}.{module}", path / f"{module}.py") for module in names if module in modules]
        if members := [member for member in names if member not in modules]:
            found[name] = members
    return found


def _names(body: list[ast.stmt], source: Path) -> list[str]:
    """What a module offers: its `__all__`; of a file without one, the public classes and functions defined in it."""
    for node in body:
        if isinstance(node, ast.Assign) and any(getattr(target, "id", "") == "__all__" for target in node.targets):
            return list(ast.literal_eval(node.value))
    if source.name == "__init__.py":
        return []
    defined = [node.name for node in body if isinstance(node, ast.ClassDef | ast.FunctionDef)]
    return [name for name in defined if not name.startswith("_")]


def _examples() -> list[Path]:
    return sorted((ROOT / "docs" / "examples").glob("*.py"))


def _run(script: Path, config: MkDocsConfig) -> list[File]:
    """Runs an example in an empty folder; the page with its text, code and output, and the pictures it saved."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, str(script)], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise PluginError(f"{script.relative_to(ROOT)} failed:\n{done.stderr}")
        pictures = {path.name: path.read_bytes() for path in sorted(Path(folder).glob("*.png"))}
    if not pictures:
        raise PluginError(f"{script.relative_to(ROOT)}: expected at least one .png in the working folder, found none")
    code = script.read_text(encoding="utf-8")
    text = ast.get_docstring(ast.parse(code)) or ""
    body = code.split('"""', 2)[2].strip()
    title, _, rest = text.partition("\n")
    shown = "\n\n".join(f"![{title}]({name})" for name in pictures)
    page = f"# {title.rstrip('.')}\n{rest}\n\n{shown}\n\n```python\n{body}\n```\n"
    if done.stdout.strip():
        page += f"\nIt prints:\n\n```text\n{done.stdout.rstrip()}\n```\n"
    page += f"\nThe script: `docs/examples/{script.name}`.\n"
    files = [File.generated(config, f"examples/{name}", content=content) for name, content in pictures.items()]
    return [File.generated(config, f"examples/{script.stem}.md", content=page), *files]
