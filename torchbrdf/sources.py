"""What the modules of a package register by name, told from their sources: so that a name costs no import."""

import ast
import functools
import pkgutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.machinery import PathFinder
from pathlib import Path
from types import MappingProxyType

# Of `LOBES.register("ward")` and `LOSSES.alias("cosine", "cosine_rms")`: what comes before the first bracket.
_REGISTER, _ALIAS = "register", "alias"


@dataclass(frozen=True)
class Registrations:
    """What the sources of a package register.

    Args:
        modules: The module that registers each name.
        aliases: The name that each former name stands for.
    """

    modules: Mapping[str, str]
    aliases: Mapping[str, str]


def registrations(package: str) -> Registrations | None:
    """What a package's modules register, without importing them.

    Only literal names are seen: `LOBES.register("ward")`, as a decorator or called, of a registry in capitals.

    Args:
        package: The package's full name.

    Returns:
        The names; None if the sources do not say: there are none, or a name is worked out.

    Example:
        >>> from torchbrdf.sources import registrations
        >>> registrations("torchbrdf.lobes").modules["ward"]
        'torchbrdf.lobes.ward'
    """
    return _registrations(package, _folders(package))


@functools.cache
def _registrations(package: str, folders: tuple[str, ...]) -> Registrations | None:
    modules: dict[str, str] = {}
    aliases: dict[str, str] = {}
    try:
        for module, path in _files(package, folders):
            for call in _calls(path.read_text(encoding="utf-8")):
                names = [one.value if isinstance(one, ast.Constant) else None for one in call.args]
                if not names or not all(isinstance(name, str) for name in names):
                    return None
                if isinstance(call.func, ast.Attribute) and call.func.attr == _ALIAS:
                    aliases[str(names[0])] = str(names[-1])
                else:
                    modules[str(names[0])] = module
    except (OSError, SyntaxError, ValueError):  # compiled, or nothing that Python reads: importing it says why
        return None
    return Registrations(MappingProxyType(modules), MappingProxyType(aliases)) if folders else None


def _folders(package: str) -> tuple[str, ...]:
    """The folders of a package, which is not imported for it; none if they are not where Python looks for files."""
    name, path = "", None
    for part in package.split("."):
        name = f"{name}.{part}" if name else part
        known = getattr(sys.modules.get(name), "__path__", None)
        if known is None:
            spec = PathFinder.find_spec(name, path)
            known = spec.submodule_search_locations if spec is not None else None
        if known is None:
            return ()
        path = list(known)
    return tuple(path or ())


def _files(package: str, folders: tuple[str, ...]) -> Iterator[tuple[str, Path]]:
    """Every module of a package with its source; files of a package within it count as that package."""
    yield from ((package, Path(folder) / "__init__.py") for folder in folders)
    for found in pkgutil.iter_modules(folders):
        place = Path(getattr(found.module_finder, "path", "")) / found.name
        files = sorted(place.rglob("*.py")) if found.ispkg else [place.with_suffix(".py")]
        yield from ((f"{package}.{found.name}", path) for path in files)


def _calls(source: str) -> Iterator[ast.Call]:
    """The calls of `register` and `alias` of a registry."""
    if f".{_REGISTER}(" not in source and f".{_ALIAS}(" not in source:
        return  # to parse everything would take longer than the names are worth
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            owner = node.func.value
            if node.func.attr in (_REGISTER, _ALIAS) and isinstance(owner, ast.Name) and owner.id.isupper():
                yield node
