"""Files that are written whole or not at all."""

import csv
import errno
import json
import logging
import math
import os
import socket
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from torchbrdf import files
from torchbrdf.errors import DataError
from torchbrdf.files import (
    csv_text,
    is_passing,
    is_writing,
    locked,
    replacing,
    without_empty_folders,
    writable,
    writable_file,
    write_csv,
    write_json,
    write_text,
)
from torchbrdf.progress import part_of


def test_json_has_null_for_what_it_has_no_word_for(tmp_path):
    write_json(tmp_path / "x.json", {"a": [1.5, math.nan, (math.inf, 2)], "b": {"c": -math.inf}, "d": True})
    found = json.loads((tmp_path / "x.json").read_text(), parse_constant=pytest.fail)
    assert found == {"a": [1.5, None, [None, 2]], "b": {"c": None}, "d": True}


def test_csv_has_every_key_once(tmp_path):
    write_csv(tmp_path / "x.csv", [{"a": 1, "b": 'two, "2"'}, {"c": None, "a": 3}])
    with (tmp_path / "x.csv").open(newline="") as file:
        assert list(csv.reader(file)) == [["a", "b", "c"], ["1", 'two, "2"', ""], ["3", "", ""]]
    assert "\r" not in csv_text([{"a": 1}])


def test_a_value_that_json_cannot_hold_leaves_the_file_as_it_was(tmp_path):
    path = tmp_path / "x.json"
    path.write_text("before")
    with pytest.raises(TypeError):
        write_json(path, [object()])
    assert [one.read_text() for one in tmp_path.iterdir()] == ["before"]
    with pytest.raises(DataError, match="cannot be written"):
        write_json(path / "below.json", [])


def test_a_part_counts_on_from_what_was_done_before():
    calls = []
    part = part_of(lambda done, total: calls.append((done, total)), 10, 30)
    part(1, 5)
    part(5, 5)
    assert calls == [(11, 30), (15, 30)]


# --- what goes wrong while something is written ---------------------------------------------------------------------


@pytest.fixture(autouse=True)
def nothing_swept(monkeypatch):
    """No folder has been looked through for leftovers yet."""
    monkeypatch.setattr(files, "_swept", set())


@pytest.mark.parametrize(
    "error",
    [OSError(errno.ENOSPC, "No space left on device"), RuntimeError("Failed to write pixel data.\nNo space left.")],
)
def test_a_full_disk_is_said_in_one_line_and_leaves_nothing(tmp_path, error):
    (tmp_path / "x.exr").write_text("before")
    expected = pytest.raises(DataError, match=r"x\.exr: cannot be written \(.*[Nn]o space left")
    with expected as caught, replacing(tmp_path / "x.exr") as temporary:
        temporary.write_bytes(b"half")
        raise error
    assert "\n" not in str(caught.value)
    assert {one.name: one.read_text() for one in tmp_path.iterdir()} == {"x.exr": "before"}


def test_a_temporary_file_has_the_suffix_and_a_name_that_fits_whatever_the_files_is(tmp_path):
    with replacing(tmp_path / f"{'n' * 250}.exr") as temporary:
        assert temporary.suffix == ".exr" and is_passing(temporary)
    assert [one.name for one in tmp_path.iterdir()] == [f"{'n' * 250}.exr"]


def test_two_threads_write_one_file_and_it_is_one_of_theirs(tmp_path):
    texts = [str(k) * 100_000 for k in range(4)]

    def write(text):
        for _ in range(20):
            write_text(tmp_path / "x.txt", text)

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [one.name for one in tmp_path.iterdir()] == ["x.txt"]
    assert (tmp_path / "x.txt").read_text() in texts


KILLED = """if True:
    import os, signal, sys
    from torchbrdf.files import replacing
    with replacing(sys.argv[1]) as temporary:
        temporary.write_text("half")
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_is_removed_by_the_next_writer(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, tmp_path / "x.txt"], timeout=60)
    (left,) = tmp_path.iterdir()
    assert is_passing(left) and left.suffix == ".txt"
    write_text(tmp_path / "y.txt", "whole")
    assert [one.name for one in tmp_path.iterdir()] == ["y.txt"]


def test_what_living_processes_and_other_machines_write_stays_for_a_day(tmp_path, monkeypatch):
    own = f"{files._machine()}-{os.getpid()}-00000000.txt"
    names = {
        "gone": f".tmp-{files._machine()}-999999999-00000000.txt",
        "reused": f".tmp-{own}",  # the number of this process, which does not write it
        "parent": f".tmp-{files._machine()}-{os.getppid()}-00000000.txt",
        "other": ".tmp-00000000-999999999-00000000.txt",
        "old": ".tmp-00000000-999999999-00000001.txt",
        "somebody's": ".tmp-notes",
    }
    for name in names.values():
        (tmp_path / name).write_text("half")
    a_day_ago = time.time() - 90_000
    os.utime(tmp_path / names["old"], (a_day_ago, a_day_ago))
    with replacing(tmp_path / "first.txt") as living:
        files._swept.clear()
        write_text(tmp_path / "second.txt", "whole")
        assert living.exists()
    left = {one.name for one in tmp_path.iterdir()}
    assert left == {names["parent"], names["other"], names["somebody's"], "first.txt", "second.txt"}


# --- what is there already ------------------------------------------------------------------------------------------


def no_file(kind, path):
    """Something at a path that is no regular file."""
    if kind == "a FIFO":
        os.mkfifo(path)
    elif kind == "a folder":
        path.mkdir()
    elif kind == "a socket":
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(path))
    else:
        try:
            os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 3))  # what /dev/null is
        except PermissionError:
            pytest.skip("only root makes devices")


@pytest.mark.parametrize("through", ["itself", "a link"])
@pytest.mark.parametrize("kind", ["a FIFO", "a folder", "a socket", "a device"])
def test_what_is_no_file_is_not_replaced(tmp_path, monkeypatch, kind, through):
    monkeypatch.chdir(tmp_path)  # a socket's name is short
    path = tmp_path / "x.html"
    no_file(kind, path.relative_to(tmp_path))
    before = path.lstat()
    if through == "a link":
        path = tmp_path / "y.html"
        path.symlink_to("x.html")
    said = f"^{path}: expected a file or a new name, found {kind}$"
    for write in (lambda: write_text(path, "new"), lambda: writable_file(path)):
        with pytest.raises(DataError, match=said):
            write()
    after = (tmp_path / "x.html").lstat()
    assert (after.st_mode, after.st_ino, after.st_rdev) == (before.st_mode, before.st_ino, before.st_rdev)
    assert {one.name for one in tmp_path.iterdir()} == {"x.html", path.name}


def test_a_folder_is_not_made_where_a_fifo_is(tmp_path):
    os.mkfifo(tmp_path / "out")
    with pytest.raises(DataError, match=r"out: expected a folder or a new name, found a FIFO$"):
        writable(tmp_path / "out")


@pytest.mark.parametrize("before", ["old", None])
def test_a_link_stays_and_what_it_leads_to_is_written(tmp_path, before):
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    target, link, second = tmp_path / "there" / "x.txt", tmp_path / "here" / "x.txt", tmp_path / "here" / "second.txt"
    link.symlink_to("../there/x.txt")
    second.symlink_to(link)
    if before is not None:
        target.write_text(before)
    left = tmp_path / "there" / f".tmp-{files._machine()}-999999999-00000000.txt"
    left.touch()  # by a process that is gone
    with replacing(second) as temporary:
        assert temporary.parent == target.parent.resolve() and temporary.suffix == ".txt" and is_writing()
        temporary.write_text("new")
        assert not target.exists() if before is None else target.read_text() == before
    assert link.is_symlink() and second.is_symlink() and target.read_text() == "new" and not target.is_symlink()
    assert [one.name for one in target.parent.iterdir()] == ["x.txt"] and not is_writing()


def test_a_link_to_a_folder_that_is_not_there_makes_it(tmp_path):
    (tmp_path / "out").symlink_to("far/away")
    assert writable(tmp_path / "out") == tmp_path / "out"
    (tmp_path / "x.txt").symlink_to("new/x.txt")
    write_text(writable_file(tmp_path / "x.txt"), "new")
    assert (tmp_path / "far" / "away").is_dir() and (tmp_path / "new" / "x.txt").read_text() == "new"


def test_links_in_a_circle_are_said(tmp_path):
    (tmp_path / "x.txt").symlink_to("x.txt")
    with pytest.raises(DataError, match=r"x\.txt: cannot be written \(Too many levels of symbolic links\)"):
        write_text(tmp_path / "x.txt", "new")
    assert (tmp_path / "x.txt").is_symlink()


# --- locks ----------------------------------------------------------------------------------------------------------


def test_a_lock_is_for_one_and_leaves_nothing(tmp_path):
    with locked(tmp_path):
        expected = pytest.raises(DataError, match=r"another process has been at work in it; wait for its end")
        with expected as caught, locked(tmp_path):
            pass
        assert "\n" not in str(caught.value)
    with locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_who_waits_for_a_lock_says_so_and_gets_it(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(files, "_PATIENCE", 0.1)
    held, order = threading.Event(), []

    def hold():
        with locked(tmp_path):
            held.set()
            time.sleep(0.5)
            order.append("first")

    thread = threading.Thread(target=hold)
    thread.start()
    held.wait()
    with caplog.at_level(logging.WARNING, "torchbrdf"), locked(tmp_path, wait=60.0):
        order.append("second")
    thread.join()
    assert order == ["first", "second"]
    assert "waiting for another process" in caplog.text


def test_a_lock_excludes_every_other_however_many_ask(tmp_path):
    inside, most = [], []

    def work():
        for _ in range(10):
            with locked(tmp_path, wait=60.0):
                inside.append(1)
                most.append(len(inside))
                time.sleep(0.002)
                inside.pop()

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(most) == 40 and max(most) == 1
    assert not list(tmp_path.iterdir())


def test_the_lock_of_a_killed_process_is_no_trap(tmp_path):
    code = "import os, sys; from torchbrdf.files import locked\nwith locked(sys.argv[1]): os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code, tmp_path], timeout=60)
    assert [one.name for one in tmp_path.iterdir()] == [".lock"]
    with locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_folders_that_were_made_and_are_empty_are_removed(tmp_path: Path) -> None:
    there = tmp_path / "there"
    there.mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "behind")
    with pytest.raises(DataError, match="nothing came of it"), without_empty_folders():
        writable(tmp_path / "a" / "b" / "c")
        writable(there)
        writable(link)
        write_text(writable(tmp_path / "kept" / "deep") / "note.txt", "something")
        raise DataError("nothing came of it")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept", "link", "there"]
    assert (tmp_path / "kept" / "deep" / "note.txt").read_text() == "something"
    writable(tmp_path / "a")
    assert (tmp_path / "a").is_dir()  # outside of it folders stay
