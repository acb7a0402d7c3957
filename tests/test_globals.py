"""Torch's globals and modes change no result: default dtype and device, autocast, inference mode, determinism."""

import ast
import importlib
import pkgutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.measured_files import synthetic_bsdf, tensor_file
from helpers.public_api import results
from torch import Tensor

import torchbrdf

# What makes a tensor of numbers of Python, and so takes torch's default dtype and device where it names none.
BOTH = {"tensor", "as_tensor", "zeros", "ones", "empty", "full", "eye", "linspace", "rand", "randn", "arange"}
# The same, but always whole numbers.
WHOLE = {"randint", "randperm", "triu_indices", "tril_indices"}


@contextmanager
def switched(switch: Callable[[Any], None], on: Any, off: Any) -> Iterator[None]:
    """One of torch's switches on, and off again."""
    switch(on)
    try:
        yield
    finally:
        switch(off)


MODES: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "float64": partial(switched, torch.set_default_dtype, torch.float64, torch.float32),
    "float16": partial(switched, torch.set_default_dtype, torch.float16, torch.float32),
    "another device": partial(switched, torch.set_default_device, "meta", None),
    "autocast": partial(torch.autocast, "cpu", dtype=torch.bfloat16),
    "inference": torch.inference_mode,
    "no gradients": partial(switched, torch.set_grad_enabled, False, True),
    "deterministic": partial(switched, torch.use_deterministic_algorithms, True, False),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, merl_file: Path) -> list[Path]:
    """A MERL table and an RGL measurement."""
    rgl = tmp_path_factory.mktemp("rgl") / "made-up_rgb.bsdf"
    rgl.write_bytes(tensor_file(synthetic_bsdf()))
    return [merl_file, rgl]


@pytest.fixture(scope="module")
def undisturbed(files: list[Path]) -> dict[str, Tensor]:
    return results(files)


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_no_result_changes(files: list[Path], undisturbed: dict[str, Tensor], mode: str) -> None:
    with MODES[mode]():
        found = results(files)
    differing = {
        name: (value.dtype, found[name].dtype, (value.double() - found[name].double()).abs().max().item())
        for name, value in undisturbed.items()
        if value.dtype != found[name].dtype or not torch.equal(value.nan_to_num(-1), found[name].nan_to_num(-1))
    }
    assert not differing


def factories(tree: ast.AST) -> Iterator[tuple[int, str, set[str]]]:
    """Line, name and missing keywords of every call of torch's that makes a tensor."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="torch"), attr=name)) if name in BOTH | WHOLE:
                needed = {"dtype", "device"} if name in BOTH else {"device"}
                if missing := needed - {keyword.arg for keyword in node.keywords}:
                    yield node.lineno, name, missing
            case ast.Call(func=ast.Attribute(value=ast.Name(id="torch"), attr="Generator"), args=[]):
                if not node.keywords:
                    yield node.lineno, "Generator", {"device"}


def test_every_factory_names_its_dtype_and_device() -> None:
    root = Path(torchbrdf.__file__).parent
    paths = [path for part in sorted(root.iterdir()) for path in ([part] if part.is_file() else part.rglob("*.py"))]
    sources = {path.relative_to(root): path.read_text(encoding="utf-8") for path in paths if path.suffix == ".py"}
    found = [
        f"{path}:{line}: torch.{name} without {' and '.join(sorted(missing))}"
        for path, text in sources.items()
        for line, name, missing in factories(ast.parse(text))
    ]
    assert len(sources) > 100 and not found


@pytest.mark.parametrize(
    ("code", "missing"),
    [
        ("torch.zeros(3)", {"dtype", "device"}),
        ("torch.arange(3, device=x.device)", {"dtype"}),
        ("torch.randperm(3)", {"device"}),
        ("torch.Generator()", {"device"}),
        ("torch.Generator('cpu'), torch.zeros_like(x), x.new_zeros(3), torch.zeros(3, dtype=d, device=e)", None),
    ],
)
def test_what_counts_as_a_factory(code: str, missing: set[str] | None) -> None:
    assert [found for _, _, found in factories(ast.parse(code))] == ([missing] if missing else [])


def test_no_module_holds_a_tensor() -> None:
    """It would be of the dtype, the device and the mode that the first import met."""
    for one in pkgutil.walk_packages(torchbrdf.__path__, "torchbrdf."):
        if not one.name.endswith("__main__"):
            module = importlib.import_module(one.name)
            assert not [name for name, value in vars(module).items() if isinstance(value, Tensor)], one.name
