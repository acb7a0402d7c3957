"""Fits: recovery of known parameters, the paper's procedure, statuses, files."""

import copy
import csv
import json
import math

import pytest
import torch
from helpers.known_models import assert_within_bounds, measured_from, some_pairs

from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.fitting import Status, fit, local_minima, score, stratified, write_fits_csv
from torchbrdf.lobes import (
    AshikhminShirley,
    CookTorrance,
    FitRecord,
    Lambert,
    Sum,
    Ward,
    make_model,
    model_of,
    parameters,
    read_fits,
    write_fits,
)
from torchbrdf.losses import LOSSES, CosineRMSLoss, CubeRootLoss, LearnedLoss, RMSLoss
from torchbrdf.measured import load

TRUTHS = {
    "ward": Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=[0.2, 0.25, 0.3], roughness=0.08)),
    "cook_torrance": Sum(
        Lambert(albedo=[0.3, 0.2, 0.1]), CookTorrance(specular=[0.5, 0.45, 0.4], roughness=0.1, f0=0.4)
    ),
    "ashikhmin_shirley": Sum(
        Lambert(albedo=[0.3, 0.2, 0.1]), AshikhminShirley(specular=[0.5, 0.45, 0.4], exponent=300.0, f0=0.4)
    ),
}


@pytest.mark.parametrize("name", TRUTHS)
@pytest.mark.parametrize("loss", [RMSLoss(), CosineRMSLoss()], ids=["rms", "cosine_rms"])
def test_staged_recovers_a_material_that_the_model_made(name, loss):
    truth = TRUTHS[name].to(torch.float64)
    gray = copy.deepcopy(truth)
    gray.components()[1].specular.data[:] = truth.components()[
        1
    ].specular.data.mean()  # a scalar albedo is right in stage one
    result = fit(make_model(name, 1), measured_from(gray), loss, samples=None)
    assert result.status == [Status.CONVERGED]
    values = measured_from(gray).values
    assert result.error.item() < 1e-3 * loss(torch.zeros_like(values), values, some_pairs())
    found, wanted = result.model.components()[1], gray.components()[1]
    for parameter in type(wanted).parameter_specs:
        if parameter in ("roughness", "exponent"):
            torch.testing.assert_close(getattr(found, parameter)[0], getattr(wanted, parameter), rtol=0.01, atol=0)


def test_two_lobes_are_at_least_as_good_as_one():
    truth = Sum(Lambert(albedo=0.2), Ward(specular=0.3, roughness=0.05), Ward(specular=0.2, roughness=0.3)).double()
    measured = measured_from(truth)
    one, two = (fit(make_model("ward", n), measured, CosineRMSLoss(), samples=None).error.item() for n in (1, 2))
    assert two <= one * (1 + 1e-6)


def test_the_stages_are_the_papers():
    result = fit(
        make_model("ward", 2), measured_from(TRUTHS["ward"].double()), CubeRootLoss(), strategy="staged", samples=500
    )
    assert [stage.name for stage in result.history] == [
        "1 lobe, scalar albedo",
        "2 lobes, scalar albedo",
        "RGB albedo, shapes held",
        "RGB albedo, shapes held, all samples",
    ]
    torch.testing.assert_close(
        result.model.components()[0].albedo.detach(), measured_from(TRUTHS["ward"].double()).diffuse_45_0()
    )
    assert result.samples == 500


def test_diffuse_fit_moves_the_diffuse_albedo():
    truth = Sum(Lambert(albedo=[0.5, 0.3, 0.1]), Ward(specular=0.3, roughness=0.3)).double()
    measured = measured_from(truth)
    held, free = (
        fit(make_model("ward", 1), measured, CosineRMSLoss(), diffuse=d, samples=None) for d in ("45:0", "fit")
    )
    assert free.error.item() < 0.01 * held.error.item()
    torch.testing.assert_close(free.model.components()[0].albedo[0], truth.components()[0].albedo, atol=1e-3, rtol=0)


class FreeLoss(RMSLoss):
    """One whose fits look better with the diffuse albedo free."""

    default_diffuse = "fit"


@pytest.mark.parametrize(
    ("loss", "expected"),
    [(RMSLoss(), "45:0"), (FreeLoss(), "fit"), (LearnedLoss(), "fit")],
    ids=["held", "free", "learned"],
)
def test_a_fit_that_is_not_told_treats_the_diffuse_albedo_as_its_loss_has_it(loss, expected):
    measured = measured_from(TRUTHS["ward"].double())
    found, told = (
        fit(make_model("ward", 1), measured, loss, samples=None, **more) for more in ({}, {"diffuse": expected})
    )
    assert found.diffuse == expected
    assert torch.equal(found.model.components()[0].albedo, told.model.components()[0].albedo)
    other = {"fit": "45:0", "45:0": "fit"}[expected]
    assert fit(make_model("ward", 1), measured, loss, samples=None, diffuse=other).diffuse == other


def test_bounds_hold():
    truth = Sum(Lambert(albedo=0.2), Ward(specular=1.0, roughness=0.05)).double()
    truth.components()[1].specular.data[:] = 3.0
    result = fit(make_model("ward", 2), measured_from(truth), RMSLoss(), samples=None)
    assert_within_bounds(result.model)


def test_one_bad_material_is_reported_and_the_others_are_fitted():
    measured = measured_from(TRUTHS["ward"].double(), some_pairs(800), materials=3)
    measured.source.weight[1] = 0
    result = fit(make_model("ward", 1), measured, CosineRMSLoss(), samples=None)
    assert result.status[1] == Status.NO_DATA
    assert result.error[1].isnan()
    assert result.status[0] == result.status[2] == Status.CONVERGED
    for value in result.model.parameters():
        assert torch.equal(value[0], value[2])


def test_an_all_black_material_is_fitted_by_black():
    black = Sum(Lambert(albedo=0.0), Ward(specular=0.0)).double()
    result = fit(make_model("ward", 1), measured_from(black, some_pairs(500)), CosineRMSLoss(), samples=None)
    assert result.error.item() < 1e-6


def test_a_start_outside_its_bounds_is_refused():
    with pytest.raises(ShapeError, match=r"start of Ward.roughness: expected 0.001 to 0.5, found 2"):
        fit(Sum(Lambert(), Ward(roughness=2.0)), measured_from(TRUTHS["ward"].double()), RMSLoss())


@pytest.mark.parametrize("wrong", [{"strategy": "luck"}, {"diffuse": "60:0"}, {"samples": 0}])
def test_unknown_settings_are_refused(wrong):
    with pytest.raises(UsageError):
        fit(make_model("ward", 1), measured_from(TRUTHS["ward"].double()), RMSLoss(), **wrong)


def test_same_seed_same_result():
    measured = measured_from(TRUTHS["cook_torrance"].double())
    first, again, other = (
        fit(make_model("ward", 1), measured, CosineRMSLoss(), samples=400, seed=s) for s in (1, 1, 2)
    )
    roughness = [result.model.components()[1].roughness for result in (first, again, other)]
    assert torch.equal(roughness[0], roughness[1]) and not torch.equal(roughness[0], roughness[2])


def test_a_stratified_subset_is_spread_and_unbiased():
    counts = torch.zeros(97)
    for seed in range(4000):
        index = stratified(97, 10, seed)
        assert (index[1:] >= index[:-1]).all() and index.max() < 97
        counts[index] += 1
    expected = 4000 * 10 / 97
    assert (counts - expected).abs().max() < 5 * math.sqrt(expected)
    assert stratified(97, None, 0) is None and stratified(97, 97, 0) is None


def test_scores_are_the_losses_on_all_pairs():
    truth, model = TRUTHS["ward"].double(), TRUTHS["cook_torrance"].double()
    measured = measured_from(truth)
    losses = [LOSSES[name](reduction="none") for name in LOSSES]
    found = score(model.batched(1), measured, losses)
    for k, loss in enumerate(losses):
        torch.testing.assert_close(found[k], loss(model(measured.pairs), measured.values, measured.pairs).detach())


def test_what_a_strategy_gives_back_and_seeds_are_checked():
    measured = measured_from(TRUTHS["ward"].double())
    with pytest.raises(UsageError, match="strategy lost: expected an Outcome from it, found dict"):
        fit(make_model("ward", 1), measured, RMSLoss(), strategy=lost)
    with pytest.raises(UsageError, match="seed: expected an integer of 64 bits"):
        fit(make_model("ward", 1), measured, RMSLoss(), seed=10**30)


def lost(task, values, fit_diffuse):
    return values


def test_local_minima_are_found_by_the_papers_test():
    cross = torch.tensor([[[1.0], [0.5]], [[3.0], [2.0]]])  # [metric, fitted under, material]
    assert local_minima(cross).tolist() == [[True], [False]]
    assert not local_minima(cross, tolerance=0.6).any()


def test_a_result_survives_its_file(tmp_path):
    measured = measured_from(TRUTHS["ward"].double())
    result = fit(make_model("cook_torrance", 2), measured, CubeRootLoss(), samples=300)
    path = tmp_path / "fits.json"
    result.save(path)
    again = read_fits(path)
    assert again == result.records() and again[0].loss == "cube_root"
    for one, other in zip(model_of(again).parameters(), result.model.parameters(), strict=True):
        torch.testing.assert_close(one, other.float())
    (record,) = json.loads(path.read_text())
    wanted = ["material", "model", "lobes", "loss", "strategy", "error", "status", "seconds", "max_theta", "parameters"]
    assert set(wanted) <= set(record)
    assert len(record["parameters"]["diffuse"]) == 3
    assert [len(color) for color in record["parameters"]["specular"]] == [3, 3]
    assert len(record["parameters"]["roughness"]) == len(record["parameters"]["f0"]) == 2


def test_csv_is_flat(tmp_path):
    result = fit(make_model("ward", 2), measured_from(TRUTHS["ward"].double()), RMSLoss(), samples=300)
    write_fits_csv(tmp_path / "fits.csv", result.records())
    (row,) = csv.DictReader((tmp_path / "fits.csv").read_text().splitlines())
    assert float(row["roughness_1"]) == result.records()[0].parameters["roughness"][1]
    assert float(row["specular_0_2"]) == result.records()[0].parameters["specular"][0][2]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "expected a list of fits"),
        ("[]", "expected a list of fits"),
        ('[{"material": "x"}]', "fit 0 lacks model, lobes, parameters"),
    ],
)
def test_damaged_files_are_refused_in_a_line(tmp_path, text, said):
    path = tmp_path / "fits.json"
    path.write_text(text)
    with pytest.raises(DataError, match=said):
        read_fits(path)


def test_fits_stand_in_for_measurements(tmp_path):
    model = TRUTHS["cook_torrance"]
    write_fits(tmp_path / "fits.json", [FitRecord("paint", "cook_torrance", 1, parameters(model))])
    measured = load(tmp_path / "fits.json", dtype=torch.float64)
    assert measured.names == ["paint"] and measured.stand_in
    pairs = some_pairs(200)
    torch.testing.assert_close(measured.at(pairs), model.double()(pairs).detach(), rtol=1e-6, atol=0)
    part = measured.batch(samples=torch.tensor([5, 17]))
    torch.testing.assert_close(part.values, model.double()(part.pairs).detach(), rtol=1e-6, atol=0)
    again = fit(make_model("cook_torrance", 1), measured, CosineRMSLoss(), samples=2000)
    assert again.error.item() < 0.01
