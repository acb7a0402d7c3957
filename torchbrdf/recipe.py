"""Recipes: what a run does, with typed settings, a folder that holds all of it, and a log."""

import dataclasses
import importlib.util
import json
import logging
import platform
import sys
import time
import traceback
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from torchbrdf import bounds
from torchbrdf.errors import UsageError, shown
from torchbrdf.files import write_json
from torchbrdf.progress import Progress, quiet
from torchbrdf.reading import read_json
from torchbrdf.registry import Registry, unknown

RECIPES: Registry[type["Recipe"]] = Registry("recipe", "torchbrdf.recipes", "torchbrdf.recipes", lambda: Recipe)


@dataclass(frozen=True)
class Recipe:
    """The settings of a run. A recipe is a file with a registered frozen dataclass that extends this one.

    Every field has a type and a default, and `field(metadata={...})`: "help" where its name does not say enough, the
    bounds "low" and "high" of every number, and "none", more words that stand for None. `__post_init__` refuses values
    that cannot be: one that does more calls this one. `steps` does the work and returns the report's path.

    Args:
        quick: a small version, to see that all works.
        seed: of everything that is drawn at random.

    Example:
        >>> from dataclasses import dataclass
        >>> from torchbrdf import Recipe
        >>> @dataclass(frozen=True)
        ... class Greeting(Recipe):
        ...     name = "greeting"
        ...     word: str = "hello"
        ...     def steps(self, folder):
        ...         (folder.path / "report.txt").write_text(self.word)
        ...         return folder.path / "report.txt"
        >>> Greeting(quick=True)
        Greeting(quick=True, seed=0, word='hello')
    """

    name: ClassVar[str]

    quick: bool = dataclasses.field(default=False, metadata={"help": "a small version, to see that all works"})
    seed: int = dataclasses.field(
        default=0,
        metadata={
            "help": "seed of everything that is drawn at random",
            "low": bounds.SEEDS[0],
            "high": bounds.SEEDS[1],
        },
    )

    def __post_init__(self) -> None:
        """Refuse numbers that are not finite, or out of the bounds that their fields declare."""
        hints = typing.get_type_hints(type(self))
        for one in dataclasses.fields(self):
            value, (kind, _) = getattr(self, one.name), _inner(hints[one.name])
            for item in value if isinstance(value, tuple) else [value]:
                if kind in (int, float) and item is not None:
                    _number(item, kind, f"{self.name}: {one.name}", one.metadata)

    def steps(self, folder: "RunFolder") -> Path:
        """Do the work in this folder.

        Args:
            folder: where everything goes, with a log and progress.

        Returns:
            The path of the report.
        """
        raise NotImplementedError(f"{type(self).__name__}: a recipe gives steps(folder)")


class RunFolder:
    """The folder of a run: its path, a log, and progress for whoever watches."""

    def __init__(self, path: Path, progress: Callable[[str], Progress] | None = None) -> None:
        self.path = path
        self.progress = progress or (lambda label: quiet)  # of each kind of work, by a label
        self._began = time.perf_counter()

    def log(self, line: str) -> None:
        """Add a line to log.txt."""
        with (self.path / "log.txt").open("a", encoding="utf-8") as log:
            log.write(f"{time.perf_counter() - self._began:8.1f} s  {line}\n")

    def warn(self, line: str) -> None:
        """Add a line to log.txt and say it: something was left out, but the run goes on."""
        self.log(line)
        logging.getLogger("torchbrdf").warning("torchbrdf: %s", line)


def find_recipe(name: str) -> type[Recipe]:
    """Find a recipe by its name, our own or another package's, or by the path of a Python file that holds one.

    A file is a program, and finding its recipe runs it, with all that you may do: take only files that you trust.
    Modules that lie beside it can be imported while it is loaded.

    Args:
        name: a registered name, or a path that ends in .py.

    Returns:
        The class, of which `configure` makes a recipe.

    Raises:
        UsageError: there is no such name or file, it fails, or it holds no recipe or several.

    Example:
        >>> from torchbrdf.recipe import find_recipe
        >>> find_recipe("fores2012").__name__
        'Fores2012'
    """
    if not name.endswith(".py"):
        return RECIPES[name]
    path = Path(name)
    if not path.is_file():
        raise UsageError(f"recipe {name}: no such file")
    spec = importlib.util.spec_from_file_location(f"torchbrdf_recipe_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"recipe {name}: expected a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # whatever other people's code raises
        raise UsageError(
            f"recipe {name}: cannot be loaded: {type(error).__name__}: {error}{_line(error, path)}"
        ) from error
    finally:
        sys.path.remove(folder)
    found = [
        thing
        for thing in vars(module).values()
        if isinstance(thing, type) and issubclass(thing, Recipe) and thing.__module__ == spec.name
    ]
    if len(found) != 1:
        raise UsageError(f"recipe {name}: expected one subclass of Recipe, found {len(found)}")
    if not isinstance(getattr(found[0], "name", None), str):
        raise UsageError(f"recipe {name}: expected a name, such as name = {path.stem!r}, in {found[0].__name__}")
    return found[0]


def _line(error: BaseException, path: Path) -> str:
    """Where in a file an error came up, in words, if it did there."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == path]
    return f" (line {lines[-1]})" if lines else ""


def configure(kind: type[Recipe], settings: Mapping[str, str]) -> Recipe:
    """A recipe with some settings given as text, as on the command line: typed, and unknown ones refused."""
    hints = typing.get_type_hints(kind)
    known = {field.name: field for field in dataclasses.fields(kind)}
    values = {}
    for key, text in settings.items():
        if key not in known:
            raise unknown(f"setting of {kind.name}", key, known)
        values[key] = parse(text, hints[key], f"{kind.name}: {key}", known[key].metadata)
    return kind(**values)


def parse(text: str, expected: Any, where: str, metadata: Mapping[str, Any] | None = None) -> Any:
    """A value from text.

    Args:
        text: as on the command line.
        expected: bool, int, float, str, a tuple of one of them, or that or None.
        where: what to call it in an error.
        metadata: of the setting's field: bounds, and words for None.

    Returns:
        The value.

    Raises:
        UsageError: it is of another type, not finite, or out of bounds.

    Example:
        >>> from torchbrdf.recipe import parse
        >>> parse("1,2", tuple[int, ...], "observers", {"low": 1, "high": 9})
        (1, 2)
    """
    metadata = metadata or {}
    kind, may_be_none = _inner(expected)
    if may_be_none and text.lower() in ("none", *metadata.get("none", ())):
        return None
    if typing.get_origin(expected) is tuple:
        return tuple(parse(part.strip(), kind, where, metadata) for part in text.split(",") if part.strip())
    if kind is bool:
        words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
        if text.lower() not in words:
            raise UsageError(f"{where}: expected true or false, found {shown(text, 40)}")
        return words[text.lower()]
    if kind is str:
        if not text.isprintable():
            raise UsageError(f"{where}: expected printable characters, found {shown(text, 40)}")
        return text
    if kind in (int, float):
        return _number(text, kind, where, metadata)
    try:
        return kind(text)
    except (TypeError, ValueError):
        raise UsageError(f"{where}: expected {getattr(kind, '__name__', kind)}, found {shown(text, 40)}") from None


def _inner(expected: Any) -> tuple[Any, bool]:
    """The type of a setting, or of the items of one that is a tuple, and whether it may be None."""
    if typing.get_origin(expected) in (types.UnionType, typing.Union):
        options = typing.get_args(expected)
        return _inner(next(one for one in options if one is not types.NoneType))[0], types.NoneType in options
    if typing.get_origin(expected) is tuple:
        return typing.get_args(expected)[0], False
    return expected, False


def _number(value: object, kind: type, where: str, metadata: Mapping[str, Any]) -> int | float:
    """A number within the bounds that a setting's field declares."""
    declared = {key: metadata[key] for key in ("low", "high") if key in metadata}
    try:
        return bounds.whole(value, **declared) if kind is int else bounds.number(value, **declared)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None


def describe(kind: type[Recipe]) -> str:
    """The settings of a recipe with their defaults, a line each."""
    lines = [f"{kind.name}: {(kind.__doc__ or '').splitlines()[0]}"]
    for field in dataclasses.fields(kind):
        default = ",".join(map(str, field.default)) if isinstance(field.default, tuple) else str(field.default)
        said = [str(field.metadata.get("help", "")), _range(field.metadata)]
        lines.append(f"  {f'{field.name}={default}':40s} {'; '.join(filter(None, said))}".rstrip())
    return "\n".join(lines)


def _range(metadata: Mapping[str, Any]) -> str:
    """The bounds of a setting in words; of a seed, which takes any that people think of, none."""
    low, high = metadata.get("low"), metadata.get("high")
    if low is None or high is None or (low, high) == bounds.SEEDS:
        return ""
    return " to ".join(f"{bound:g}" if isinstance(bound, float) else str(bound) for bound in (low, high))


def versions() -> dict[str, str]:
    """The versions that a result depends on."""
    from importlib.metadata import version

    names = ("torchbrdf", "torch", "kornia", "numpy", "scipy", "trimesh", "OpenEXR", "matplotlib")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


def run(recipe: Recipe, out: Path | str, progress: Callable[[str], Progress] | None = None) -> Path:
    """Run a recipe in a folder.

    The folder gets `recipe.json`, with everything needed to repeat the run. Running the same recipe again in the same
    folder takes up what is finished and does only the rest; a folder of another recipe is refused.

    Args:
        recipe: what to run, with its settings.
        out: the folder; made if it is not there.
        progress: for each kind of work, `progress(label)` gives what is called with `(done, total)`.

    Returns:
        The path of the report.

    Raises:
        UsageError: the folder holds another run, or other files.
        DataError: its recipe.json cannot be read.

    Example:
        >>> from torchbrdf.recipe import find_recipe, run
        >>> recipe = find_recipe("fores2012")(quick=True)
        >>> report = run(recipe, "runs/fores2012")  # doctest: +SKIP
    """
    out = Path(out)
    settings = json.loads(json.dumps(dataclasses.asdict(recipe)))
    record = {"recipe": recipe.name, "settings": settings, "versions": versions()}
    stored = out / "recipe.json"
    if stored.exists():
        before: dict[str, Any] = read_json(stored, dict[str, Any], "the JSON object of a run's settings")
        changed = [key for key in ("recipe", "settings", "versions") if before.get(key) != record[key]]
        if changed:
            raise UsageError(
                f"{out}: holds a run with other {' and '.join(changed)}; choose another folder, or remove it"
            )
    elif out.is_dir() and any(out.iterdir()):
        raise UsageError(f"{out}: expected an empty folder or one of an earlier run, found other files")
    write_json(stored, record)
    folder = RunFolder(out, progress)
    folder.log(f"{recipe.name} begins")
    report = recipe.steps(folder)
    folder.log(f"{recipe.name} is done: {report.name}")
    return report
