"""Published fits beside ours: errors, settings, and the page."""

import csv
import json

import numpy as np
import pytest
import torch

from torchbrdf.errors import UsageError
from torchbrdf.experiment.published import Comparison
from torchbrdf.fitting import cross_score
from torchbrdf.lobes import Lambert, Sum, Ward, model_of, read_fits
from torchbrdf.losses import make_loss
from torchbrdf.measured import load, standins
from torchbrdf.measured.merl import CHANNEL_FACTORS
from torchbrdf.recipe import RECIPES, configure, run

DIFFUSE, SPECULAR, ROUGHNESS = [0.05, 0.04, 0.03], [0.2, 0.1, 0.05], 0.1
FEW = {"samples": "500", "max_theta": "30", "losses": "rms,cube_root"}


@pytest.fixture
def published(tmp_path):
    """A file of one set with two of the stand-ins and a material that nobody measured."""
    fit = {"model": "NganWard", "diffuse": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS}
    path = tmp_path / "published_fits.json"
    path.write_text(json.dumps({"ngan_ward": {"nickel": fit, "nylon": fit, "unobtainium": fit}}))
    return path


def test_errors_are_those_of_the_published_parameters(published, tmp_path):
    out = tmp_path / "out"
    settings = FEW | {"materials": "stand-ins", "fits": str(published)}
    report = run(configure(RECIPES["published_fits"], settings), out)
    with (out / "errors.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(r["material"], r["loss"]) for r in rows] == [
        ("nickel", "rms"), ("nylon", "rms"), ("nickel", "cube_root"), ("nylon", "cube_root"),
    ]  # fmt: skip
    scaled = [np.multiply(colour, CHANNEL_FACTORS).tolist() for colour in (DIFFUSE, SPECULAR)]
    model = Sum(Lambert(albedo=scaled[0]), Ward(specular=scaled[1], roughness=ROUGHNESS)).batched(2)
    measured = load(standins()).batch([6, 7]).within(30)
    wanted = cross_score([model], measured, [make_loss("rms"), make_loss("cube_root")])[:, 0]
    assert [float(r["published"]) for r in rows] == pytest.approx(wanted.flatten().tolist(), rel=1e-4)
    assert all(float(r["ours"]) <= float(r["published"]) for r in rows)
    assert {fit.material for fit in read_fits(out / "fits.json")} == {"nickel", "nylon"}
    page = report.read_text()
    assert "ngan_ward" in page and "2 of 2" in page and "Ngan" in page and "data:image/png" in page


def test_ratio_of_a_comparison():
    one = Comparison("set", "ward", "rms", ["a", "b"], np.array([2.0, 1.0]), np.array([1.0, 2.0]))
    assert one.ratio.tolist() == [2.0, 0.5]
    assert one.rows()[1] == {
        "set": "set", "model": "ward", "loss": "rms", "material": "b", "published": 1.0, "ours": 2.0,
    }  # fmt: skip


def test_fits_of_some_materials_and_pairs(published, tmp_path):
    """All that were published are scored; medians beside ours are of the materials that we fitted."""
    settings = FEW | {"materials": "stand-ins", "fits": str(published), "fitted": "1", "every": "7"}
    report = run(configure(RECIPES["published_fits"], settings), tmp_path / "out")
    with (tmp_path / "out" / "errors.csv").open() as file:
        rows = {(r["material"], r["loss"]): r for r in csv.DictReader(file)}
    own = {("nickel", fit.loss): fit.error for fit in read_fits(tmp_path / "out" / "fits.json")}
    assert len(rows) == 4 and len(own) == 2
    for key, row in rows.items():
        assert row["ours"] == "" if key not in own else float(row["ours"]) == pytest.approx(own[key])
    thinned = load(standins()).batch([6])
    thinned = thinned.batch(samples=torch.arange(0, len(thinned.pairs), 7)).within(30)
    wanted = cross_score([model_of([read_fits(tmp_path / "out" / "fits.json")[0]])], thinned, [make_loss("rms")]).item()
    assert own["nickel", "rms"] == pytest.approx(wanted, rel=1e-5)
    assert "1 of 1" in report.read_text() and "nan" not in report.read_text().split("By set")[1].split("<details")[0]


def test_medians_are_of_what_was_fitted():
    one = Comparison("set", "ward", "rms", ["a", "b"], np.array([2.0, 1.0]), np.array([np.nan, 0.5]))
    assert one.ratio.tolist() == [2.0] and one.fitted.tolist() == [False, True]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({}, "materials: expected a folder"),
        ({"materials": "stand-ins", "sets": "nope"}, "sets: expected some of ngan_ward, found 'nope'"),
        ({"materials": "stand-ins", "models": "ggx"}, "models: expected some of ward"),
        ({"materials": "stand-ins", "losses": "nope"}, "unknown loss 'nope'"),
        ({"materials": "stand-ins", "fitted": "-1"}, "fitted: expected"),
        ({"materials": "stand-ins", "every": "0"}, "every: expected"),
    ],
)
def test_settings_that_cannot_be(settings, said, published, tmp_path):
    with pytest.raises(UsageError, match=said):
        run(configure(RECIPES["published_fits"], {"fits": str(published)} | settings), tmp_path / "out")


def test_materials_that_nobody_fitted(tmp_path):
    fit = {"model": "NganWard", "diffuse": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS}
    path = tmp_path / "published_fits.json"
    path.write_text(json.dumps({"ngan_ward": {"unobtainium": fit}}))
    settings = FEW | {"materials": "stand-ins", "fits": str(path)}
    with pytest.raises(UsageError, match="expected some of those that were fitted, such as 'unobtainium', found 'alum"):
        run(configure(RECIPES["published_fits"], settings), tmp_path / "out")
