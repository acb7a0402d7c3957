"""Who may ask a server: by the name that it is asked under, by the page that asks, and by how often it does."""

import ipaddress
import re
import socket
import threading
import time
from dataclasses import dataclass
from urllib.parse import urlsplit

from torchbrdf.errors import UsageError, shown

# A name or an address, and a port, as browsers send them.
HOST = re.compile(r"(\[[0-9a-f:.]+\]|[0-9a-z._-]+)(?::\d{1,5})?")
PREFIX = re.compile(r"(?:/[0-9A-Za-z._~-]+)*")
# What paths of the page begin with. A proxy may take a prefix off or not, so it must not look like one of them.
PATHS = ("begin", "o", "page")
KEYS = 10_000


@dataclass(frozen=True)
class Site:
    """The names that a server goes by.

    Args:
        names: Of hosts, in small letters. An address in numbers needs no place here, nor does localhost.
        origin: Of the pages that observers open where these come through a proxy: "https://study.example".
        prefix: Before all paths there: "" or "/study".
    """

    names: frozenset[str] = frozenset()
    origin: str | None = None
    prefix: str = ""

    @property
    def url(self) -> str | None:
        """Of the page for observers; None where they come straight to the server."""
        return None if self.origin is None else f"{self.origin}{self.prefix}/"

    @classmethod
    def of(cls, host: str, url: str | None = None) -> "Site":
        """The site of a server that listens at a host, and that observers reach under a URL.

        Raises:
            UsageError: The URL is none, or has a part that it cannot have.
        """
        names = {host.lower()}
        if host in ("", "0.0.0.0", "::"):
            name = socket.gethostname().lower()
            names = {name, f"{name}.local"}
        if url is None:
            return cls(frozenset(names))
        try:
            parts = urlsplit(url)
            name, port = (parts.hostname or "").encode("idna").decode(), parts.port
        except ValueError:  # UnicodeError is one
            name, parts, port = "", urlsplit(""), None
        plain = not (parts.query or parts.fragment or parts.username is not None)
        if parts.scheme not in ("http", "https") or not plain or not name or not name.isprintable():
            raise UsageError(f"--url: expected such as https://study.example/prefix, found {shown(url)}")
        prefix = parts.path.rstrip("/")
        steps = prefix.split("/")[1:]
        if not PREFIX.fullmatch(prefix) or set(steps) & {".", ".."} or (steps[:1] and steps[0] in PATHS):
            raise UsageError(
                f"--url: expected a path of letters, digits and ._~- that does not begin with one of "
                f"{', '.join(f'/{path}' for path in PATHS)}, found {shown(parts.path)}"
            )
        usual = {"http": 80, "https": 443}[parts.scheme]
        shape = f"[{name}]" if ":" in name else name
        origin = f"{parts.scheme}://{shape}{'' if port in (None, usual) else f':{port}'}"
        return cls(frozenset(names | {name}), origin, prefix)

    def knows(self, host: str) -> bool:
        """Whether a request with this Host is for this server.

        A page of somebody else's can have its own name lead here (DNS rebinding), and would then be of one origin with
        ours. It cannot be called localhost, nor by an address in numbers.
        """
        found = HOST.fullmatch(host.lower())
        if found is None:
            return False
        name = found[1].strip("[]").removesuffix(".")
        return name == "localhost" or name in self.names or _is_address(name)

    def sent(self, host: str, origin: str | None, fetched: str | None) -> bool:
        """Whether what changes something comes from a page of this server; `host` is known.

        Args:
            host: The header Host.
            origin: The header Origin. Browsers say "null" where it is to be kept secret, and for pages without one,
                such as files; so that says nothing by itself.
            fetched: The header Sec-Fetch-Site, which no page can set.
        """
        if fetched is not None and fetched not in ("same-origin", "none"):
            return False
        if origin is None:
            return True  # no page
        if origin == "null":
            return fetched == "same-origin"
        # A page under the URL, or one that was opened at this server itself.
        return origin == self.origin or origin.partition("://")[2] == host


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class Allowance:
    """So many at once, and then so many a minute, for each of any number of keys.

    Args:
        at_once: How many.
        a_minute: How many.
    """

    def __init__(self, at_once: int, a_minute: float) -> None:
        self._step = 60.0 / a_minute
        self._room = at_once * self._step
        self._lock = threading.Lock()
        # When all that was taken under a key is forgotten.
        self._until: dict[str, float] = {}

    def take(self, key: str = "") -> float:
        """Take one; gives 0, or for how many seconds there is none."""
        now = time.monotonic()
        with self._lock:
            until = max(self._until.get(key, now), now) + self._step
            wait = until - now - self._room
            if wait > 1e-6:
                return wait
            if len(self._until) >= KEYS:
                self._until = {other: when for other, when in self._until.items() if when > now}
            self._until[key] = until
            return 0.0


class Begins:
    """How often somebody may begin.

    Args:
        one: At once, and then a minute, from one address; None where addresses say nothing, as behind a proxy.
        all: The same from everywhere.
    """

    def __init__(self, one: tuple[int, float] | None = (300, 30), all: tuple[int, float] = (600, 60)) -> None:
        self._one = None if one is None else Allowance(*one)
        self._all = Allowance(*all)

    def wait(self, address: str) -> float:
        """Take one; gives 0, or for how many seconds there is none."""
        wait = 0.0 if self._one is None else self._one.take(address)
        return wait or self._all.take()
