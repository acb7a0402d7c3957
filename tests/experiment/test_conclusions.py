"""Conclusions from answers: the paper's claims, confusions, and scales that find what observers saw."""

import math

import pytest
from helpers.simulated_plan import make_plan, wards
from scipy.stats import spearmanr

from torchbrdf.experiment.conclusions import benefits, check_claims, confused
from torchbrdf.experiment.scaling import scale_experiments
from torchbrdf.study import MEASURED, simulate


def scaled_of(plan, observers=30, noise=2.0):
    (scaled,) = scale_experiments(simulate(plan, plan.experiment("1"), observers, noise), plan)
    return scaled


def test_the_papers_claim_is_said_as_it_comes_out():
    angles = [0.5, 1.0, 3.0, 6.0, 12.0]
    falls = make_plan({f"m{k}": wards(12.0 - 2 * k, 5.0, 2.0) for k in range(5)}, angles)
    scaled = scaled_of(falls, observers=60, noise=4.0)
    overall, by_gloss, *_ = check_claims(scaled.scales, falls)
    assert "Of 5 materials and models it is better for 5, worse for 0" in overall and "holds everywhere" in overall
    assert ": supported by these answers" in by_gloss
    found = {one.material: one.value for one in benefits(scaled.scales, falls, "cube_root", "rms")}
    expected = spearmanr(angles, [found[f"m{k}"] for k in range(5)], alternative="less")
    assert f"is {expected.statistic:.2f} (one-sided p = {expected.pvalue:.2g})" in by_gloss

    rises = make_plan({f"m{k}": wards(4.0 + 2 * k, 5.0, 2.0) for k in range(5)}, angles)
    assert "not supported by these answers" in check_claims(scaled_of(rises).scales, rises)[1]

    worse = make_plan({f"m{k}": wards(2.0, 5.0, 6.0) for k in range(2)})
    overall, *_ = check_claims(scaled_of(worse).scales, worse)
    assert "worse for 2" in overall and "does not hold for 2 of them (m0 Ward, m1 Ward)" in overall


def test_answers_about_something_else_claim_nothing():
    plan = make_plan({"nickel": {"ward-log": 3.0, "ward-rms": 4.0, MEASURED: 0.0}})
    assert check_claims(scaled_of(plan).scales, plan) == []


def test_what_observers_cannot_tell_from_the_measured_material_is_confused_with_it():
    plan = make_plan({"nickel": {"ward-cube_root": 0.0, "cook-cube_root": 9.0, MEASURED: 0.0}})
    assert confused(scaled_of(plan).scales) == {"nickel": {"ward-cube_root"}}
    better = make_plan({"nickel": {"ward-cube_root": 0.0, "cook-cube_root": 9.0, MEASURED: 5.0}})
    assert "ward-cube_root" in confused(scaled_of(better).scales)["nickel"]


def test_scales_find_what_simulated_observers_see():
    plan = make_plan({"nickel": wards(5.0, 4.0, 3.0), "nylon": wards(2.0, 2.0, 2.0)})
    scaled = scaled_of(plan, observers=2000)
    unit = math.sqrt(2) * 2.0
    known = {(record["material"], record["stimulus"]): record["scale"] for record in scaled.scales.records()}
    for k, name in enumerate(("ward-rms", "ward-cosine_rms", "ward-cube_root")):
        assert known["nickel", name] == pytest.approx((k - 1) / unit, abs=0.05)
        assert known["nylon", name] == pytest.approx(0, abs=0.05)
