"""The server as a process: started, stopped, killed, with broken files, and asked for what it must not give."""

import http.client
import logging
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time

import pytest
from helpers.study_folder import (
    EXPERIMENT,
    Client,
    answer,
    give_answers,
    make_study,
    ready,
    serving,
    start_server,
    stop_server,
)

from torchbrdf.errors import DataError
from torchbrdf.study import trials
from torchbrdf.study.server import make_app
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


@pytest.mark.parametrize("kills", [5, pytest.param(25, marks=pytest.mark.slow)])
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


def recorded(path):
    """How many answers a database file has, without its log."""
    database = sqlite3.connect(path)
    (count,) = database.execute("SELECT COUNT(*) FROM answers").fetchone()
    database.close()
    return count


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_whatever_stops_it_all_is_in_the_file(tmp_path, name):
    make_study(tmp_path)
    with serving(tmp_path) as (process, port):
        client = Client(port)
        give_answers(client, client.ready(), 0, 18)
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
    give_answers(client, client.ready(), 0, 5)
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
            give_answers(client, link, first, 9)
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
    give_answers(client, client.ready(), 0, 5)
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
    give_answers(client, client.ready(), 0, 3)
    client.close()
    assert stop_server(process, signal.SIGTERM).startswith("stopped: 1 observers, 3 answers")


def test_a_database_that_is_removed_while_it_serves(tmp_path, capfd):
    make_study(tmp_path)
    with serving(tmp_path) as (process, port):
        client = Client(port)
        link = client.ready()
        give_answers(client, link, 0, 2)
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
