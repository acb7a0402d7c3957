"""Killed commands are taken up, end as if nothing had been, and leave nothing: benchmarks/kills.py in short."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "kills.py"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "kills"),
    [("fit", 2), ("share", 1), ("collect", 1), ("run", 1), ("train", 1), ("render", 2), ("match", 1), ("texels", 1)],
)
def test_a_killed_command_is_taken_up_and_leaves_nothing(work, kills):
    done = subprocess.run(
        [sys.executable, SCRIPT, work, "--kills", str(kills)], capture_output=True, text=True, timeout=1800, check=False
    )
    assert done.returncode == 0 and f"{kills} kills" in done.stdout and "0 wrong" in done.stdout, (
        done.stdout + done.stderr
    )
