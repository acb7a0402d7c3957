"""Every example in a docstring runs and gives what it says."""

import doctest
import importlib
from pathlib import Path

import pytest

import torchbrdf

ROOT = Path(torchbrdf.__file__).parent


def modules_with_examples() -> list[str]:
    found = [
        path.relative_to(ROOT) for path in sorted(ROOT.rglob("*.py")) if ">>> " in path.read_text(encoding="utf-8")
    ]
    return [".".join(["torchbrdf", *path.with_suffix("").parts]).removesuffix(".__init__") for path in found]


@pytest.mark.parametrize("name", modules_with_examples())
def test_examples_run(name: str) -> None:
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted
    assert not found.failed
