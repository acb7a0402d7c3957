"""The server as a process: started, stopped, killed, with broken files, and asked for what it must not give."""

import contextlib
import http.client
import logging
import os
import random
import select
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time

import pytest
from helpers.study_folder import (
    EXPERIMENT,
    REPORTS,
    Client,
    answer,
    make_study,
    ready,
    serving,
    start_server,
    stop_server,
)

from torchbrdf.errors import DataError, UsageError
from torchbrdf.study import trials
from torchbrdf.study.connections import CONNECTIONS, address, listening
from torchbrdf.study.server import LARGEST_BODY, make_app, serve
from torchbrdf.study.store import STORE, Store


class Person(threading.Thread):
    """Answers as fast as the server tells the next trial; sends the same answer again until it hears of it."""

    def __init__(self, port, seed, stop):
        super().__init__()
        self.client, self.source, self.stop = Client(port), random.Random(seed), stop
        self.link, self.answer, self.unsure = None, None, False
        self.acknowledged, self.lost, self.wrong, self.broken = {}, {}, [], 0

    def run(self):
        while self.unsure or not self.stop.is_set():
            try:
                self.step()
            except (OSError, http.client.HTTPException):
                self.broken += 1
                time.sleep(0.01)
            except Exception as error:
                self.wrong.append(repr(error))
                return
        self.client.close()

    def step(self):
        if self.link is None:
            self.link = self.client.ready()
            self.next(0)
        self.unsure, before = True, self.unsure
        status, said = self.client.tell(f"{self.link}/answer", self.answer)
        self.unsure = False
        where, answered = (self.link, self.answer["trial"]), (self.answer["side"], self.answer["response_time"])
        if status == 200:
            self.acknowledged[where] = answered
        elif status == 409 and before:  # recorded before, and the acknowledgment got lost
            self.lost[where] = answered
        else:
            self.wrong.append((status, said))
        state = said["state"]
        if state["trial"] != self.answer["trial"] + 1:
            self.wrong.append((self.answer, state))
        if state["stage"] == "done":
            self.link = None
        else:
            self.next(state["trial"])

    def next(self, trial):
        side, seconds = self.source.choice(["left", "right"]), self.source.random()
        self.answer = {"trial": trial, "side": side, "response_time": seconds}


def heard(people):
    return sum(len(person.acknowledged) + len(person.lost) for person in people)


@pytest.mark.parametrize("kills", [5, pytest.param(50, marks=pytest.mark.slow)])
def test_killed_again_and_again_nothing_is_lost_or_doubled(tmp_path, kills):
    make_study(tmp_path, materials=10)
    moments = random.Random(7)
    process, port = start_server(tmp_path)
    stop = threading.Event()
    people = [Person(port, seed, stop) for seed in range(6)]
    try:
        for person in people:
            person.start()
        for _ in range(kills):
            # After some answers more, however slow the machine is.
            enough, until = heard(people) + moments.randrange(10, 30), time.monotonic() + 20
            while heard(people) < enough and time.monotonic() < until:
                time.sleep(moments.uniform(0.0, 0.02))
            process.kill()
            process.communicate()
            process, _ = start_server(tmp_path, port)
        stop.set()
        for person in people:
            person.join(timeout=20)
    finally:
        stop.set()
        stop_server(process)
    assert not any(person.is_alive() for person in people)
    assert [person.wrong for person in people] == [[]] * len(people)
    assert all(person.broken >= kills // 2 for person in people)
    database = sqlite3.connect(tmp_path / STORE)
    assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    rows = database.execute(
        "SELECT token, position, side, response_time FROM answers JOIN observers ON observers.id = answers.observer"
        " ORDER BY observer, position"
    ).fetchall()
    database.close()
    found = {(f"/o/{token}", position): (side, seconds) for token, position, side, seconds in rows}
    assert len(found) == len(rows) > 10 * kills
    answered = {}
    for person in people:
        answered |= person.acknowledged | person.lost
    assert found == answered  # every one that was acknowledged, as it was, and no other
    positions = {}
    for token, position, _, _ in rows:
        positions.setdefault(token, []).append(position)
    assert all(have == list(range(len(have))) for have in positions.values())


def test_a_broken_store_is_no_end(tmp_path, caplog):
    store = Store(tmp_path / STORE, make_study(tmp_path))
    client = make_app(tmp_path, EXPERIMENT, store).test_client()
    link = ready(client)
    store.answer, kept = lambda *_: (_ for _ in ()).throw(sqlite3.OperationalError("disk I/O error")), store.answer
    with caplog.at_level(logging.ERROR):
        response = answer(client, link, 0)
    assert response.status_code == 503 and "disk" not in response.text
    assert "disk I/O error" in caplog.text and link not in caplog.text
    store.answer = kept
    assert answer(client, link, 0).status_code == 200
    store.close()


@pytest.mark.parametrize("case", ["gone", "no PNG"])
def test_pictures_that_break(tmp_path, case):
    plan = make_study(tmp_path)
    picture = tmp_path / plan.materials[0].reference
    store = Store(tmp_path / STORE, plan)
    client = make_app(tmp_path, EXPERIMENT, store).test_client()
    link = ready(client)
    first = trials(plan, plan.experiments[0], 0)
    near = next(k for k, trial in enumerate(first) if trial.material == plan.materials[0].name)
    for k in range(near):
        answer(client, link, k)
    if case == "gone":
        picture.unlink()
    else:
        picture.write_bytes(b"BM")
    response = client.get(f"{link}/{near}/reference.png")
    assert response.status_code == 503 and plan.materials[0].name not in f"{response.headers} {response.text}"
    with pytest.raises(DataError, match=r"cobalt\.png: (no such picture|expected a PNG, found something else)$"):
        make_app(tmp_path, EXPERIMENT, store)
    store.close()


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


def recorded(path):
    """How many answers a database file has, without its log."""
    database = sqlite3.connect(path)
    (count,) = database.execute("SELECT COUNT(*) FROM answers").fetchone()
    database.close()
    return count


def answers(client, link, first, count):
    """Give some answers; all are acknowledged."""
    for trial in range(first, first + count):
        assert client.tell(f"{link}/answer", {"trial": trial, "side": "left", "response_time": 1.5})[0] == 200


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_whatever_stops_it_all_is_in_the_file(tmp_path, name):
    make_study(tmp_path)
    with serving(tmp_path) as (process, port):
        client = Client(port)
        answers(client, client.ready(), 0, 18)
        viewer = sqlite3.connect(tmp_path / STORE)  # which keeps the log from going away by itself
        assert viewer.execute("SELECT COUNT(*) FROM answers").fetchone() == (18,)
        said = stop_server(process, getattr(signal, name))
        assert said == f"stopped: 1 observers, 18 answers in {tmp_path / STORE}\n"
        assert process.returncode == 0
        shutil.copy(tmp_path / STORE, tmp_path / "copy.sqlite")
        assert recorded(tmp_path / "copy.sqlite") == 18
        viewer.close()
        client.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy.sqlite", "renders", "study.json", STORE]


def test_signals_that_come_again_and_again(tmp_path):
    make_study(tmp_path)
    process, port = start_server(tmp_path)
    client = Client(port)
    answers(client, client.ready(), 0, 5)
    client.close()
    for _ in range(20):
        process.send_signal(signal.SIGTERM)
        time.sleep(0.002)
    assert stop_server(process).startswith("stopped: 1 observers, 5 answers")
    assert process.returncode in (0, -signal.SIGTERM)  # the last may come when all is done
    assert recorded(tmp_path / STORE) == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["renders", "study.json", STORE]


def test_a_copy_while_it_runs(tmp_path):
    make_study(tmp_path)
    with serving(tmp_path) as (process, port):
        client, copy, until = Client(port), tmp_path / "copy.sqlite", time.monotonic() + 20
        shutil.copy(tmp_path / STORE, copy)
        assert recorded(copy) == 0  # its tables are there
        link = client.ready()
        for first in (0, 9):
            answers(client, link, first, 9)
            while recorded(copy) < first + 9 and time.monotonic() < until:
                time.sleep(0.05)
                shutil.copy(tmp_path / STORE, copy)
            assert recorded(copy) == first + 9
        process.kill()
        process.communicate()
        client.close()


def test_its_terminal_may_go_away(tmp_path):
    make_study(tmp_path)
    ours, its = os.openpty()
    code = "import sys; from torchbrdf.cli import main; sys.exit(main(['study', 'serve', sys.argv[1], '--port', '0']))"
    process = subprocess.Popen([sys.executable, "-c", code, tmp_path], stdin=its, stdout=its, stderr=its)
    os.close(its)
    line = os.read(ours, 1000)
    client = Client(int(line.split(b"/")[2].split(b":")[1]))
    answers(client, client.ready(), 0, 5)
    os.close(ours)
    process.send_signal(signal.SIGHUP)
    assert process.wait(timeout=20) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["renders", "study.json", STORE]
    assert recorded(tmp_path / STORE) == 5
    client.close()


def test_nohup_is_heard(tmp_path):
    make_study(tmp_path)
    kept = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process, port = start_server(tmp_path)
    finally:
        signal.signal(signal.SIGHUP, kept)
    process.send_signal(signal.SIGHUP)
    client = Client(port)
    answers(client, client.ready(), 0, 3)
    client.close()
    assert stop_server(process, signal.SIGTERM).startswith("stopped: 1 observers, 3 answers")


def test_a_database_that_is_removed_while_it_serves(tmp_path, capfd):
    make_study(tmp_path)
    with serving(tmp_path) as (process, port):
        client = Client(port)
        link = client.ready()
        answers(client, link, 0, 2)
        (tmp_path / STORE).unlink()
        for _ in range(3):
            assert client.tell(f"{link}/answer", {"trial": 2, "side": "left", "response_time": 1.5})[0] == 503
        assert client.ask("/")[0] == 200
        client.close()
        assert stop_server(process) == ""
    assert process.returncode == 1 and not (tmp_path / STORE).exists()
    said = capfd.readouterr().err
    # At once, and at the end.
    assert said.count(f"{STORE}: removed or replaced while in use, so nothing is recorded") == 2


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
        answers(person, link, 0, 3)  # over the connection from before
        other = Client(port)
        answers(other, other.ready(), 0, 3)
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
