"""Work on any executor, and on a Dask cluster whose workers die, come late, or have no torchbrdf, or another one."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest
import torch
from helpers.dask_cluster import dask_cluster
from helpers.tiny_materials import write_tiny

from torchbrdf import fit
from torchbrdf.errors import DataError, UsageError
from torchbrdf.executors import executor_of, side_by_side
from torchbrdf.fitting import Batches
from torchbrdf.lobes import make_model
from torchbrdf.losses import RMSLoss
from torchbrdf.measured import load, load_later


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("tiny"), 96, 60)


def batches(out=None):
    return Batches(make_model("ward", 1), RMSLoss(), out=out, samples=None, diffuse="fit")


def plain(records):
    return [{key: value for key, value in one.to_json().items() if key != "seconds"} for one in records]


@pytest.fixture(scope="module")
def serial(files):
    """The fits of one thread."""
    with ThreadPoolExecutor(1) as executor:
        return plain(batches().run(load_later(files), executor=executor))


@pytest.mark.parametrize("place", [None, "threads", ThreadPoolExecutor(3)])
def test_numbers_do_not_depend_on_where_blocks_are_fitted(files, serial, place, two_threads):
    seen = []
    found = batches().run(load_later(files), lambda *now: seen.append(now), executor=place)
    assert plain(found) == serial
    assert seen == [(done, 96) for done in range(0, 97, 6)]
    assert torch.get_num_threads() == 2


@pytest.mark.slow
def test_processes_find_the_same(files, serial, two_threads):
    assert plain(batches().run(load_later(files), executor="processes")) == serial
    with ProcessPoolExecutor(2) as executor:
        assert plain(batches().run(load_later(files), executor=executor)) == serial


def test_a_fit_takes_any_executor(files):
    measured = load(files[:12])
    options = {"samples": None, "diffuse": "fit"}
    with ThreadPoolExecutor(2) as executor:
        found = fit(make_model("ward", 1), measured, RMSLoss(), executor=executor, **options)
    expected = fit(make_model("ward", 1), measured, RMSLoss(), **options)
    assert found.status == expected.status and torch.equal(found.error, expected.error)


def test_what_is_raised_there_is_raised_here():
    def fails(k):
        raise ValueError(f"not {k}")

    with ThreadPoolExecutor(2) as executor, pytest.raises(ValueError, match=r"not [01]"):
        list(side_by_side(fails, [0, 1], executor))


def test_work_that_cannot_be_sent_is_said():
    lock = __import__("threading").Lock()
    with ThreadPoolExecutor(1) as executor, pytest.raises(UsageError, match="executor: the work cannot be given"):
        list(side_by_side(lambda k: lock, [0], executor))


def test_an_executor_that_is_shut_down_is_said():
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(DataError, match=r"ThreadPoolExecutor: the executor is gone .*what is written is kept"):
        list(side_by_side(abs, [1], executor))


def test_an_executor_whose_processes_die_is_said():
    with (
        ProcessPoolExecutor(1) as executor,
        pytest.raises(DataError, match="ProcessPoolExecutor: the executor is gone"),
    ):
        list(side_by_side(lambda k: os.kill(os.getpid(), signal.SIGKILL), [1], executor))


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"expected the extra: pip install 'torchbrdf\[dask\]'"), executor_of("dask"):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x", "tcp://no.such.host.invalid:8786"])
def test_a_scheduler_that_is_not_there_is_one_line(address, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("torchbrdf.executors.PATIENCE", 2.0)
    with (
        pytest.raises(DataError, match=f"{address}: expected a Dask scheduler, found none") as caught,
        executor_of("dask", address),
    ):
        pass
    assert len(str(caught.value)) <= 300 and "\n" not in str(caught.value)


@pytest.mark.slow
def test_workers_that_die_and_come_late_change_nothing(files, serial, tmp_path):
    pytest.importorskip("distributed")
    out, seen = tmp_path / "out", []
    with dask_cluster(tmp_path, 4) as cluster, executor_of("dask", cluster.address) as executor:
        executor._client.wait_for_workers(4, timeout=120)

        def progress(done, total):
            seen.append((done, total))
            if len(seen) == 3:
                for worker in cluster.workers[:2]:
                    worker.kill()
                cluster.add_worker()

        found = batches(out).run(load_later(files), progress, executor=executor)
    assert plain(found) == serial
    assert seen == [(done, 96) for done in range(0, 97, 6)]
    assert len(list((out / "fits").iterdir())) == 16


@pytest.mark.slow
def test_workers_without_torchbrdf_or_with_another_are_left_out(files, serial, tmp_path, caplog):
    pytest.importorskip("distributed")
    paths = []
    for name, text in {"none": "raise ImportError('no torchbrdf here')\n", "old": "__version__ = '0.0.1'\n"}.items():
        package = tmp_path / name / "torchbrdf"
        package.mkdir(parents=True)
        (package / "__init__.py").write_text(text)
        paths.append(str(package.parent))
    with dask_cluster(tmp_path, 0) as cluster, executor_of("dask", cluster.address) as executor:
        for path in paths:
            cluster.add_worker(PYTHONPATH=path)
        executor._client.wait_for_workers(2, timeout=120)
        with pytest.raises(DataError, match="expected workers with this torchbrdf, found none"):
            batches().run(load_later(files), executor=executor)
        cluster.add_worker()
        executor._client.wait_for_workers(3, timeout=120)
        caplog.clear()
        assert plain(batches().run(load_later(files), executor=executor)) == serial
    lines = [line for line in caplog.messages if "left out" in line]
    assert len(lines) == 2 and any("found no torchbrdf here" in line for line in lines)
    assert any("found torchbrdf 0.0.1" in line for line in lines)


@pytest.mark.slow
def test_a_scheduler_that_goes_away_is_one_line_and_the_rest_is_taken_up(files, serial, tmp_path):
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    with dask_cluster(tmp_path, 1) as cluster, executor_of("dask", cluster.address) as executor:
        executor._client.wait_for_workers(1, timeout=120)

        def progress(done, total):
            if done >= 12:
                cluster.scheduler.kill()
                time.sleep(0.5)

        with pytest.raises(DataError, match=r"the executor is gone .*; what is written is kept: run it again to go on"):
            batches(out).run(load_later(files), progress, executor=executor)
    assert 0 < len(list((out / "fits").iterdir())) < 16
    assert plain(batches(out).run(load_later(files))) == serial


@pytest.mark.slow
def test_workers_on_this_machine_do_not_run_the_script_again(files, tmp_path):
    pytest.importorskip("distributed")
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\nfrom torchbrdf.cli import main\nprint('once', flush=True)\n"
        f"sys.exit(main(['fit', {str(files[0].parent)!r}, '--lobes', '1', '--loss', 'rms', '--executor', 'dask', "
        f"'--out', {str(tmp_path / 'out')!r}]))\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0 and done.stdout.count("once") == 1, done.stderr
    assert len(list((tmp_path / "out" / "fits").iterdir())) == 16
