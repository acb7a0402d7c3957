"""Fits of texels: as good as the truth, the same however they are asked for, and a status where there can be none."""

import numpy as np
import pytest
import torch

from torchbrdf import Pairs
from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.fitting.objective import make_objective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.lobes import make_model
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.losses import CosineRMSLoss, make_loss
from torchbrdf.texels import SyntheticSurface, TexelMaps, TexelStatus, dome, fit_texels
from torchbrdf.texels.problem import Reading, texel_problem
from torchbrdf.texels.smoothing import Pulled
from torchbrdf.texels.stack import Stack
from torchbrdf.texels.tiling import Tile, Tiling


def fitted(scene, stack=None, **options):
    stack = scene.stack if stack is None else stack
    return fit_texels(stack, scene.lights, **{"normals": scene.surface.normals, "tile": 16, **options})


@pytest.fixture(scope="module")
def maps(scene):
    return fitted(scene)


def test_errors_are_those_of_the_true_parameters_or_less(scene, maps):
    ratio = maps["error"][..., 0] / scene.true_errors
    assert (ratio <= 1.01).mean() >= 0.99 and ratio.max() < 1.2
    assert maps.counts()["CONVERGED"] >= 250


def test_without_noise_the_maps_are_the_truth(scene):
    clear = scene.surface.camera(scene.lights).without_noise(slice(0, 16), slice(0, 16))
    found = fitted(scene, clear)
    for name, most in (("albedo", 0.01), ("reflectance", 0.03), ("roughness", 0.01)):
        off = np.abs(found[name] / scene.surface.maps[name] - 1)
        assert np.quantile(off, 0.9) < most, (name, np.quantile(off, 0.9))


def test_the_error_is_that_of_the_loss(scene, maps):
    rows, columns = slice(3, 7), slice(2, 9)
    data = Stack(scene.stack, scene.lights, (0, 0, 1), scene.surface.normals, None, None).read(
        Tile(0, 0, rows, columns)
    )
    reading = Reading(np.ones((24, 3), np.float32), None, None, 80.0)
    problem = texel_problem(data, reading).problem
    prediction = maps.model_of(rows, columns)(problem.pairs)
    error = CosineRMSLoss().error(prediction, problem.target, problem.pairs, problem.weight)
    np.testing.assert_allclose(maps.region("error", rows, columns).ravel(), error.detach().numpy(), rtol=1e-4)


@pytest.mark.parametrize("kind", ["tensor", "function", "memory-mapped", "directions of each texel", "half", "scaled"])
def test_the_same_however_the_stack_is_given(scene, maps, kind, tmp_path):
    stack, lights, options = scene.stack, scene.lights, {}
    if kind == "tensor":
        stack, lights = torch.from_numpy(stack), torch.from_numpy(lights)
    elif kind == "function":
        stack, options = lambda rows, columns: scene.stack[:, rows, columns], {"size": (16, 16)}
    elif kind == "memory-mapped":
        np.save(tmp_path / "stack.npy", stack)
        stack = np.load(tmp_path / "stack.npy", mmap_mode="r")
    elif kind == "directions of each texel":
        lights = np.broadcast_to(lights[:, None, None], (24, 16, 16, 3))
    elif kind == "half":
        stack = stack.astype(np.float16)
    else:
        stack, options, lights = stack * np.float32(4), {"irradiance": 4.0}, lights * 7
    found = fit_texels(stack, lights, normals=scene.surface.normals, tile=16, **options)
    off = np.abs(found["error"] / maps["error"] - 1)  # of rounding, in valleys that are flat
    assert np.quantile(off, 0.95) < (0.05 if kind == "half" else 1e-3) and off.max() < 0.2


def test_pairs_are_taken_as_they_are(scene):
    pairs = Pairs.from_directions(torch.from_numpy(scene.lights), torch.tensor([0.0, 0.0, 1.0]))
    by_pairs = fit_texels(scene.stack, pairs, tile=16)
    by_lights = fit_texels(scene.stack, scene.lights, tile=16)
    np.testing.assert_array_equal(by_pairs["error"], by_lights["error"])


def test_a_texel_depends_on_its_own_tile_alone(scene):
    whole = fitted(scene, tile=8)
    part = fit_texels(scene.stack[:, 8:, :8], scene.lights, normals=scene.surface.normals[8:, :8], tile=8)
    for name in whole.names:
        np.testing.assert_array_equal(whole[name][8:, :8], part[name])


def test_saturated_texels_say_so_and_the_others_are_done(scene, maps):
    stack = scene.stack.copy()
    stack[:, 3:5, 4:9] = 5.0
    found = fitted(scene, stack, saturation=1.0)
    status = found["status"][..., 0]
    assert (status[3:5, 4:9] == TexelStatus.SATURATED).all()
    assert np.isnan(found["albedo"][3:5, 4:9]).all() and np.isnan(found["error"][3:5, 4:9]).all()
    others = np.ones((16, 16), bool)
    others[3:5, 4:9] = False
    assert (found["error"][others] <= 1.1 * maps["error"][others]).mean() > 0.99


def test_what_is_not_finite_or_has_no_normal_does_not_count(scene):
    stack, normals = scene.stack.copy(), scene.surface.normals.copy()
    stack[:, 0, 0] = np.nan
    stack[3] = np.inf
    normals[1, 1], normals[1, 2] = 0.0, np.nan
    found = fitted(scene, stack, normals=normals)
    status = found["status"][..., 0]
    assert status[0, 0] == status[1, 1] == status[1, 2] == TexelStatus.NO_DATA
    assert np.isfinite(found["albedo"][2:]).all()
    few = fit_texels(scene.stack[:2], scene.lights[:2], tile=16)
    assert few.counts() == {"TOO_FEW_SAMPLES": 256}


def test_values_in_shadow_do_not_count(scene, maps):
    stack = scene.stack.copy()
    stack[:8] = 0.0005
    weights = np.where(np.arange(24) < 8, 0.0, 1.0)[:, None, None] * np.ones((16, 16))
    for options in ({"shadow": 0.002}, {"weights": weights}):
        found = fitted(scene, stack, **options)
        assert 0.8 < np.median(found["error"]) / np.median(maps["error"]) < 1.1
        assert np.median(np.abs(found["albedo"] / scene.surface.maps["albedo"] - 1)) < 0.15


def test_held_parameters_stay(scene):
    model = make_model("ggx", 1)
    model.lobes[1].f0 = 0.5
    found = fitted(scene, model=model, held=("f0",))
    assert (found["f0"] == 0.5).all() and found["specular"].std() > 0
    np.testing.assert_allclose(found["reflectance"], found["specular"] * 0.5)


def test_a_shared_parameter_is_held_by_any_of_its_names(scene):
    model = make_model("ggx:f0", 2)
    for lobe in model.components()[1:]:
        lobe.f0 = 0.25
    found = fit_texels(scene.stack[:, :8, :8], scene.lights, model=model, held=("f0_2",), tile=8, max_iterations=10)
    assert (found["f0_1"] == 0.25).all() and (found["f0_2"] == 0.25).all()
    assert {"reflectance_1", "reflectance_2"} < set(found.names)


@pytest.mark.parametrize(("model", "loss"), [("ward", "cosine_rms"), ("ggx", "cube_root"), ("gltf", "cosine_rms")])
def test_other_models_and_losses(scene, model, loss):
    own = {"model": make_model(model, 1), "loss": make_loss(loss), "max_iterations": 30}
    found = fit_texels(scene.stack[:, :8, :8], scene.lights, normals=scene.surface.normals[:8, :8], tile=8, **own)
    assert found.counts()["CONVERGED"] > 40 and np.isfinite(found["error"]).all()


def test_smooth_maps_are_smoother_and_no_seam_is_between_tiles():
    stone = {"albedo": [0.4, 0.3, 0.2], "specular": [0.9] * 3, "roughness": [0.5], "f0": [0.04]}
    whole = {name: np.full((12, 12, len(value)), value, np.float32) for name, value in stone.items()}
    up, lights = np.full((12, 12, 3), (0, 0, 1), np.float32), dome(24)
    stack = SyntheticSurface(TexelMaps.of_arrays(make_model("ggx", 1), whole), up).stack(lights)
    rough, smooth, cut = (
        fit_texels(stack, lights, smoothness=smoothness, tile=tile)
        for smoothness, tile in ((0.0, 16), (1e-3, 16), (1e-3, 8))
    )
    spread = [np.log(one["roughness"]).std() for one in (rough, smooth)]
    assert spread[1] < 0.4 * spread[0]
    assert (smooth["error"] >= 0.999 * rough["error"]).all()
    steps = np.abs(np.diff(np.log(cut["roughness"][..., 0]), axis=1)).mean(0)
    assert steps[7] < 3 * np.median(steps)  # between the tiles


def test_the_pull_has_the_derivatives_of_its_value(scene):
    model = make_model("ggx", 1, dtype=torch.float64).batched(4)
    data = Stack(scene.stack, scene.lights, (0, 0, 1), None, None, None).read(Tile(0, 0, slice(0, 2), slice(0, 2)))
    own = texel_problem(data, Reading(np.ones((24, 3), np.float32), None, None, 80.0)).problem
    own = type(own)(own.pairs.to(dtype=torch.float64), own.target.double(), own.weight.double())
    free = Parametrization(model, free_parameters(model, [0, 1]))
    bound = make_objective(model, own, CosineRMSLoss()).bind(free, get_parameters(model))
    x = free.encode(get_parameters(model))
    pulled = Pulled(bound, x + 0.3, torch.full((4,), 0.7, dtype=torch.float64), torch.ones(x.shape[1]).double())
    rows, step = torch.arange(4), 1e-6
    _, gradient, _ = pulled.quadratic_model(x, rows)
    for k in range(x.shape[1]):
        off = torch.zeros_like(x)
        off[:, k] = step
        high, low = (pulled.quadratic_model(x + sign * off, rows)[0] for sign in (1, -1))
        torch.testing.assert_close(gradient[:, k], (high - low) / (2 * step), rtol=1e-4, atol=1e-6)


NOT = "expected directions above the horizon"


@pytest.mark.parametrize(
    ("change", "kind", "said"),
    [
        ({"observations": lambda s: s.stack[..., 0]}, ShapeError, r"observations: expected \(24, H, W, 3\).*found"),
        ({"observations": lambda s: s.stack[:5]}, ShapeError, r"observations: .*found \(5, 16, 16, 3\)"),
        ({"observations": lambda s: s.stack[:, :0]}, ShapeError, "observations: expected"),
        ({"lights": lambda s: s.lights[:, :2]}, ShapeError, r"lights: expected \(24, 3\).*found \(24, 2\)"),
        ({"lights": lambda s: s.lights * 0}, ShapeError, r"lights\[0\]: expected a direction, found"),
        ({"lights": lambda s: s.lights * np.nan}, ShapeError, r"lights\[0\]: expected a direction, found"),
        ({"lights": lambda s: -s.lights}, DataError, f"lights: {NOT}, z > 0, found 24 of 24 below"),
        ({"lights": lambda s: "abc"}, ShapeError, "expected an array of numbers"),
        ({"views": lambda s: (0, 0, -1)}, DataError, f"views: {NOT}"),
        ({"normals": lambda s: s.surface.normals[:5]}, ShapeError, r"normals: expected \(16, 16, 3\), found"),
        ({"weights": lambda s: np.ones((24, 16))}, ShapeError, "weights: expected"),
        ({"irradiance": lambda s: [1, 2]}, ShapeError, "irradiance: expected a number"),
        ({"irradiance": lambda s: 0}, ShapeError, "irradiance: expected finite numbers above 0"),
        ({"held": lambda s: ("depth",)}, UsageError, "held: expected some of albedo, specular"),
        ({"smoothness": lambda s: -1}, UsageError, "smoothness: expected a number from 0"),
        ({"tile": lambda s: 0}, UsageError, "tile: expected 8 to 512"),
        ({"max_theta": lambda s: 0}, UsageError, "max_theta: expected an angle"),
        ({"formats": lambda s: ("tif",)}, UsageError, "formats: expected some of exr, png, zarr, found 'tif'"),
        ({"loss": lambda s: make_loss("learned")}, UsageError, "loss: expected a mean over pairs"),
        ({"model": lambda s: make_model("distribution_based", 1)}, UsageError, "model: expected lobes that are"),
        ({"model": lambda s: make_model("ggx", 1).batched(3)}, ShapeError, "model: expected parameters of one"),
        ({"observations": lambda s: lambda rows, columns: 0}, ShapeError, r"size: expected \(H, W\)"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(scene, change, kind, said):
    own = {"observations": scene.stack, "lights": scene.lights} | {name: make(scene) for name, make in change.items()}
    with pytest.raises(kind, match=said) as found:
        fit_texels(own.pop("observations"), own.pop("lights"), **own)
    assert len(str(found.value)) <= 300 and "\n" not in str(found.value)


def test_lights_below_the_horizon_do_not_count(scene, caplog):
    lights = scene.lights.copy()
    lights[:3, 2] *= -1
    found = fit_texels(scene.stack, lights, tile=16)
    assert "lights: expected directions above the horizon, z > 0, found 3 of 24 below" in caplog.text
    assert found.counts()["CONVERGED"] > 240


def test_a_tile_that_cannot_be_read_is_said_and_the_others_are_done(scene, caplog):
    def damaged(rows, columns):
        if rows.start >= 8 and columns.start < 8:
            raise OSError("disk on fire\n")
        return scene.stack[:, rows, columns]

    found = fitted(scene, damaged, size=(16, 16), tile=8)
    assert found.counts()["FAILED"] == 64 and "disk on fire" in caplog.text
    assert (found["status"][8:, :8] == TexelStatus.FAILED).all() and np.isfinite(found["albedo"][:8]).all()
    assert list(found.failed) == ["00001-00000"]


def test_tiles_cover_a_surface_once():
    seen = np.zeros((20, 33), int)
    tiling = Tiling((20, 33), 8)
    for tile in tiling:
        seen[tile.rows, tile.columns] += 1
    assert (seen == 1).all() and len(list(tiling)) == len(tiling) == 15


def test_lights_that_come_again_and_again_are_fitted() -> None:
    # Half angles that many pairs share are laid out in groups, which no texels at all cannot be.
    lights = np.repeat(dome(6), 18, 0)
    seen = np.full((len(lights), 4, 4, 3), 0.3, np.float32) * lights[:, None, None, 2:]
    maps = fit_texels(seen, lights, model=make_model("ward", 1), max_iterations=2)
    assert np.isfinite(maps["albedo"]).all()


def test_a_model_by_name_is_refused() -> None:
    with pytest.raises(UsageError, match="model: expected a lobe or a sum of them, as make_model gives, found 'ward'"):
        fit_texels(np.zeros((6, 4, 4, 3), np.float32), dome(6), model="ward")
