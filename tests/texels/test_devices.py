"""Texels on a device: problems are made, and stepped, where it is, and everything else stays on the CPU."""

import numpy as np
import pytest
import torch

from torchbrdf.cli import main
from torchbrdf.errors import UsageError
from torchbrdf.fitting.objective.base import FitObjective
from torchbrdf.lobes import make_model
from torchbrdf.lobes.parameter_dict import take_materials
from torchbrdf.losses import CosineRMSLoss
from torchbrdf.texels import api, dome, fit_texels, solve, synthetic_surface
from torchbrdf.texels.problem import Reading, texel_problem
from torchbrdf.texels.smoothing import smoothed_fit
from torchbrdf.texels.stack import Stack
from torchbrdf.texels.tiling import Tile

COUNT = 16


def tile_fit(device):
    surface, lights = synthetic_surface(16), dome(COUNT)
    stack = Stack(surface.stack(lights), lights, (0.0, 0.0, 1.0), surface.normals, None, None)
    reading = Reading(np.ones((COUNT, 3), np.float32), None, None, 80.0, stack.pairs)
    fit = solve.TexelFit(make_model("ggx", 1), CosineRMSLoss(), reading, device=device)
    data = stack.read(Tile(0, 0, slice(0, 16), slice(0, 16)))
    return solve._TileFit(fit, texel_problem(data, reading), data.shape)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_steps_stay_on_the_device(dtype, monkeypatch):
    monkeypatch.setattr(FitObjective, "is_every_material", lambda *_: True)  # which asks for values
    tile = tile_fit("meta")
    rows = torch.arange(8, dtype=torch.int64)
    objective = tile._objective(rows, dtype)
    here = tile._there(take_materials(tile.values, rows))
    bound = objective.bind(tile.free, here)
    x = tile.free.encode(here)
    found = bound.quadratic_model(x, objective.material_indices)
    assert {one.device.type for one in (x, *found)} == {"meta"}
    assert {value.device.type for value in tile.values.values()} == {"cpu"}


def test_what_solvers_get_is_on_the_device_and_what_they_give_is_not(monkeypatch):
    """Every way of a tile, with solvers that note where they are asked to work."""
    places = []

    def noted(inner):
        def call(objective, values, *rest, **options):
            places.append({value.device.type for value in values.values()} | {objective.problem.target.device.type})
            return inner(objective, values, *rest, **options)

        return call

    monkeypatch.setattr(solve, "levenberg_marquardt_fit", noted(solve.levenberg_marquardt_fit))
    monkeypatch.setattr(solve, "smoothed_fit", noted(smoothed_fit))
    surface, lights = synthetic_surface(16), dome(COUNT)
    given = {"normals": surface.normals, "smoothness": 1e-3, "sweeps": 1, "max_iterations": 5}
    plain = fit_texels(surface.stack(lights), lights, **given)
    there = fit_texels(surface.stack(lights), lights, device="cpu", **given)
    assert len(places) >= 4 and all(found == {"cpu"} for found in places)
    for name in plain.names:
        np.testing.assert_array_equal(plain[name], there[name])


def test_tiles_of_a_device_stay_in_this_process(monkeypatch):
    surface, lights = synthetic_surface(16), dome(COUNT)
    monkeypatch.setattr(api, "process_map", None)
    made = []
    monkeypatch.setattr(
        solve.TexelFit,
        "__call__",
        lambda self, data: made.append(self.device) or {"error": np.zeros((*data.shape, 1), np.float32)},
    )
    fit_texels(surface.stack(lights), lights, normals=surface.normals, device="meta", tile=8)
    assert made == ["meta"] * 4


def test_batches_are_as_large_as_memory_allows():
    assert solve.batch_size("cpu", 64 * 3) == solve.BATCH
    assert solve.batch_size("cuda:1", 64 * 3) == solve.GPU_NUMBERS // (64 * 3)
    assert solve.batch_size("cuda", 10**9) == solve.BATCH


@pytest.mark.parametrize("device", ["cuda:77", "meta", "nonsense"])
def test_a_device_that_is_not_there_is_a_line(device, tmp_path, capsys):
    (tmp_path / "lights.csv").write_text("file,x,y,z\n0.exr,0,0,1\n")
    assert main(["texels", str(tmp_path / "lights.csv"), "--out", str(tmp_path / "out"), "--device", device]) == 2
    assert f"--device: expected one of cpu, found '{device}'" in capsys.readouterr().err


def test_a_device_that_is_none_is_refused():
    with pytest.raises(UsageError, match="device: expected one of torch's, such as cuda:0, found 'nonsense'"):
        fit_texels(np.zeros((6, 4, 4, 3), np.float32), dome(6), device="nonsense")
