"""The command line as a process that gets signals: it ends soon, with a status that says why, and leaves nothing."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from torchbrdf.measured import standins


def start(out, processes="never", prefix=""):
    """A fit of minutes that has begun."""
    code = f"import sys; {prefix}from torchbrdf.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "fit", str(standins()), "--samples", "0", "--out", str(out)]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TORCHBRDF_PROCESSES": processes, "OMP_NUM_THREADS": "2" if processes == "always" else "1"},
        start_new_session=True,
    )
    until = time.monotonic() + 120
    wanted = 2 if processes == "always" else 0
    while not out.exists() or len(workers(process)) < wanted:
        assert process.poll() is None and time.monotonic() < until
        time.sleep(0.1)
    time.sleep(1)
    return process


def workers(process):
    return [one for one in psutil.Process(process.pid).children() if "popen_loky" in " ".join(one.cmdline())]


def end(process, number):
    """Its standard error after a signal, and the processes that it had."""
    every = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(number)
    try:
        return process.communicate(timeout=20)[1], every
    finally:
        process.kill()


def assert_gone(processes):
    _, left = psutil.wait_procs(processes, 20)
    left = [one for one in left if one.is_running() and one.status() != psutil.STATUS_ZOMBIE]
    for one in left:
        one.kill()
    assert not left


@pytest.mark.parametrize(
    ("name", "processes"),
    [("SIGTERM", "never"), pytest.param("SIGHUP", "always", marks=pytest.mark.slow)],
)
def test_a_signal_ends_it_as_ctrl_c_does(tmp_path, name, processes):
    number = signal.Signals[name]
    process = start(tmp_path / "out", processes)
    said, every = end(process, number)
    assert process.returncode == 128 + number
    assert said == "torchbrdf: stopped\n"
    assert_gone(every)
    assert {path.name for path in (tmp_path / "out").iterdir()} <= {"fits.json", "fits.csv", "manifest.json", "fits"}


@pytest.mark.slow
def test_ctrl_c_ends_it_though_a_worker_is_stopped(tmp_path):
    process = start(tmp_path / "out", "always", "import signal; signal.signal(2, signal.default_int_handler); ")
    workers(process)[0].suspend()
    said, every = end(process, signal.SIGINT)
    assert process.returncode == 130 and said == "torchbrdf: stopped\n"
    assert_gone(every)


@pytest.mark.slow
def test_none_stays_when_it_is_killed(tmp_path):
    process = start(tmp_path / "out", "always")
    _, every = end(process, signal.SIGKILL)
    assert len(every) >= 2
    assert_gone(every)


def test_a_signal_that_is_ignored_stays_so(tmp_path):
    """As nohup has it."""
    process = start(tmp_path / "out", "never", "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN); ")
    process.send_signal(signal.SIGHUP)
    time.sleep(1)
    assert process.poll() is None
    end(process, signal.SIGTERM)
    assert process.returncode == 143


def test_a_call_that_hears_no_signal_is_ended_all_the_same():
    """The main thread is in a library for long, where no exception can be raised."""
    code = """if True:
        import ctypes, signal, sys
        from torchbrdf.cli.signals import ending
        with ending():
            print("begun", flush=True)
            while True:
                ctypes.CDLL(None).usleep(20_000_000)  # without Python's lock; goes on after a signal
    """
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begun\n"
    time.sleep(0.2)
    began = time.monotonic()
    process.terminate()
    assert process.wait(20) in (143, 1)
    assert time.monotonic() - began < 15


# --- while modules are imported -------------------------------------------------------------------------------------

SIGNALS = [signal.SIGTERM, signal.SIGINT, signal.SIGHUP]


def start_listening(*arguments):
    """A command that has just begun to hear signals, and has torch and the like still to import."""
    own = "import signal; signal.signal(2, signal.default_int_handler); signal.signal(1, signal.SIG_DFL)"
    code = f"{own}; import sys; from torchbrdf.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 60
    while not hears(process.pid, signal.SIGTERM):
        assert process.poll() is None and time.monotonic() < until
        time.sleep(0.002)
    return process


def hears(pid, number):
    status = Path(f"/proc/{pid}/status").read_text()
    (caught,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught, 16) >> (number - 1) & 1)


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc to see that signals are heard")
@pytest.mark.parametrize(
    "delays",
    [(0, 0.15, 0.4), pytest.param([k * 0.06 for k in range(14)], marks=pytest.mark.slow)],
    ids=["few", "many"],
)
def test_a_signal_while_modules_are_imported_ends_it_as_later(tmp_path, delays):
    for k, delay in enumerate(delays):
        number = SIGNALS[k % 3]
        process = start_listening("fit", standins(), "--samples", "all", "--out", tmp_path / "out")
        time.sleep(delay)
        said, _ = end(process, number)
        assert (process.returncode, said) == (128 + number, "torchbrdf: stopped\n"), delay


IMPORTING = """if True:
    import sys, time
    from torchbrdf.cli.signals import EndedError, ending
    from torchbrdf.files import locked, replacing
    sys.path.insert(0, sys.argv[1])
    try:
        with ending(None), locked(sys.argv[2]), replacing(sys.argv[2] + "/x.txt") as temporary:
            temporary.write_text("half")
            import slow_module
            time.sleep(10)
            raise SystemExit("no signal was heard")
    except EndedError as error:
        import slow_module
        print("ended by", error.number, "after", slow_module.done)
"""


def test_a_signal_while_something_is_imported_and_written_waits_for_the_import(tmp_path):
    """Half a module would stay, or the temporary file."""
    (tmp_path / "slow_module.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGTERM)\ntime.sleep(0.3)\ndone = 'all'\n"
    )
    out = tmp_path / "out"
    command = [sys.executable, "-c", IMPORTING, str(tmp_path), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("ended by 15 after all\n", "")
    assert not list(out.iterdir())
