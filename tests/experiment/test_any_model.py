"""Grids of fits take every model by name: mixed ones, whole materials, and lobes that share a parameter."""

import math
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.experiment.grid import FitGrid
from torchbrdf.lobes import GGX, LOBES, BoundedParameter, Lobe, albedo
from torchbrdf.lobes.separable import columns
from torchbrdf.losses import CompressedLoss
from torchbrdf.measured import load, standins
from torchbrdf.pairs import Pairs
from torchbrdf.recipe import RECIPES, RunFolder, configure


class Whole(Lobe):
    """A body and a gloss."""

    is_material: ClassVar[bool] = True
    body: BoundedParameter = albedo(start=0.5, doc="albedo")
    roughness: BoundedParameter = BoundedParameter(start=0.2, lower=0.01, upper=1.0, log=True, doc="of the gloss")

    @classmethod
    def terms(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        gloss = GGX.unit_response(pairs, *scalars, torch.full_like(scalars[0], 0.04))
        return [torch.full_like(pairs.cos_i, 1 / math.pi), gloss]

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        return columns(parameters["body"], parameters["body"].new_ones(1))


def test_a_grid_of_models_of_all_sorts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    list(LOBES)
    monkeypatch.setitem(LOBES._things, "whole", Whole)
    models = ["whole", "eon+ggx", "ggx:f0"]
    grid = FitGrid(
        RunFolder(tmp_path),
        [load(standins()).batch([7])],
        models,
        {"compressed": CompressedLoss()},
        lobes=(2, 3),
        compare_strategy="staged",
        max_theta=20.0,
        samples=200,
    )
    grid.fit()
    assert [(one.model, one.lobes, one.diffuse) for one in grid.shown] == [
        ("whole", 1, "fit"),
        ("eon+ggx", 1, "fit"),
        ("ggx:f0", 2, "45:0"),
    ]
    assert len(grid.records) == 3 + 1 + 3
    assert all(math.isfinite(record.error) for record in grid.records)
    again = FitGrid(grid.folder, grid.groups, models, grid.losses, lobes=(2, 3), max_theta=20.0, samples=200)
    again.fit()
    assert again.records == grid.records


def every_model() -> list[str]:
    """All lobes and whole materials without a grain, as materials have none, and every diffuse term with a lobe."""
    isotropic = {name: kind for name, kind in LOBES.items() if not kind.is_anisotropic}
    return [name if not kind.is_diffuse else f"{name}+ward" for name, kind in isotropic.items()]


def test_a_grid_of_every_model(tmp_path: Path) -> None:
    few = load(standins()).batch([7], samples=torch.arange(0, 1_000_000, 7_919))
    losses = {"compressed": CompressedLoss()}
    grid = FitGrid(RunFolder(tmp_path), [few], every_model(), losses, lobes=(1,))
    grid.fit()
    assert [record.model for record in grid.shown] == every_model()
    assert all(math.isfinite(record.error) for record in grid.shown)


@pytest.mark.parametrize("recipe", ["fores2012", "image_vs_analytic"])
def test_recipes_take_every_model(recipe: str) -> None:
    assert configure(RECIPES[recipe], {"models": ",".join(every_model())}).models == tuple(every_model())


def test_a_grid_refuses_what_is_no_model(tmp_path: Path) -> None:
    for name in ("lambert", "ggx+nothing", "ward:f0"):
        with pytest.raises(UsageError):
            FitGrid(RunFolder(tmp_path), [load(standins()).batch([7])], [name], {"compressed": CompressedLoss()})
