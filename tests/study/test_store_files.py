"""The database's file: lost, opened again, of another plan, damaged."""

import shutil
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from helpers.study_folder import EXPERIMENT, admitted

from torchbrdf.errors import DataError
from torchbrdf.study import Experiment, Stimulus
from torchbrdf.study.design import observer_seed
from torchbrdf.study.store import STORE, Store


@pytest.mark.parametrize("loss", ["file", "log", "index", "folder", "replaced", "emptied"])
def test_what_is_lost_is_not_acknowledged(plan, tmp_path, loss):
    folder = tmp_path / "run"
    folder.mkdir()
    store = Store(folder / STORE, plan)
    token, other = admitted(store), admitted(store)
    store.answer(token, 0, "left", 1.0)
    away = tmp_path / "away"
    gone = {"folder": folder, "log": folder / f"{STORE}-wal", "index": folder / f"{STORE}-shm"}.get(loss, store.path)
    if loss == "emptied":
        gone.write_bytes(b"")
    else:
        gone.rename(away)
    if loss == "replaced":
        shutil.copy(away, gone)
    for _ in range(2):  # also when it is sent again
        for write in (lambda: store.answer(token, 1, "left", 1.0), lambda: store.begin(EXPERIMENT)):
            with pytest.raises(DataError, match="removed or replaced while in use, so nothing is recorded; put it ba"):
                write()
    with ThreadPoolExecutor(1) as pool, pytest.raises(DataError, match="removed or replaced while in use"):
        pool.submit(store.state, token).result()  # a new thread, which would open another file
    if loss == "emptied":
        store.close()
        return
    if loss == "replaced":
        gone.unlink()
    away.rename(gone)
    assert store.answer(token, 1, "right", 1.0).position == 2  # it was put back
    assert store.answer(other, 0, "right", 1.0).position == 1
    store.close()


def test_it_is_there_when_opened_again(plan, tmp_path):
    store = Store(tmp_path / STORE, plan)
    token = admitted(store)
    store.answer(token, 0, "left", 1.0)
    kept = store.answers(), store.profiles(), store.state(token)
    store.close()
    assert [path.name for path in tmp_path.iterdir()] == [STORE]
    # Words, screening, and what this experiment does not show, may change.
    more = (Experiment("duo", "Two", ("wren", "heron")), replace(plan.experiments[0], title="Other"))
    materials = tuple(
        replace(one, stimuli={**one.stimuli, "measured": Stimulus("x.png"), "new": Stimulus("y.png")})
        for one in plan.materials
    )
    other = replace(plan, materials=materials, experiments=more, texts={"title": "Other"}, screening={})
    again = Store(tmp_path / STORE, other)
    assert (again.answers(), again.profiles(), again.state(token)) == kept
    again.begin(EXPERIMENT)
    assert again.counts(EXPERIMENT) == (2, 1)
    again.close()


def test_another_plan_is_refused(plan, tmp_path):
    first = plan.materials[0]
    moved = replace(first, stimuli={**first.stimuli, "wren": Stimulus("renders/other.png")})
    others = [
        replace(plan, seed=6),
        replace(plan, materials=plan.materials[:2]),
        replace(plan, materials=plan.materials[::-1]),
        replace(plan, materials=(moved, *plan.materials[1:])),
        replace(plan, materials=(replace(first, reference="renders/other.png"), *plan.materials[1:])),
        replace(plan, experiments=(Experiment(EXPERIMENT, "All four", ("kestrel", "wren", "heron")),)),
        replace(plan, experiments=(replace(plan.experiments[0], repeats=2),)),
        replace(plan, experiments=(replace(plan.experiments[0], name="quintet"),)),
    ]
    for other in others:  # nobody came yet
        Store(tmp_path / STORE, other).close()
    late = Store(tmp_path / STORE, others[0])
    store = Store(tmp_path / STORE, plan)
    token = admitted(store)
    store.close()
    for other in others:
        with pytest.raises(DataError) as caught:
            Store(tmp_path / STORE, other)
        said = str(caught.value)
        assert said.startswith(
            f"{tmp_path / STORE}: experiment 'quartet' was begun with other materials, stimuli or seed"
        )
        assert "\n" not in said and said.endswith("restore study.json, or move study.sqlite away")
    with pytest.raises(DataError, match="was begun with other materials"):
        late.begin(EXPERIMENT)  # opened before
    late.close()
    store = Store(tmp_path / STORE, plan)
    assert store.state(token).stage == "trials" and store.counts(EXPERIMENT) == (1, 0)
    store.close()


def test_a_seed_may_be_large(plan, tmp_path):
    large = replace(plan, seed=10**30)
    store = Store(tmp_path / STORE, large)
    token = admitted(store)
    store.answer(token, 0, "left", 1.0)
    assert store.answers()[0].seed == observer_seed(large, 0) == store.profiles()[0]["seed"]
    store.close()


@pytest.mark.parametrize("there", ["text", "folder", "no folder"])
def test_what_is_no_database_gets_one_line(plan, tmp_path, there):
    path = tmp_path / STORE if there != "no folder" else tmp_path / "nowhere" / STORE
    if there == "text":
        path.write_text("answers, for sure\n" * 100)
    elif there == "folder":
        path.mkdir()
    with pytest.raises(
        DataError, match=r"study\.sqlite: expected the database of a study that can be written, found .+$"
    ):
        Store(path, plan)


DAMAGES = {
    "a table is gone": "DROP TABLE trials",
    "a column is called otherwise": "ALTER TABLE answers RENAME COLUMN side TO hand",
    "a time is text": "UPDATE answers SET response_time = 'long'",
    "a time is endless": "UPDATE answers SET response_time = 9e999",
    "a seed is none": "UPDATE observers SET seed = 'seven'",
    "a name has two lines": "UPDATE trials SET material = char(97, 10, 98)",
    "a name is bytes": "UPDATE trials SET left = x'ff00'",
    "a kind is unknown": "UPDATE trials SET kind = 'other'",
    "more answers than trials": "UPDATE observers SET trials = -1",
    "a profile is no JSON": "UPDATE observers SET reports = '{'",
    "pages are damaged": "",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_database_is_named_in_one_line(plan, tmp_path, damage):
    store = Store(tmp_path / STORE, plan)
    token = admitted(store)
    store.answer(token, 0, "left", 1.0)
    store.close()
    if DAMAGES[damage]:
        with sqlite3.connect(tmp_path / STORE) as db:
            db.execute("PRAGMA ignore_check_constraints = ON")
            db.execute(DAMAGES[damage])
        db.close()
    else:
        data = bytearray((tmp_path / STORE).read_bytes())
        data[4096:] = b"\xff" * (len(data) - 4096)
        (tmp_path / STORE).write_bytes(data)
    with pytest.raises(DataError, match=r"study\.sqlite: .*(expected|database)"):
        use_all(tmp_path / STORE, plan, token)


def use_all(path, plan, token):
    store = Store(path, plan)
    try:
        store.answers(), store.profiles(), store.counts(EXPERIMENT), store.trial(store.state(token), 0)
    finally:
        store.close()
