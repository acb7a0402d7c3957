"""Progress of long work where no terminal shows it."""

import io
import re
import subprocess
import sys
import time

import pytest

from torchbrdf.cli import main, progress
from torchbrdf.cli.progress import Stages, progress_bar, reporting


@pytest.fixture
def now() -> list[float]:
    return [0.0]


@pytest.fixture
def stages(now: list[float]) -> Stages:
    return Stages(lambda: now[0])


def test_before_the_first_stage_there_is_only_time(stages: Stages, now: list[float]) -> None:
    now[0] = 10.0
    assert stages.line() == "starting, 10 s so far"


def test_a_line_has_stage_share_and_time_left(stages: Stages, now: list[float]) -> None:
    stages.tell("fits", 0, 90)
    now[0] = 10.0
    assert stages.line() == "fits: 0 % done, 10 s so far"
    stages.tell("fits", 9, 90)
    assert stages.line() == "fits: 10 % done, 1 min 30 s left"
    now[0] = 40.0  # nothing was told since
    assert stages.line() == "fits: 10 % done, 1 min left"
    now[0] = 400.0
    assert stages.line() == "fits: 10 % done, slower now, 6 min 30 s since the last"


def test_what_an_earlier_run_has_done_took_no_time(stages: Stages, now: list[float]) -> None:
    stages.tell("fits", 80, 90)
    now[0] = 10.0
    stages.tell("fits", 85, 90)
    assert stages.line() == "fits: 94 % done, 10 s left"


def test_stages_follow_each_other(stages: Stages, now: list[float]) -> None:
    stages.tell("fits", 0, 4)
    now[0] = 100.0
    stages.tell("fits", 4, 4)
    now[0] = 112.0
    assert stages.line() == "fits: done; what follows has taken 12 s so far"
    stages.tell("renders", 0, 10)
    now[0] = 113.0
    stages.tell("renders", 1, 10)
    assert stages.line() == "renders: 10 % done, 9 s left"


def test_nothing_to_do_is_done(stages: Stages) -> None:
    stages.tell("fits", 0, 0)
    assert stages.line() == "fits: done; what follows has taken 0 s so far"


def test_lines_come_at_even_times_and_end_with_the_work(monkeypatch, capsys) -> None:
    monkeypatch.setattr(progress, "SECONDS", 0.1)
    with reporting():
        tell = progress_bar("fits")
        tell(1, 4)
        time.sleep(0.35)
    lines = capsys.readouterr().err.splitlines()
    assert 1 <= len(lines) <= 3 and set(lines) == {"torchbrdf: fits: 25 % done, 0 s so far"}
    time.sleep(0.15)
    assert capsys.readouterr().err == ""


def test_work_that_is_short_says_nothing(capsys) -> None:
    with reporting():
        progress_bar("fits")(1, 4)
    assert capsys.readouterr().err == ""


def test_outside_a_command_progress_says_nothing(capsys) -> None:
    progress_bar("fits")(1, 4)
    assert capsys.readouterr().err == ""


def test_a_terminal_gets_a_bar(monkeypatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    with reporting():
        tell = progress_bar("fits")
        tell(1, 4)
        tell(4, 4)
    said = sys.stderr.getvalue()
    assert "fits: 100%" in said and "torchbrdf" not in said


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "PAINT", "--samples", "300", "--lobes", "1", "--loss", "rms"],
        ["render", "PAINT", "--size", "24", "--out", "OUT"],
        ["view", "PAINT", "--size", "24", "--steps", "2", "--out", "OUT/view.html"],
        ["export", "PAINT", "--to", "mitsuba", "--out", "OUT"],
        ["check", "PAINT"],
        ["match", "PAINT", "--budget", "quick", "--out", "OUT"],
        ["run", "make_standins", "quick=true", "--out", "OUT"],
    ],
)
def test_long_commands_say_how_far_they_are(paint, tmp_path, monkeypatch, capsys, arguments) -> None:
    """Each has stages with a label, all of which end."""
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "cache"))
    told: list[tuple[str, int, int]] = []
    monkeypatch.setattr(Stages, "tell", lambda self, *what: told.append(what))
    monkeypatch.setattr(progress, "SECONDS", 600.0)  # a machine may be slow
    filled = [a.replace("PAINT", str(paint)).replace("OUT", str(tmp_path / "out")) for a in arguments]
    assert main(filled) == 0
    labels = {label for label, _, _ in told}
    assert labels and all(re.fullmatch("[a-z, -]+", label) for label in labels)
    for label in labels:
        assert any(done >= total for one, done, total in told if one == label), label
    assert capsys.readouterr().err == ""


def test_a_pipe_that_nobody_reads_does_no_harm() -> None:
    code = (
        "import sys, time; from torchbrdf.cli import progress; progress.SECONDS = 0.05\n"
        "sys.stderr.close()\n"
        "with progress.reporting(): time.sleep(0.2)\n"
        "print('done')"
    )
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout == "done\n"
