"""Maps over threads and processes: order, errors with the worker's own traceback, who works where."""

import logging
import os
import subprocess
import sys
import threading
import time
import traceback
import types

import pytest
import torch

from torchbrdf import parallel
from torchbrdf.errors import DataError, UsageError
from torchbrdf.parallel import process_map, thread_map
from torchbrdf.workers import Workers


@pytest.fixture(params=["threads", "processes"])
def run(request, two_threads, monkeypatch):
    """A map in threads, or in processes that are started at once."""
    if request.param == "threads":
        return thread_map
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "always")
    return process_map


@pytest.fixture
def processes(two_threads, monkeypatch):
    """A map in processes that are started at once."""
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "always")
    return process_map


def test_results_come_in_the_order_of_the_items(run):
    items = list(range(20))
    assert list(run(lambda k: k * k, items)) == [k * k for k in items]
    assert list(run(lambda k: k, [])) == []


def test_each_worker_has_one_thread_and_no_gradients_and_the_caller_keeps_its_own(run):
    found = list(run(lambda k: (torch.get_num_threads(), torch.is_grad_enabled()), range(4)))
    assert set(found) == {(1, False)}
    assert torch.get_num_threads() == 2
    assert torch.is_grad_enabled()


def test_processes_are_not_this_one(processes):
    assert os.getpid() not in set(processes(lambda k: os.getpid(), range(4)))


def test_little_work_is_done_in_threads(two_threads, monkeypatch):
    monkeypatch.delenv("TORCHBRDF_PROCESSES", raising=False)
    monkeypatch.setattr(parallel, "WORKERS", Workers())  # none of which runs
    assert set(process_map(lambda k: os.getpid(), range(4))) == {os.getpid()}
    assert not parallel.WORKERS.are_ready(2)


@pytest.mark.slow
def test_much_work_moves_to_processes_once_they_have_started(two_threads, monkeypatch):
    monkeypatch.delenv("TORCHBRDF_PROCESSES", raising=False)
    monkeypatch.setattr(parallel, "WORTH", 0.5)
    workers = Workers()  # none of which runs, whatever other tests have started
    monkeypatch.setattr(parallel, "WORKERS", workers)

    def work(k):
        time.sleep(0.2)
        return k, os.getpid()

    try:
        found = list(process_map(work, range(300)))
    finally:
        workers.kill()
    assert [k for k, _ in found] == list(range(300))
    where = [process == os.getpid() for _, process in found]
    assert where[0] and not where[-1]
    assert where == sorted(where, reverse=True)


def test_a_rule_that_is_none_is_refused(two_threads, monkeypatch):
    monkeypatch.setenv("TORCHBRDF_PROCESSES", "no")
    with pytest.raises(UsageError, match="TORCHBRDF_PROCESSES: expected always or never, found 'no'"):
        list(process_map(str, [1, 2]))


def test_what_a_worker_raises_shows_the_workers_own_traceback(run):
    def fails_deep_inside(k):
        if k == 1:
            raise DataError("material 1 is odd")
        return k

    with pytest.raises(DataError, match="material 1 is odd") as caught:
        list(run(fails_deep_inside, [0, 1, 2]))
    shown = "".join(traceback.format_exception(caught.value))
    assert "in fails_deep_inside" in shown
    assert shown.count("DataError: material 1 is odd") == (1 if run is thread_map else 2)  # there, and here


def test_who_stops_listening_waits_for_no_further_item(run, tmp_path):
    def work(k):
        (tmp_path / str(k)).touch()
        time.sleep(0.01)
        return k

    answers = run(work, range(200))
    assert next(answers) == 0
    answers.close()
    done = len(list(tmp_path.iterdir()))
    assert done < 200
    time.sleep(0.1)
    assert len(list(tmp_path.iterdir())) == done


def test_threads_are_stopped_where_they_are(two_threads):
    """Ctrl-C is heard by the main thread, and must not wait for items that take minutes."""

    def work(k):
        if k == 1:
            raise DataError("enough")
        for _ in range(1000):
            time.sleep(0.1)

    began = time.monotonic()
    answers = thread_map(work, [1, 2])
    with pytest.raises(DataError, match="enough"):
        list(answers)
    assert time.monotonic() - began < 20


def test_what_cannot_be_pickled_is_done_in_threads_and_the_log_says_so(processes, caplog):
    lock = threading.Lock()  # cannot be pickled

    def work(k):
        with lock:
            return k, os.getpid()

    with caplog.at_level(logging.INFO, "torchbrdf"):
        assert list(processes(work, range(3))) == [(k, os.getpid()) for k in range(3)]
    assert "working in threads, as processes cannot be given the work: TypeError" in caplog.text


def test_a_function_of_a_module_that_workers_do_not_find_is_done_in_threads(processes, monkeypatch, caplog):
    module = types.ModuleType("only_here")
    exec("import os\ndef work(k):\n    return k, os.getpid()", vars(module))
    monkeypatch.setitem(sys.modules, "only_here", module)
    with caplog.at_level(logging.INFO, "torchbrdf"):
        assert list(processes(module.work, range(3))) == [(k, os.getpid()) for k in range(3)]
    assert "No module named 'only_here'" in caplog.text


def test_workers_compute_with_this_processs_defaults(processes):
    before = torch.get_default_dtype()
    try:
        for dtype in (torch.float64, torch.float32):
            torch.set_default_dtype(dtype)
            assert set(processes(lambda k: torch.zeros(1).dtype, range(2))) == {dtype}
    finally:
        torch.set_default_dtype(before)


@pytest.mark.slow
def test_two_threads_that_use_processes_both_end(processes):
    found = {}

    def use(name):
        found[name] = list(processes(lambda k: k * k, range(6)))

    threads = [threading.Thread(target=use, args=(name,)) for name in "ab"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert found == {name: [0, 1, 4, 9, 16, 25] for name in "ab"}


def test_a_daemonic_process_works_in_threads(two_threads):
    """As in a worker of multiprocessing.Pool, which may have no children; forked from a process that has used torch."""
    code = """if True:
        import multiprocessing, os, torch
        from torchbrdf.parallel import process_map

        def whole(_):
            return list(process_map(lambda k: (os.getpid(), (torch.ones(100, 100) @ torch.ones(100, 100))[0, 0].item()),
                                    range(4)))

        torch.set_num_threads(2)
        torch.ones(1000, 1000).exp().sum()
        with multiprocessing.get_context("fork").Pool(1) as pool:
            (found,) = pool.map(whole, [0])
        assert len({process for process, _ in found}) == 1 and found[0][0] != os.getpid(), found
    """
    environment = {**os.environ, "TORCHBRDF_PROCESSES": "always", "OMP_NUM_THREADS": "2"}
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, env=environment)


def test_a_fork_of_a_process_that_has_fitted_fits():
    code = """if True:
        import multiprocessing, os, torch
        from torchbrdf import fit, load
        from torchbrdf.lobes import make_model
        from torchbrdf.losses import CubeRootLoss
        from torchbrdf.measured import standins

        def error(_):
            measured = load(standins()).batch([0, 1, 2])
            return fit(make_model("ward", 1), measured, CubeRootLoss(), samples=500, max_theta=40).error

        torch.set_num_threads(2)
        here = error(0)
        with multiprocessing.get_context("fork").Pool(1) as pool:
            torch.testing.assert_close(pool.map_async(error, [0]).get(60)[0], here, rtol=1e-4, atol=0)
    """
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, env={**os.environ, "OMP_NUM_THREADS": "2"})


def test_a_script_without_a_guard_runs_once(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import os, torch\n"
        "from torchbrdf.parallel import process_map\n"
        "torch.set_num_threads(2)\n"
        "print('began')\n"
        "scale = 3\n"
        "def work(k):\n"
        "    return scale * k, os.getpid()\n"
        "found = list(process_map(work, range(4)))\n"
        "assert os.getpid() not in {process for _, process in found}\n"
        "print([k for k, _ in found])\n"
    )
    environment = {**os.environ, "TORCHBRDF_PROCESSES": "always"}
    done = subprocess.run(
        [sys.executable, script], check=True, timeout=120, env=environment, capture_output=True, text=True
    )
    assert done.stdout == "began\n[0, 3, 6, 9]\n"
    assert done.stderr == ""


def test_maps_within_a_map_stay_on_its_thread(two_threads):
    def inner(k):
        return threading.get_ident()

    def outer(k):
        return {threading.get_ident(), *thread_map(inner, range(3)), *process_map(inner, range(3))}

    assert all(len(own) == 1 for own in thread_map(outer, range(6)))
