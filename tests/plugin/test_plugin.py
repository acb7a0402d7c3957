"""Another package's lobe, loss, format, difference, strategy, exporter and recipe, installed and used by name."""

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere

from torchbrdf.errors import DataError, UsageError
from torchbrdf.lobes import Lambert, Sum, Ward
from torchbrdf.measured import BrdfFormat, Measured
from torchbrdf.pairs import Pairs
from torchbrdf.recipe import find_recipe

PACKAGE = Path(__file__).parent / "package"
CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a process that finds the package, which is installed nowhere else."""
    pytest.importorskip("setuptools", minversion="70.1", reason="older ones build wheels with another package's help")
    folder = tmp_path_factory.mktemp("plugin")
    shutil.copytree(PACKAGE, folder / "package")  # building leaves files beside the sources
    target = folder / "installed"
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    command = [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(folder / "package")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    path = os.pathsep.join([str(target), str(CHECKOUT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "TORCHBRDF_CACHE": str(folder / "cache")}


@pytest.fixture(scope="session")
def paint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scattered samples of a model, in the package's format."""
    wi = hemisphere(1500, seed=1)
    mirror = wi * torch.tensor([-1.0, -1.0, 1.0]) + 0.5 * hemisphere(1500, seed=2)
    wo = torch.cat([hemisphere(500, seed=3), (mirror / mirror.norm(dim=-1, keepdim=True))[500:]])
    model = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.2, roughness=0.2)).double()
    rgb = model(Pairs.from_directions(wi, wo)).detach()
    path = tmp_path_factory.mktemp("scattered") / "paint.npz"
    np.savez(path, wi=wi, wo=wo, rgb=rgb)
    return path


# Commands one after the other in one process, which imports torch and the package once.
COMMANDS = """
import contextlib, io, json, sys
from torchbrdf.cli import main
for name, arguments in json.loads(sys.argv[1]).items():
    said, complaints = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complaints):
        status = main(arguments)
    print(json.dumps([name, [status, complaints.getvalue()]]))
"""


@pytest.fixture(scope="session")
def ran(
    installed: dict[str, str], paint: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[int, str, Path]]:
    """Commands that use the package: of each its status, what it complained about, and its folder."""
    folder = tmp_path_factory.mktemp("ran")
    fit = ["fit", paint, "--model", "myggx", "--lobes", 1]
    rendered = ["--loss", "rendered", "--difference", "mydifference", "--size", 16, "--lights", 16, "--diffuse", "fit"]
    commands = {
        "recipe": ["run", "myrecipe", "quick=true"],
        "fit": [*fit, "--loss", "rms", "--strategy", "mystrategy"],
        "render": ["render", folder / "fit" / "fits.json", "--size", 24, "--shape", "sphere"],
        "loss": [*fit, "--loss", "myloss"],
        "difference": [*fit, *rendered],
        "export": ["export", CHECKOUT / "assets" / "standins.json", "--to", "myexporter"],
    }
    arguments = {name: [*map(str, own), "--out", str(folder / name)] for name, own in commands.items()}
    program = [sys.executable, "-c", COMMANDS, json.dumps(arguments)]
    done = subprocess.run(program, capture_output=True, text=True, env=installed)
    assert done.returncode == 0, done.stderr
    said = dict(map(json.loads, done.stdout.splitlines()))
    return {name: (*said[name], folder / name) for name in commands}


def assert_only_the_broken_one_is_reported(said: str) -> None:
    (line,) = said.splitlines()
    expected = "torchbrdf: format 'broken' of package other-brdf cannot be loaded from other_brdf.nowhere:Broken: "
    assert line.startswith(expected + "ModuleNotFoundError")


def record_of(ran: dict[str, tuple[int, str, Path]], name: str) -> dict[str, Any]:
    """The only fit of a command."""
    status, said, folder = ran[name]
    assert status == 0, said
    (record,) = json.loads((folder / "fits.json").read_text())
    return record


@pytest.mark.slow
def test_a_lobe_and_a_format_fit_and_are_drawn(ran: dict[str, tuple[int, str, Path]]) -> None:
    record = record_of(ran, "fit")
    assert_only_the_broken_one_is_reported(ran["fit"][1])
    assert (record["material"], record["model"], record["strategy"]) == ("paint", "myggx", "mystrategy")
    assert record["parameters"]["roughness"] == [pytest.approx(0.2, rel=0.5)]
    status, said, folder = ran["render"]
    assert status == 0, said
    assert any(folder.glob("paint*.png"))


@pytest.mark.slow
def test_a_loss_fits(ran: dict[str, tuple[int, str, Path]]) -> None:
    record = record_of(ran, "loss")
    assert record["loss"] == "myloss" and record["error"] < 0.5


@pytest.mark.slow
def test_an_image_difference_is_a_loss(ran: dict[str, tuple[int, str, Path]]) -> None:
    assert record_of(ran, "difference")["loss"] == "rendered_mydifference"


@pytest.mark.slow
def test_an_exporter_writes(ran: dict[str, tuple[int, str, Path]]) -> None:
    status, said, folder = ran["export"]
    assert status == 0, said
    assert len(list(folder.glob("*.mine"))) == 10


@pytest.mark.slow
def test_a_recipe_runs(ran: dict[str, tuple[int, str, Path]]) -> None:
    status, said, folder = ran["recipe"]
    assert (status, said) == (0, "")
    assert (folder / "report.txt").read_text() == "lobes: abc, abc_smooth, ashikhmin_shirley\n"
    assert json.loads((folder / "recipe.json").read_text())["settings"]["quick"] is True


def test_everything_is_listed_and_a_broken_thing_says_why(installed: dict[str, str]) -> None:
    code = """
import torchbrdf.losses
heavy = {"kornia", "matplotlib", "scipy", "trimesh"} & set(__import__("sys").modules)
from torchbrdf.export import EXPORTERS
from torchbrdf.fitting import STRATEGIES
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import LOBES
from torchbrdf.losses import LOSSES
from torchbrdf.measured import FORMATS
from torchbrdf.recipe import RECIPES
kinds = (LOBES, LOSSES, DIFFERENCES, STRATEGIES, EXPORTERS, RECIPES, FORMATS)
print(heavy, *("other_brdf" in {thing.__module__.split(".")[0] for thing in kind.values()} for kind in kinds))
try:
    FORMATS["broken"]
except Exception as error:
    print(type(error).__name__, error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=installed)
    assert_only_the_broken_one_is_reported(done.stderr)
    first, second = done.stdout.splitlines()
    assert first == "set() True True True True True True True"
    assert second.startswith("UsageError format 'broken' of package other-brdf cannot be loaded")


class Grid(BrdfFormat):
    """A format without `at`: every 5 degrees of the three angles; the material is its theta_h."""

    format, names, paths = "grid", ("made up",), ()

    def __init__(self, hole: float | None = None) -> None:
        quarter, half = (torch.arange(0, end, math.radians(5), dtype=torch.float64) for end in (1.5, math.pi))
        self.pairs = Pairs.from_half_diff(*torch.cartesian_prod(quarter, quarter, half).T[:, None])
        self.weight = self.pairs.above_horizon
        if hole is not None:
            self.weight = self.weight & (self.pairs.theta_d > hole)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        return False

    @classmethod
    def open(cls, paths: object) -> "Grid":
        return cls()

    def read(self, materials: list[int], samples: torch.Tensor | slice) -> tuple[torch.Tensor, torch.Tensor]:
        weight = self.weight[:, samples, None].double()
        return self.pairs.theta_h[:, samples, None].expand(1, -1, 3) * weight, weight


def test_without_at_values_are_those_between_samples() -> None:
    measured = Measured(Grid(), dtype=torch.float64)
    wi, wo = hemisphere(200, seed=1), hemisphere(200, seed=2)
    pairs = Pairs.from_directions(wi, wo)
    low = torch.minimum(pairs.cos_i, pairs.cos_o) > 0.2
    found = measured.lookup(pairs)
    error = (found.values[0, :, 0] - pairs.theta_h).abs()
    assert found.filled.item() < 10  # where the nearest of the grid is below the horizon
    assert error[low].max() < math.radians(5)
    nearest = measured.at(pairs, "nearest")[0, :, 0]
    assert error[low].square().mean() < (nearest - pairs.theta_h)[low].square().mean()
    torch.testing.assert_close(measured.at(Pairs.from_directions(wo, wi)), found.values)  # by reciprocity
    assert measured.source.is_reciprocal
    below = Pairs.from_directions(wi, -wo)
    assert (measured.at(below) == 0).all()
    exact = measured.source.pairs.select(samples=[40, 700, 3000])
    torch.testing.assert_close(measured.at(exact)[..., 0], exact.theta_h * exact.above_horizon)
    assert measured.diffuse_45_0().tolist() == [[pytest.approx(1.0)] * 3]  # pi times about 22.5 degrees is more


def test_without_at_invalid_samples_are_passed_over_and_counted() -> None:
    measured = Measured(Grid(hole=0.5), dtype=torch.float64)
    angle = torch.tensor([[0.1, 0.2]], dtype=torch.float64)
    found = measured.lookup(Pairs.from_half_diff(angle, torch.tensor([[0.2, 0.9]]).double(), torch.zeros_like(angle)))
    torch.testing.assert_close(found.values[0, :, 0], angle[0], atol=math.radians(3), rtol=0)
    assert found.filled.tolist() == [1]
    with pytest.raises(DataError, match=r"^made up: expected valid samples, found none$"):
        Measured(Grid(hole=9.0)).diffuse_45_0()


def test_a_recipe_imports_what_lies_beside_it(tmp_path: Path) -> None:
    (tmp_path / "beside_the_recipe.py").write_text("WORD = 'beside'\n")
    recipe = tmp_path / "mine.py"
    recipe.write_text(
        "from dataclasses import dataclass\n"
        "from beside_the_recipe import WORD\n"
        "from torchbrdf.recipe import Recipe\n"
        "@dataclass(frozen=True)\n"
        "class Mine(Recipe):\n"
        "    name = 'mine'\n"
        "    word: str = WORD\n"
    )
    before = list(sys.path)
    assert find_recipe(str(recipe))().word == "beside"  # type: ignore[attr-defined]
    assert sys.path == before
    with pytest.raises(UsageError, match="no such file"):
        find_recipe(str(tmp_path / "none.py"))
