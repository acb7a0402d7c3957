"""Name -> thing, for lobes, losses, formats and recipes: a file put into the right folder is found by itself."""

import difflib
import importlib
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Generic, TypeVar

from torchbrdf.errors import UsageError

T = TypeVar("T")


def unknown(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """The error for a name that is not there, with the nearest that is."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return UsageError(f"unknown {kind} {name!r}; expected one of {', '.join(known)}{hint}")


class Registry(Mapping[str, T], Generic[T]):
    """The registered things of one kind. Looking one up first imports every module of `package`.

    aliases: names that a thing had before, which find it, but are not listed.
    """

    def __init__(self, kind: str, package: str, aliases: Mapping[str, str] | None = None) -> None:
        self.kind, self.package, self.aliases = kind, package, aliases or {}
        self._things: dict[str, T] = {}
        self._complete = False

    def register(self, name: str) -> Callable[[T], T]:
        """A decorator that registers what it decorates."""

        def put(thing: T) -> T:
            if name in self._things:
                raise UsageError(f"{self.kind} {name!r} is registered twice: {self._things[name]!r} and {thing!r}")
            self._things[name] = thing
            return thing

        return put

    def canonical(self, name: str) -> str:
        """The name that a thing is listed under, in the place of an alias."""
        return self.aliases.get(name, name)

    def _all(self) -> dict[str, T]:
        if not self._complete:
            package = importlib.import_module(self.package)
            for module in pkgutil.iter_modules(package.__path__):
                importlib.import_module(f"{self.package}.{module.name}")
            self._complete = True
        return self._things

    def __getitem__(self, name: str) -> T:
        things, name = self._all(), self.canonical(name)
        if name not in things:
            raise unknown(self.kind, name, things)
        return things[name]

    def __contains__(self, name: object) -> bool:
        return (self.canonical(name) if isinstance(name, str) else name) in self._all()

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._all()))

    def __len__(self) -> int:
        return len(self._all())
