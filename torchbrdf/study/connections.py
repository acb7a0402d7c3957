"""The process that serves: where it listens, whom it listens to when many come, and how it stops."""

import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from waitress.adjustments import Adjustments
from waitress.channel import HTTPChannel
from waitress.server import TcpWSGIServer

from torchbrdf.errors import UsageError

# A browser has up to six.
CONNECTIONS = 500


def listening(host: str, port: int) -> socket.socket:
    """Open a socket that listens; a UsageError if the port is taken, or the host is not this machine."""
    if not 0 <= port <= 65535:
        raise UsageError(f"port: expected 0 to 65535, found {port}")
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"cannot listen at {host}, port {port} ({reason}); try another port") from None


def address(host: str, port: int) -> str:
    """Address to open in a browser."""
    name = socket.gethostname() if host in ("", "0.0.0.0", "::") else host
    return f"http://{f'[{name}]' if ':' in name else name}:{port}/"


class Connection(HTTPChannel):
    """A connection that knows when it was answered last."""

    answered = 0.0

    def service(self) -> None:
        """Answer a request."""
        super().service()
        self.answered = self.last_activity

    def worth(self) -> tuple[bool, float]:
        """To be kept before those of less worth: who asked something before who did not, and then who came late."""
        return self.answered > 0, self.answered or self.creation_time


class Server(TcpWSGIServer):
    """A server that closes an idle connection for a new one when there are many, so that nobody can hold them all."""

    channel_class = Connection
    most = CONNECTIONS

    def handle_accept(self) -> None:
        """Take up a connection."""
        if len(self.active_channels) >= self.most:
            # A browser opens it again when it needs it.
            idle = [one for one in self.active_channels.values() if not one.requests and not one.will_close]
            if idle:
                min(idle, key=Connection.worth).will_close = True
        super().handle_accept()


def make_server(app: Any, listener: socket.socket, **settings: Any) -> Server:
    """A server of a WSGI application at a socket that listens; settings are those of waitress."""
    # Waiting for a thread is usual when pages load pictures ahead, and nothing to warn of.
    logging.getLogger("waitress.queue").setLevel(logging.ERROR)
    settings = {"connection_limit": 2 * CONNECTIONS, "asyncore_use_poll": True, **settings}
    made: Server = Server(
        app,
        _sock=listener,
        adj=Adjustments(sockets=[listener], **settings),
        bind_socket=False,
        sockinfo=(listener.family, listener.type, listener.proto, listener.getsockname()),
    )
    made.most = min(CONNECTIONS, _files() - 100)
    return made


def _files() -> int:
    """How many files this process may have open, sockets too."""
    if sys.platform == "win32":
        return 2 * CONNECTIONS
    import resource

    few, many = resource.getrlimit(resource.RLIMIT_NOFILE)
    return 2 * CONNECTIONS if resource.RLIM_INFINITY in (few, many) else few


@contextmanager
def stopping() -> Iterator[None]:
    """Within the block, what asks a process to end, and the end of its terminal, stop it as Ctrl-C does."""
    kept: dict[int, Any] = {}

    def stop(*_: object) -> None:
        for number in kept:
            signal.signal(number, signal.SIG_IGN)  # ending takes a moment, which another signal is not to cut short
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) != signal.SIG_IGN:  # as with nohup
                kept[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def say(text: str) -> None:
    """Print a line, if there still is somewhere to print it."""
    try:
        print(text, flush=True)
    except OSError:
        # Or Python tries again at its end, and fails.
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 (to the end)
