"""Parameters do not depend on how materials are cut into batches; those that the error leaves open are said to be."""

import math

import numpy as np
import pytest
import torch
from helpers.tiny_materials import tiny_values

from torchbrdf import fit
from torchbrdf.fitting.determined import SMALL, working_dtype
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, make_model
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.losses import RMSLoss, make_loss
from torchbrdf.measured import Measured
from torchbrdf.measured.angles import direction
from torchbrdf.pairs import Pairs

COUNT = 4


def tiny(count=COUNT, pairs=200, dtype=torch.float32):
    angles, values = tiny_values(count, pairs)
    where = [torch.from_numpy(direction(angles[:, k], (k == 1) * angles[:, 2])).to(dtype) for k in (0, 1)]
    return Measured.from_samples(Pairs.from_directions(*where), torch.from_numpy(values).to(dtype), anisotropic=False)


def differences(whole, rows, part):
    """How far parameters that are determined in both are apart, of the same materials; and how many are not."""
    left, right = get_parameters(whole.model), get_parameters(part.model)
    worst, unsaid = 0.0, 0
    for name in left:
        for at, row in enumerate(rows):
            open_ = whole.undetermined[name][row] | part.undetermined[name][at]
            one, other = left[name][row].double(), right[name][at].double()
            apart = ((one - other).abs() / one.abs().clamp_min(1e-2))[~open_]
            worst = max([worst, *apart.flatten().tolist()])
            unsaid += int(open_.sum())
    return worst, unsaid


@pytest.mark.parametrize(
    ("model", "lobes", "loss"),
    [("ward", 1, "cube_root"), ("ward", 2, "cube_root"), ("ward", 2, "learned"), ("ggx", 1, "learned"),
     ("ward_duer", 1, "rms"), ("abc_smooth", 1, "cube_root")],
)  # fmt: skip
def test_what_is_determined_is_the_same_in_any_batch(model, lobes, loss):
    measured, every = tiny(), list(range(COUNT))

    def fitted(rows):
        return fit(make_model(model, lobes), measured.batch(rows), make_loss(loss), samples=None, diffuse="fit")

    whole = fitted(every)
    cuts = [[k] for k in every] + [every[: COUNT // 2], every[COUNT // 2 :], every[::-1]]
    found = [differences(whole, rows, fitted(rows)) for rows in cuts]
    assert max(worst for worst, _ in found) < 1e-4
    numbers = sum(value.numel() for value in get_parameters(whole.model).values())
    if lobes == 1:
        assert sum(count for _, count in found) < 0.1 * 4 * numbers  # most is determined


def test_results_have_the_dtype_of_the_values():
    for dtype, given_back in ((torch.float32, torch.float32), (torch.float64,) * 2, (torch.bfloat16, torch.float32)):
        result = fit(make_model("ward", 1), tiny(1).to(dtype=dtype), RMSLoss(), diffuse="fit")
        assert {value.dtype for value in get_parameters(result.model).values()} == {given_back}


def test_few_pairs_are_fitted_in_double_precision():
    assert working_dtype(tiny(1), RMSLoss()) == torch.float64
    assert working_dtype(tiny(1, SMALL + 1), RMSLoss()) == torch.float32
    assert working_dtype(tiny(1, SMALL + 1).to(dtype=torch.float16), RMSLoss()) == torch.float32


def made_by(model, pairs=300, noise=0.01):
    generator = torch.Generator().manual_seed(1)
    place = torch.rand(3, 1, pairs, dtype=torch.float64, generator=generator)
    where = Pairs.from_half_diff(place[0] ** 2 * 1.3, place[1] * 1.2, place[2] * math.pi)
    with torch.no_grad():
        values = model(where)
    values = values * (1 + noise * torch.randn(values.shape, dtype=torch.float64, generator=generator))
    return Measured.from_samples(where, values, names=["paint"])


def record(measured, lobes, loss="cube_root", **options):
    (found,) = fit(make_model("ward", lobes), measured, make_loss(loss), diffuse="fit", **options).records()
    return found


def test_a_lobe_that_is_there_is_determined():
    paint = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=[0.1] * 3, roughness=0.2)).double()
    found = record(made_by(paint), 1)
    assert found.undetermined == []
    assert "undetermined" not in found.to_json()


@pytest.mark.parametrize("loss", ["rms", "cube_root", "learned"])
def test_the_shape_of_a_lobe_that_is_not_there_is_open(loss):
    matte = Sum(Lambert(albedo=[0.3, 0.2, 0.1])).double()
    found = record(made_by(matte, noise=0.0), 1, loss)
    assert "roughness[0]" in found.undetermined
    assert FitRecord.from_json(found.to_json()) == found


def test_two_lobes_that_are_one_are_open():
    paint = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=[0.1] * 3, roughness=0.2)).double()
    found = record(made_by(paint, noise=0.0), 2)
    assert {"roughness[0]", "roughness[1]"} & {*found.undetermined}


def test_a_fit_that_is_at_no_minimum_determines_nothing():
    paint = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=[0.2, 0.1, 0.05], roughness=0.15)).double()
    assert record(made_by(paint), 1, "learned").undetermined == []
    found = record(made_by(paint), 1, "learned", strategy="staged")  # whose solver knows no cusps
    assert found.undetermined == ["diffuse", "specular[0]", "roughness[0]"]


def test_truths_are_those_of_numbers():
    result = fit(make_model("ward", 1), tiny(2), RMSLoss(), diffuse="fit")
    shapes = {name: tuple(value.shape) for name, value in result.undetermined.items()}
    assert shapes == {name: tuple(value.shape) for name, value in get_parameters(result.model).items()}
    assert np.array_equal([len(one.undetermined) for one in result.records()], [0, 0])


def test_where_there_is_no_curvature_nothing_is_said():
    from torchbrdf.render import RenderedLoss, Scene, sphere

    scene = Scene(sphere(2), size=16, nodes=8, light_samples=4)
    loss = RenderedLoss(scene, "ssim")
    result = fit(make_model("ward", 1), tiny(1), loss, max_iterations=2)
    assert result.undetermined == {}
    assert result.records()[0].undetermined == []
