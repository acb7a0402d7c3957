"""Worker processes that die, that are stopped, and whose parent dies."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from torchbrdf import memory
from torchbrdf.parallel import Lost, process_map


def worker_processes(process=None):
    """The workers of a process, by default of this one."""
    children = psutil.Process(process).children()
    return [child for child in children if "popen_loky" in " ".join(child.cmdline())]


def gone(processes, seconds=20.0):
    """Whether processes end within some time, as zombies or altogether; they are killed if not."""
    _, left = psutil.wait_procs(processes, seconds)
    left = [one for one in left if one.is_running() and one.status() != psutil.STATUS_ZOMBIE]
    for one in left:
        one.kill()
    return not left


@pytest.fixture
def processes(two_threads, monkeypatch):
    """A map in processes that are started at once."""
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "always")
    return process_map


def test_they_are_kept_between_calls(processes):
    first = set(processes(lambda k: os.getpid(), range(4)))
    assert set(processes(lambda k: os.getpid(), range(4))) <= {child.pid for child in worker_processes()}
    assert first <= {child.pid for child in worker_processes()}


def test_the_items_of_one_that_dies_are_done_again(processes, tmp_path, caplog):
    def work(k):
        if k == 3 and not (tmp_path / "once").exists():
            (tmp_path / "once").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return k * k

    assert list(processes(work, range(8))) == [k * k for k in range(8)]
    assert "a worker process died; its work is done again" in caplog.text


def test_they_share_the_limit_of_memory(processes):
    with memory.limited(0.5):
        assert set(processes(lambda k: memory.limit(), range(4))) == {2**28}
    assert set(processes(lambda k: memory.limit(), range(4))) == {2**30}


@pytest.mark.slow
def test_an_item_whose_worker_dies_twice_is_lost_and_no_other(processes):
    def work(k):
        if k == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return k * k

    found = list(processes(work, range(5)))
    assert [one for one in found if not isinstance(one, Lost)] == [0, 1, 9, 16]
    assert isinstance(found[2], Lost) and "ended twice without an answer" in found[2].reason


@pytest.mark.slow
def test_one_that_dies_between_two_calls_is_replaced(processes):
    list(processes(lambda k: k, range(4)))
    worker_processes()[0].kill()
    assert list(processes(lambda k: k + 1, range(4))) == [1, 2, 3, 4]


@pytest.mark.slow
def test_an_error_ends_them_and_the_next_call_starts_others(processes):
    def work(k):
        if k == 0:
            raise ValueError("odd")
        time.sleep(60)

    with pytest.raises(ValueError, match="odd"):
        list(processes(work, range(4)))
    assert not worker_processes()
    assert list(processes(lambda k: k, range(3))) == [0, 1, 2]


SCRIPT = """if True:
    import sys, time, torch
    from torchbrdf.parallel import process_map
    torch.set_num_threads(2)
    def work(k):
        print("at work", flush=True)
        time.sleep(300)
    list(process_map(work, range(4)))
"""


@pytest.fixture
def script():
    """A process whose workers are both at work, for minutes."""
    environment = {**os.environ, "TORCHBRDF_PROCESSES": "always"}
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    assert [process.stdout.readline() for _ in range(2)] == ["at work\n"] * 2
    yield process
    process.kill()
    process.communicate()


def test_none_stays_when_its_parent_is_killed(script):
    """Killed by SIGKILL, or by SIGTERM without a handler, which is the same to them."""
    every = psutil.Process(script.pid).children(recursive=True)
    assert len(every) >= 2
    script.kill()
    script.wait(20)
    assert gone(every)


def test_ctrl_c_does_not_wait_for_one_that_is_stopped(script):
    workers = worker_processes(script.pid)
    workers[0].suspend()
    began = time.monotonic()
    script.send_signal(signal.SIGINT)
    assert gone(workers)
    _, complaints = script.communicate(timeout=20)
    assert time.monotonic() - began < 20  # seconds; two, but on a machine that is busy with tests
    assert complaints.rstrip().endswith("KeyboardInterrupt")
    assert script.returncode == -signal.SIGINT
