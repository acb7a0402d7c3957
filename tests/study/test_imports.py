"""A study starts at once: asking people needs no torch."""

import subprocess
import sys

import pytest

HEAVY = {"torch", "numpy", "scipy", "PIL", "matplotlib", "kornia"}


@pytest.mark.parametrize(("module", "needed"), [("torchbrdf.study", "random"), ("torchbrdf.study.server", "flask")])
def test_importing_a_study_imports_no_torch(module, needed):
    code = f"import {module}, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = set(done.stdout.split())
    assert {module, needed} <= found
    assert not HEAVY & found
