"""The database of a study: nothing twice, nothing lost, nothing that is not to be answered now."""

import csv
import json
import shutil
import sqlite3
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from helpers.study_folder import BIRDS, EXPERIMENT, REPORTS, SCREEN, admitted, make_study

from torchbrdf.cli import main
from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.study import Experiment, database, read_answers, trials, write_answers
from torchbrdf.study import store as module
from torchbrdf.study.design import observer_seed
from torchbrdf.study.store import STORE, FullError, IneligibleError, NotNowError, Store, UnknownObserverError


@pytest.fixture
def store(plan, tmp_path):
    made = Store(tmp_path / STORE, plan)
    yield made
    made.close()


def test_an_observer_has_the_trials_of_the_design(store, plan):
    tokens = [store.begin(EXPERIMENT) for _ in range(3)]
    assert len(set(tokens)) == 3 and all(len(token) == 22 for token in tokens)
    for index, token in enumerate(tokens):
        state = store.state(token)
        assert (state.stage, state.position, state.trials) == ("questions", 0, 18)
        wanted = trials(plan, plan.experiment(EXPERIMENT), index)
        assert [store.trial(state, k) for k in range(state.trials)] == wanted
    assert [one["seed"] for one in store.profiles()] == [observer_seed(plan, index) for index in range(3)]


def test_observers_who_begin_at_once_get_different_numbers(store, plan):
    other = Store(store.path, plan)  # as another process has it
    with ThreadPoolExecutor(8) as pool:
        tokens = list(pool.map(lambda k: (store, other)[k % 2].begin(EXPERIMENT), range(40)))
    other.close()
    assert len(set(tokens)) == 40
    profiles = store.profiles()
    assert [one["number"] for one in profiles] == list(range(40))
    assert [one["observer"] for one in profiles] == [f"observer-{k:03d}" for k in range(1, 41)]


def test_numbers_are_those_of_an_experiment_and_names_of_all(plan, tmp_path):
    both = replace(plan, experiments=(*plan.experiments, Experiment("duo", "Two", ("wren", "heron"))))
    store = Store(tmp_path / STORE, both)
    for name in (EXPERIMENT, "duo", "duo", EXPERIMENT):
        store.begin(name)
    found = [(one["observer"], one["experiment"], one["number"]) for one in store.profiles()]
    store.close()
    assert found == [
        ("observer-001", EXPERIMENT, 0),
        ("observer-002", "duo", 0),
        ("observer-003", "duo", 1),
        ("observer-004", EXPERIMENT, 1),
    ]


def test_a_whole_session(store, plan, tmp_path):
    token = admitted(store)
    before = datetime.now(UTC)
    for k in range(18):
        state = store.answer(token, k, ("left", "right")[k % 3 == 0], 0.5 + k)
        assert state == store.state(token) and state.position == k + 1
        assert state.stage == ("done" if k == 17 else "trials")
    path = tmp_path / "answers.csv"
    write_answers(path, store.answers())
    answers = read_answers(path)
    assert answers == store.answers(EXPERIMENT) and len(answers) == 18
    for k, (answer, trial) in enumerate(zip(answers, trials(plan, plan.experiments[0], 0), strict=True)):
        assert (answer.material, answer.left, answer.right) == (trial.material, trial.left, trial.right)
        assert answer.chosen == (trial.right if k % 3 == 0 else trial.left)
        assert (answer.observer, answer.experiment, answer.kind) == ("observer-001", EXPERIMENT, "trial")
        assert answer.response_time == 0.5 + k and answer.seed == observer_seed(plan, 0)
        stamp = datetime.fromisoformat(answer.time_stamp)
        assert answer.time_stamp.endswith("Z") and len(answer.time_stamp) == len("2026-01-01T00:00:00.000Z")
        assert abs((stamp - before).total_seconds()) < 60
    assert store.answers("other") == [] and store.counts(EXPERIMENT) == (1, 18) and store.counts("other") == (0, 0)


@pytest.mark.parametrize(
    ("position", "side"), [(0, "left"), (2, "left"), (-1, "right"), (10**40, "left"), (18, "left")]
)
def test_only_the_current_trial_can_be_answered(store, position, side):
    token = admitted(store)
    store.answer(token, 0, "right", 1.0)
    with pytest.raises(NotNowError):
        store.answer(token, position, side, 1.0)
    assert [answer.response_time for answer in store.answers()] == [1.0]
    assert store.state(token).position == 1


def test_what_is_refused_is_not_recorded(store):
    token = store.begin(EXPERIMENT)
    for forged in ("", token[:-1], token + "A", token.swapcase(), "%", "\0"):
        with pytest.raises(UnknownObserverError):
            store.answer(forged, 0, "left", 1.0)
    for early in (lambda: store.answer(token, 0, "left", 1.0), lambda: store.record_screen(token, SCREEN)):
        with pytest.raises(NotNowError):
            early()
    store.report(token, REPORTS, True)
    with pytest.raises(NotNowError):
        store.report(token, {**REPORTS, "room": "dark"}, True)
    store.record_screen(token, SCREEN)
    with pytest.raises(NotNowError):
        store.record_screen(token, {**SCREEN, "card": None})
    with pytest.raises(UsageError, match=r"^side: expected left or right, found 'up'$"):
        store.answer(token, 0, "up", 1.0)
    (profile,) = store.profiles()
    assert (profile["reports"], profile["screen"], profile["let_in"]) == (REPORTS, SCREEN, True)
    assert store.answers() == [] and store.state(token).stage == "trials"


def test_who_is_screened_out_is_recorded(store):
    token = store.begin(EXPERIMENT)
    assert store.profiles()[0]["let_in"] is None and store.profiles()[0]["reports"] is None
    assert store.report(token, {"colour_vision": "deficient"}, False).stage == "screened"
    assert store.state(token).stage == "screened"
    with pytest.raises(IneligibleError):
        store.answer(token, 0, "left", 1.0)
    with pytest.raises(NotNowError):
        store.report(token, REPORTS, True)
    (profile,) = store.profiles()
    assert profile["let_in"] is False and profile["reports"] == {"colour_vision": "deficient"}
    assert profile["answered"] == 0 and profile["trials"] == 18 and profile["consented"].endswith("Z")


def test_one_of_many_answers_at_once_counts(store, plan):
    token = admitted(store)
    other = Store(store.path, plan)
    barrier, taken = threading.Barrier(8), []

    def press(k):
        barrier.wait()
        for position in range(18):
            try:
                (store, other)[k % 2].answer(token, position, ("left", "right")[k % 2], float(k))
                taken.append((position, k))
            except NotNowError:
                pass

    threads = [threading.Thread(target=press, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    other.close()
    taken.sort()  # what is recorded together is told in any order
    assert [position for position, _ in taken] == list(range(len(taken))) and taken
    answers = store.answers()
    assert [answer.response_time for answer in answers] == [float(k) for _, k in taken]
    assert all((answer.chosen == answer.left) == (k % 2 == 0) for answer, (_, k) in zip(answers, taken, strict=True))


def test_an_answer_is_on_the_disk_when_it_is_acknowledged(store, plan, tmp_path):
    token = admitted(store)
    store.answer(token, 0, "left", 1.25)
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in tmp_path.glob(f"{STORE}*"):  # as they are, without closing anything
        shutil.copy(path, copy)
    found = Store(copy / STORE, plan)
    assert found.answers() == store.answers() and found.state(token) == store.state(token)
    found.close()
    connection = store._database.connection()
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert connection.execute("PRAGMA synchronous").fetchone() == (2,)  # FULL


def test_the_database_itself_refuses_doubles(store):
    token = admitted(store)
    store.answer(token, 0, "left", 1.0)
    connection = store._database.connection()
    for row in ((1, 0, "right"), (1, 18, "left"), (2, 0, "left"), (1, 1, "up")):
        with pytest.raises(sqlite3.IntegrityError):
            connection.execute("INSERT INTO answers VALUES (?, ?, ?, 1.0, '')", row)
    assert len(store.answers()) == 1


@contextmanager
def locked(path):
    """Another process' write that does not end."""
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    yield
    other.execute("ROLLBACK")
    other.close()


def test_a_locked_file_keeps_nobody_waiting(store):
    token = admitted(store)
    with locked(store.path):
        began = time.monotonic()
        with ThreadPoolExecutor(8) as pool:
            for one in [pool.submit(store.answer, token, 0, "left", 1.0) for _ in range(40)]:
                with pytest.raises(DataError, match=r"study\.sqlite: another process has it locked$"):
                    one.result()
        assert time.monotonic() - began < 3 * database.PATIENCE
        began = time.monotonic()
        assert store.state(token).position == 0  # which can be read meanwhile
        assert time.monotonic() - began < 0.2
    time.sleep(database.SHUT)
    assert store.answer(token, 0, "right", 2.0).position == 1


def test_after_a_failed_write_it_goes_on(store, monkeypatch):
    token = admitted(store)

    def broken(*_):
        raise RuntimeError("in the middle of a transaction")

    with monkeypatch.context() as patch:
        patch.setattr(module, "now", broken)
        with pytest.raises(RuntimeError):
            store.begin(EXPERIMENT)
    assert store.answer(token, 0, "right", 2.0).position == 1
    assert store.counts(EXPERIMENT) == (1, 1)


def test_writes_of_many_threads_wait_for_the_disk_together(store):
    tokens = [admitted(store) for _ in range(16)]
    commits = []
    kept = store._database._written.set
    store._database._written.set = lambda: (commits.append(1), kept())
    store._database._writer.acquire()  # as if the disk were busy
    with ThreadPoolExecutor(20) as pool:
        good = [pool.submit(store.answer, token, 0, "left", 1.0) for token in tokens]
        bad = [pool.submit(store.answer, token, 5, "left", 1.0) for token in tokens[:3]]
        forged = pool.submit(store.answer, "forged", 0, "left", 1.0)
        while len(store._database._waiting) < 20:
            time.sleep(0.001)
        assert not any(one.done() for one in good)
        store._database._writer.release()
        assert [one.result().position for one in good] == [1] * 16
        assert [type(one.exception()) for one in bad] == [NotNowError] * 3  # and only those
        assert type(forged.exception()) is UnknownObserverError
    assert len(commits) == 1 and len(store.answers()) == 16


def answers_in(path, copy):
    """How many answers a copy of the file has, without its log."""
    shutil.copy(path, copy)
    found = sqlite3.connect(copy)
    count = found.execute("SELECT COUNT(*) FROM answers").fetchone()[0]
    found.close()
    return count


def test_a_copy_of_the_file_alone_is_whole(store, tmp_path):
    copy = tmp_path / "copy.sqlite"
    assert answers_in(store.path, copy) == 0  # tables are there at once
    tokens = [admitted(store) for _ in range(3)]
    with store.checkpoints():
        for k in range(12):
            for token in tokens:
                store.answer(token, k, "left", 1.0)
        until = time.monotonic() + 10
        while answers_in(store.path, copy) < 36 and time.monotonic() < until:
            time.sleep(0.05)
        assert answers_in(store.path, copy) == 36
    for token in tokens:
        store.answer(token, 12, "left", 1.0)
    other = sqlite3.connect(store.path)  # such as a viewer
    assert other.execute("SELECT COUNT(*) FROM answers").fetchone() == (39,)
    store.close()
    assert answers_in(store.path, copy) == 39
    other.close()


def test_the_log_does_not_grow(store):
    sizes = []
    with store.checkpoints():
        for _ in range(5):
            for _ in range(10):
                store.begin(EXPERIMENT)
            while not store._database.checkpoint():
                time.sleep(0.01)
            sizes.append(store.path.with_name(f"{STORE}-wal").stat().st_size)
    assert 0 < max(sizes) < 2 * sizes[0]


def test_a_file_that_goes_away_during_a_write(store, tmp_path, monkeypatch):
    token = admitted(store)

    def late():
        store.path.rename(tmp_path / "away")
        return "now"

    monkeypatch.setattr(module, "now", late)
    with pytest.raises(DataError, match="removed or replaced while in use"):
        store.answer(token, 0, "left", 1.0)


def test_no_more_begin_than_may(store):
    for _ in range(2):
        store.begin(EXPERIMENT, most=2)
    with pytest.raises(FullError, match=r"^2 observers have begun, as many as may$"):
        store.begin(EXPERIMENT, most=2)
    assert len(store.profiles()) == 2


def test_an_unknown_experiment(store):
    with pytest.raises(TorchbrdfError, match=r"^unknown experiment 'quartett'; .* did you mean 'quartet'\?$"):
        store.begin("quartett")
    assert store.profiles() == []


def test_a_user_exports_and_scales_what_observers_answered(tmp_path, capsys):
    plan = make_study(tmp_path, materials=2)
    store = Store(tmp_path / STORE, plan)
    for _ in range(3):
        token = admitted(store)
        for position in range(12):
            shown = store.trial(store.state(token), position)
            side = "left" if BIRDS.index(shown.left) < BIRDS.index(shown.right) else "right"
            store.answer(token, position, side, 1.5)
    store.close()
    out = tmp_path / "out" / "answers.csv"
    assert main(["study", "export", str(tmp_path), "--out", str(out)]) == 0
    assert "36 answers of 3 observers" in capsys.readouterr().out
    assert len(read_answers(out)) == 36
    (first, *_) = json.loads((tmp_path / "out" / "answers-observers.json").read_text())
    assert first["reports"] == REPORTS and first["screen"] == SCREEN and "token" not in first
    assert main(["study", "scale", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "3 observers, 36 answers" in printed and "not people" not in printed
    rows = list(csv.DictReader((tmp_path / "scales" / "scales.csv").open()))
    for material in plan.materials:
        own = {row["stimulus"]: float(row["scale"]) for row in rows if row["material"] == material.name}
        assert sorted(own, key=own.__getitem__, reverse=True) == list(BIRDS)
