"""What all tests share."""

import os
from collections.abc import Iterator
from pathlib import Path

# Before torch is imported: its threads spin while they wait, and make a machine with other work crawl.
os.environ.setdefault("GOMP_SPINCOUNT", "3000")
if "PYTEST_XDIST_WORKER" in os.environ:  # a process a core: threads of torch beside it only get in the way
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
import torch
from hypothesis import settings

settings.register_profile("torchbrdf", deadline=None)
settings.load_profile("torchbrdf")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of measured data, which is no part of the project."""
    default = Path(__file__).resolve().parents[1] / ".." / "shared" / "data"
    folder = Path(os.environ.get("TORCHBRDF_DATA", default)).resolve()
    if not folder.is_dir():
        pytest.skip(f"needs measured data: no folder {folder}; set TORCHBRDF_DATA")
    return folder


@pytest.fixture(scope="session")
def merl_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A MERL table with made-up entries, 35 MB: `measured_files.synthetic_raw(0)`."""
    from helpers.measured_files import synthetic_raw, write_raw_merl

    return write_raw_merl(tmp_path_factory.mktemp("merl") / "made-up.binary", synthetic_raw(0))


@pytest.fixture
def two_threads() -> Iterator[None]:
    """Torch has two threads, which workers then share out."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)
