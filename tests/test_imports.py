"""What importing costs, and that what is named is there."""

import configparser
import functools
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

import torchbrdf
from torchbrdf import images

CHECKOUT = Path(__file__).resolve().parents[1]


@functools.cache
def loaded(*statements: str) -> frozenset[str]:
    """The top-level modules in memory after some statements in a fresh interpreter."""
    code = "; ".join([*statements, "import json, sys", "print(json.dumps(sorted(sys.modules)))"])
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return frozenset(name.split(".")[0] for name in json.loads(done.stdout))


def test_the_package_alone_costs_nothing() -> None:
    extra = loaded("import torchbrdf") - loaded("pass") - set(sys.stdlib_module_names)
    assert extra == {"torchbrdf"}


def test_losses_cost_no_more_than_torch() -> None:
    """Also when every loss is looked up by name."""
    extra = loaded("from torchbrdf.losses import LOSSES", "list(LOSSES)") - loaded("import torch")
    assert extra - set(sys.stdlib_module_names) == {"torchbrdf"}


def test_losses_and_lobes_pull_in_nothing_heavy() -> None:
    heavy = {"kornia", "matplotlib", "scipy", "pyrender", "trimesh", "OpenEXR", "PIL", "jinja2", "tqdm"}
    extra = loaded("import torchbrdf.losses, torchbrdf.lobes") - loaded("import torch")
    assert not extra & heavy


def test_formats_pull_in_no_scipy() -> None:
    assert "scipy" not in loaded("import torchbrdf.measured, torchbrdf.measured.load")


def test_a_fit_and_a_picture_pull_in_nothing_that_they_do_not_need() -> None:
    fitted = (
        "import torch",
        "from torchbrdf import fit, load",
        "from torchbrdf.lobes import make_model",
        "from torchbrdf.losses import RMSLoss",
        "from torchbrdf.measured import standins",
        "some = load(standins()).batch([0], torch.arange(0, 1_000_000, 997))",
        "fit(make_model('ward'), some, RMSLoss())",
    )
    drawn = ("from torchbrdf.render import Scene, blob, render", "render(some, Scene(blob(), size=8, nodes=8))")
    heavy = {"sympy", "trimesh", "networkx", "matplotlib", "jinja2"}
    assert not loaded(*fitted, *drawn) & heavy


@pytest.mark.parametrize("name", torchbrdf.__all__)
def test_every_public_name_is_there(name: str) -> None:
    thing = getattr(torchbrdf, name)
    assert thing is getattr(importlib.import_module(f"torchbrdf.{torchbrdf._HOME[name]}"), name)


def test_public_names_are_those_with_a_home() -> None:
    assert sorted(torchbrdf._HOME) == torchbrdf.__all__
    # Importing a room puts it into the package under its name, in the place of anything lazy.
    assert not set(torchbrdf._HOME) & set(torchbrdf._HOME.values())
    with pytest.raises(AttributeError, match=r"^module 'torchbrdf' has no attribute 'nothing'$"):
        torchbrdf.nothing  # noqa: B018


def test_exports_are_shown_before_they_are_used() -> None:
    """What an editor or a notebook completes, in a process that has used nothing yet."""
    code = "import torchbrdf, sys; print(sorted(set(torchbrdf.__all__) - set(dir(torchbrdf))), 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "False"]


def test_every_export_of_images_is_there_and_shown() -> None:
    assert set(images.__all__) <= set(dir(images))
    assert set(images._HOME) <= set(images.__all__)
    for name in images.__all__:
        assert getattr(images, name) is not None
    with pytest.raises(AttributeError, match=r"^module 'torchbrdf.images' has no attribute 'nothing'$"):
        images.nothing  # noqa: B018


LAZY = ("experiment", "experiment.matching", "fitting", "perception", "psychophysics", "report")


@pytest.mark.parametrize("room", LAZY)
def test_every_export_of_a_room_that_imports_at_first_use_is_there_and_shown(room: str) -> None:
    package = importlib.import_module(f"torchbrdf.{room}")
    assert set(package._HOME) <= set(package.__all__) <= set(dir(package))
    for name in package.__all__:
        assert getattr(package, name) is not None
    with pytest.raises(AttributeError, match=rf"^module 'torchbrdf.{room}' has no attribute 'nothing'$"):
        package.nothing  # noqa: B018


@pytest.mark.parametrize(
    "room", ["kinds", "recipe", "recipes.fores2012", "experiment.settings", "memory", "cli.commands"]
)
def test_what_names_and_settings_are_checked_by_costs_no_torch(room: str) -> None:
    heavy = {"torch", "numpy", "scipy", "matplotlib", "kornia", "PIL", "trimesh", "jinja2", "OpenEXR", "msgspec"}
    assert not loaded(f"import torchbrdf.{room}") & heavy


@pytest.mark.parametrize("module", ["assets", "recipes", "cli"])
def test_the_installed_parts_are_importable(module: str) -> None:
    importlib.import_module(f"torchbrdf.{module}")


def test_the_folders_at_the_top_level_are_packages_of_torchbrdf() -> None:
    for name in ("assets", "recipes"):
        assert (CHECKOUT / "torchbrdf" / name).resolve() == CHECKOUT / name


def test_constraints_pin_every_requirement() -> None:
    config = configparser.ConfigParser()
    config.read(CHECKOUT / "setup.cfg")
    wanted = config["options"]["install_requires"] + config["options.extras_require"]["test"]
    names = {line.split(">=")[0].lower() for line in wanted.split()}
    lines = (CHECKOUT / "constraints.txt").read_text().splitlines()
    pins = dict(line.lower().split("==") for line in lines if line and not line.startswith("#"))
    assert names <= set(pins)
