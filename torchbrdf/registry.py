"""Name -> thing, for lobes, losses, formats, exporters, recipes and more: our own, and those of other packages."""

import difflib
import importlib
import logging
import pkgutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from torchbrdf.errors import UsageError, shown
from torchbrdf.sources import Registrations, registrations

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")
Registered = TypeVar("Registered")

# Characters of a name.
LONGEST = 64

log = logging.getLogger("torchbrdf")


def unknown(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """The error for a name that is not there, with the nearest that is.

    Args:
        kind: what the name was to name.
        name: the name.
        known: the names that there are.

    Returns:
        The error, to be raised.

    Example:
        >>> from torchbrdf.registry import unknown
        >>> print(unknown("lobe", "wrad", ["lambert", "ward"]))
        unknown lobe 'wrad'; expected one of lambert, ward; did you mean 'ward'?
    """
    known = sorted(known)
    near = difflib.get_close_matches(name[:100], known, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    said = f"unknown {kind} {shown(name)}" if name.strip() else f"{kind}: expected a name, found {shown(name)}"
    return UsageError(f"{said}; expected one of {', '.join(known)}{hint}")


class Registry(Mapping[str, T], Generic[T]):
    """The things of one kind by name: those that modules of a package register, and those of other packages.

    A file put into the package is found by itself: looking a name up imports the module whose source registers it, and
    every module where the sources do not say. Names that are not there are looked for among the entry points of
    `group` of all installed packages, which are loaded when they are asked for or listed. One that cannot be loaded, or
    whose name is taken, is left out with a warning that names its package; asking for it by name says why.

    Args:
        kind: what things these are, for messages.
        package: the package whose modules register things.
        group: the group of entry points in which other packages offer more; none without.
        base: gives the class that things are subclasses of; None: things are anything that can be called; a registry
            without it takes anything.

    Example:
        >>> from torchbrdf.lobes import LOBES
        >>> "ward" in LOBES, LOBES["ward"].__name__
        (True, 'Ward')
    """

    def __init__(self, kind: str, package: str, group: str = "", base: Callable[[], type | None] | None = None) -> None:
        self.kind, self.package, self.group, self.base = kind, package, group, base
        self._things: dict[str, T] = {}
        self._aliases: dict[str, str] = {}
        self._complete = False
        self._offers: dict[str, EntryPoint] | None = None
        self._broken: dict[str, UsageError] = {}

    def register(self, name: str) -> Callable[[Registered], Registered]:
        """Register what is decorated.

        Args:
            name: the name to find it by, of letters, digits and underscores.

        Returns:
            A decorator that gives back what it decorates.

        Raises:
            UsageError: the name is taken, or none; or what is decorated is of another kind.

        Example:
            >>> from torchbrdf.registry import Registry
            >>> greetings = Registry("greeting", "json")
            >>> greetings.register("hello")(print)
            <built-in function print>
        """
        if not (isinstance(name, str) and name.isidentifier() and name.isascii() and len(name) <= LONGEST):
            raise UsageError(f"{self.kind}: expected a name of letters, digits and underscores, found {shown(name)}")

        def put(thing: Registered) -> Registered:
            if name in self._things:
                both = f"{shown(self._things[name])} and {shown(thing)}"
                raise UsageError(f"{self.kind} {name!r} is registered twice: {both}")
            self._check(name, thing)
            self._things[name] = thing  # type: ignore[assignment]  # decorators keep the type of what they decorate
            return thing

        return put

    def _check(self, name: str, thing: object) -> None:
        """A UsageError for a thing of another kind."""
        if self.base is None:
            return
        base = self.base()
        if not (callable(thing) if base is None else isinstance(thing, type) and issubclass(thing, base)):
            wanted = "a function" if base is None else f"a subclass of {base.__name__}"
            raise UsageError(f"{self.kind} {name!r}: expected {wanted}, found {shown(thing)}")

    def alias(self, old: str, new: str) -> None:
        """Let a former name go on finding a thing; it is not listed.

        Args:
            old: the former name.
            new: the registered name.

        Example:
            >>> from torchbrdf.images import DIFFERENCES
            >>> DIFFERENCES["delta_e"] is DIFFERENCES["delta_e76"], "delta_e" in list(DIFFERENCES)
            (True, False)
        """
        self._aliases[old] = new

    def canonical(self, name: str) -> str:
        """The name that a thing is listed under, in the place of a former one.

        Args:
            name: any name, also of nothing that is registered.

        Example:
            >>> from torchbrdf.images import DIFFERENCES
            >>> DIFFERENCES.canonical("delta_e")
            'delta_e76'
        """
        if name in self._things or name in self._sources.modules:
            return name
        return self._aliases.get(name) or self._sources.aliases.get(name, name)

    def check(self, name: str, *also: str) -> None:
        """Refuse a name that nothing has, without importing what has it: before there is work, and before torch is.

        Args:
            name: the name.
            also: what else it may be.

        Raises:
            UsageError: there is no such name.

        Example:
            >>> from torchbrdf.kinds import LOSSES
            >>> LOSSES.check("cube_root")
        """
        if name not in also and name not in self:
            raise unknown(self.kind, name, {*self.names(), *also})

    def names(self) -> list[str]:
        """The names that there are, without importing what has them; of other packages also what cannot be loaded.

        Example:
            >>> from torchbrdf.kinds import LOBES
            >>> "ward" in LOBES.names()
            True
        """
        return sorted({*self._names(), *self._offered()})

    def name_of(self, thing: object) -> str | None:
        """The name that a thing is registered or offered under, without loading any other.

        Args:
            thing: a class, function or object.

        Returns:
            The name; None if it has none.

        Example:
            >>> from torchbrdf.lobes import LOBES, Ward
            >>> LOBES.name_of(Ward), LOBES.name_of(print)
            ('ward', None)
        """

        def in_memory() -> str | None:
            return next((name for name, own in self._things.items() if own == thing), None)

        name = in_memory()
        if name is None and not self._complete:  # who has a thing has mostly imported what registers it
            self._own()
            name = in_memory()
        return name or next((name for name, offer in self._offered().items() if _loaded(offer) is thing), None)

    @property
    def _sources(self) -> Registrations:
        """What the package's sources say; nothing where its modules, which are all loaded, or do not say, tell."""
        found = None if self._complete else registrations(self.package)
        if found is None:
            self._own()
        return found or Registrations({}, {})

    def _names(self) -> set[str]:
        """The names that the package's modules register, and those of what has been loaded of other packages."""
        return {*self._sources.modules, *self._things}

    def _find(self, name: str) -> T | None:
        """A thing of the package by its name, after importing what registers it."""
        if name not in self._things and not self._complete:
            module = self._sources.modules.get(name)
            if module is not None:
                importlib.import_module(module)
        return self._things.get(name)

    def _own(self) -> dict[str, T]:
        """What the package's modules register, and what has been loaded of other packages."""
        if not self._complete:
            package = importlib.import_module(self.package)
            for module in pkgutil.iter_modules(package.__path__):
                importlib.import_module(f"{self.package}.{module.name}")
            self._complete = True
        return self._things

    def _offered(self) -> dict[str, "EntryPoint"]:
        """The entry points of other packages whose names are free, not loaded yet."""
        if self._offers is None:
            from importlib.metadata import entry_points

            own, self._offers = {*self._names(), *self._aliases, *self._sources.aliases}, {}
            offers = entry_points(group=self.group) if self.group else ()
            for offer in sorted(offers, key=lambda offer: (offer.name, _package(offer))):
                name = offer.name
                if name not in own:
                    if name not in self._offers:
                        self._offers[name] = offer
                        continue
                    owner = _package(self._offers[name])
                elif name in self._things and self._things[name] is _loaded(offer):
                    continue  # its module was imported before, and registered it
                else:
                    owner = "torchbrdf"
                log.warning(
                    "torchbrdf: %s %r of package %s is left out: the name is taken by %s; expected another name",
                    *(self.kind, name, _package(offer), owner),
                )
        return self._offers

    def _load(self, name: str) -> T:
        """The thing of another package; a UsageError that names the package if it cannot be had."""
        if name in self._things:
            return self._things[name]
        if name not in self._broken:
            offer = self._offered()[name]
            try:
                thing = offer.load()
                self._check(name, thing)
            except (Exception, SystemExit) as error:  # whatever other people's code raises
                inner = error.__cause__ if str(error).startswith("Error calling __set_name__") else None
                reason = " ".join(f"{type(inner or error).__name__}: {inner or error}".split())
                where = f"{self.kind} {name!r} of package {_package(offer)}"
                self._broken[name] = UsageError(f"{where} cannot be loaded from {offer.value}: {reason}")
                self._broken[name].__cause__ = error
            else:
                return self._things.setdefault(name, thing)
        raise self._broken[name]

    def _listed(self) -> dict[str, T]:
        """Everything that can be had; what cannot is said once."""
        self._own()
        for name in self._offered():
            said = name in self._broken
            try:
                self._load(name)
            except UsageError as error:
                if not said:
                    log.warning("torchbrdf: %s", error)
        return self._things

    def __getitem__(self, name: str) -> T:
        name = self.canonical(name)
        found = self._find(name)
        if found is not None:
            return found
        if name in self._offered():
            return self._load(name)
        raise unknown(self.kind, name, self._listed())

    def __contains__(self, name: object) -> bool:
        return name in self._names() or self.canonical(name) != name or name in self._offered()  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._listed()))

    def __len__(self) -> int:
        return len(self._listed())


def _package(offer: "EntryPoint") -> str:
    """The package that an entry point comes with."""
    return offer.dist.name if offer.dist is not None else offer.module


def _loaded(offer: "EntryPoint") -> Any:
    """What an entry point names if its module is in memory already, else None."""
    return getattr(sys.modules.get(offer.module), offer.attr, None)
