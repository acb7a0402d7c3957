"""Maps over threads and processes: order, errors with the worker's own traceback, processes that die."""

import logging
import os
import subprocess
import sys
import traceback

import pytest
import torch

from torchbrdf.errors import DataError
from torchbrdf.parallel import process_map, thread_map


def fails_deep_inside(k: int) -> int:
    if k == 1:
        raise DataError("material 1 is odd")
    return k


@pytest.mark.parametrize("run", [thread_map, process_map])
def test_results_come_in_the_order_of_the_items(two_threads, run):
    items = list(range(20))
    assert list(run(lambda k: k * k, items)) == [k * k for k in items]
    assert list(run(lambda k: k, [])) == []


@pytest.mark.parametrize("run", [thread_map, process_map])
def test_each_worker_has_one_thread_and_no_gradients_and_the_caller_keeps_its_own(two_threads, run):
    found = list(run(lambda k: (torch.get_num_threads(), torch.is_grad_enabled()), range(4)))
    assert set(found) == {(1, False)}
    assert torch.get_num_threads() == 2
    assert torch.is_grad_enabled()


def test_processes_are_not_this_one(two_threads):
    assert os.getpid() not in set(process_map(lambda k: os.getpid(), range(4)))


@pytest.mark.parametrize("run", [thread_map, process_map])
def test_what_a_worker_raises_shows_the_workers_own_traceback(two_threads, run):
    with pytest.raises(DataError, match="material 1 is odd") as caught:
        list(run(fails_deep_inside, [0, 1, 2]))
    shown = "".join(traceback.format_exception(caught.value))
    assert "in fails_deep_inside" in shown
    assert 'raise DataError("material 1 is odd")' in shown


def test_a_process_that_dies_is_said_in_one_line(two_threads):
    with pytest.raises(RuntimeError, match=r"^a worker process ended without an answer: out of memory\?$") as caught:
        list(process_map(lambda k: os._exit(3), [0, 1, 2]))
    assert caught.value.__suppress_context__


def test_who_stops_listening_waits_for_no_further_item(two_threads, tmp_path):
    def work(k):
        (tmp_path / str(k)).touch()
        return k

    answers = process_map(work, range(200))
    assert next(answers) == 0
    answers.close()
    done = len(list(tmp_path.iterdir()))
    assert done < 200
    assert len(list(tmp_path.iterdir())) == done


def test_with_cuda_in_use_it_works_in_threads_and_says_so(two_threads, monkeypatch, caplog):
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    with caplog.at_level(logging.INFO, "torchbrdf"):
        assert set(process_map(lambda k: os.getpid(), range(4))) == {os.getpid()}
    assert "working in threads" in caplog.text


@pytest.mark.slow
def test_processes_do_not_wait_for_locks_of_threads_that_are_gone():
    """Products in threads, then in forks: MKL's allocator made this hang within a few rounds."""
    code = """if True:
        import torch
        from torchbrdf.parallel import thread_map, process_map

        torch.set_num_threads(2)
        a, b = torch.rand(4, 3, 33, 4000, dtype=torch.float64), torch.rand(1, 4000, 33, dtype=torch.float64)
        work = lambda k: sum((a @ b).sum().item() for _ in range(4))
        for _ in range(6):
            torch.rand(3, 500, 500, requires_grad=True).square().sum().backward()
            list(thread_map(work, [0, 1]))
            list(process_map(work, [0, 1, 2, 3]))
    """
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
