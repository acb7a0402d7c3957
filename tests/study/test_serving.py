"""A server that runs: paths, bodies and connections that it must not take, and settings that cannot be."""

import contextlib
import select
import socket
import time

import pytest
from helpers.study_folder import EXPERIMENT, REPORTS, Client, give_answers, make_study, serving

from torchbrdf.errors import DataError, UsageError
from torchbrdf.study.connections import CONNECTIONS, address, listening
from torchbrdf.study.server import LARGEST_BODY, serve
from torchbrdf.study.store import STORE


@pytest.fixture(scope="module")
def port(tmp_path_factory):
    """A server in a process of its own."""
    folder = tmp_path_factory.mktemp("served")
    make_study(folder)
    with serving(folder) as (_, port):
        yield port


CLIMBS = [
    "/../study.json",
    "/../../../etc/passwd",
    "/page/../server.py",
    "/page/../../study/server.py",
    "/page/%2e%2e/server.py",
    "/page/%2e%2e%2fserver.py",
    "/page/%252e%252e%252fserver.py",
    "/page/..%5cserver.py",
    "/page/study.html",
    "/page//etc/passwd",
    "/page/%2fetc%2fpasswd",
    "/page/study.js%00",
    "//etc/passwd",
    "LINK/0/../../../study.json",
    "LINK/0/%2e%2e/%2e%2e/study.json",
    "LINK/%2e%2e/%2e%2e/study.sqlite",
    "LINK/0/..%2f..%2fstudy.json",
    "LINK/0/%252e%252e%252fstudy.sqlite",
    "LINK/0//etc/passwd",
    "LINK/0/renders/cobalt.png",
    "LINK/0/../0/left.png",
    "LINK/./0/left.png",
    "LINK/0/left.png%00.png",
    "http://evil.example/etc/passwd",
    "file:///etc/passwd",
    "*",
    "etc/passwd",
]


def test_climbing_paths_lead_nowhere(port):
    client = Client(port)
    link = client.ready()
    assert client.ask(f"{link}/0/left.png")[0] == 200
    for path in CLIMBS:
        status, said = client.ask(path.replace("LINK", link))
        assert status in (400, 404), path
        assert len(said) < 200 and b"root:" not in said and b"experiments" not in said
    client.close()


def test_large_bodies_are_refused(port):
    client = Client(port)
    _, begun = client.tell("/begin", {"agreed": True})
    link = begun["link"]
    assert client.ask(f"{link}/profile", {**REPORTS, "display": "x" * LARGEST_BODY})[0] == 413
    # The server says so before the body has come, and closes: a client may find that while it is sending.
    head = f"POST {link}/profile HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
    lengths = ["Content-Length: 10000000\r\n\r\n", "Transfer-Encoding: chunked\r\n\r\n989680\r\n"]
    for length in lengths:
        with socket.create_connection(("127.0.0.1", port), timeout=10) as connection:
            connection.sendall((head + length).encode())
            sent = 0
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                while sent < 10_000_000 and not select.select([connection], [], [], 0)[0]:
                    sent += connection.send(b"x" * 10_000)
            said = connection.recv(100)
            assert said.startswith(b"HTTP/1.1 413 ") and sent < 10_000_000
    assert client.tell(f"{link}/profile", REPORTS)[0] == 200  # nothing was recorded, and it still answers
    client.close()


def test_half_open_connections_do_not_stop_it(port):
    starts = [b"", b"GET / HTTP/1.1\r\nHost: localhost\r\n", b"POST /begin HTTP/1.1\r\nHost: localhost\r\n"]
    starts += [b"POST /begin HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99\r\n\r\n{"]
    with contextlib.ExitStack() as stack:
        person = Client(port)
        link = person.ready()
        held = []
        for k in range(CONNECTIONS + 100):
            held.append(stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=10)))
            held[-1].sendall(starts[k % len(starts)])
        began = time.monotonic()
        give_answers(person, link, 0, 3)  # over the connection from before
        other = Client(port)
        give_answers(other, other.ready(), 0, 3)
        assert time.monotonic() - began < 5
        assert held[0].recv(1) == b""  # the oldest was closed
        person.close()
        other.close()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"port": 70_000}, "port: expected 0 to 65535, found 70000"),
        ({"host": "nowhere.invalid"}, "cannot listen at nowhere.invalid, port 0"),
        ({"experiment": "quintet"}, "unknown experiment 'quintet'"),
    ],
)
def test_bad_usage(tmp_path, change, said):
    make_study(tmp_path)
    with pytest.raises(UsageError) as caught:
        serve(tmp_path, **{"experiment": EXPERIMENT, "port": 0, **change})
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)


def test_bad_settings(tmp_path):
    make_study(tmp_path)
    for change, said in (
        ({"url": "study.example"}, "^--url: expected "),
        ({"observers": 0}, "^--observers: expected 1"),
    ):
        with pytest.raises(UsageError, match=said):
            serve(tmp_path, EXPERIMENT, port=0, **change)
    assert not (tmp_path / STORE).exists()


def test_a_folder_without_a_plan(tmp_path):
    with pytest.raises(DataError, match=r"study\.json: cannot be read"):
        serve(tmp_path, EXPERIMENT, port=0)
    assert not list(tmp_path.iterdir())


def test_addresses():
    assert address("127.0.0.1", 80) == "http://127.0.0.1:80/" and address("::1", 80) == "http://[::1]:80/"
    assert address("0.0.0.0", 8000) == f"http://{socket.gethostname()}:8000/"
    with listening("127.0.0.1", 0) as listener:
        assert listener.getsockname()[1] > 0
