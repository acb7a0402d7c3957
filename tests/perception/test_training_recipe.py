"""The recipe that trains a metric: its page, what it keeps, studies of one's own."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from torchbrdf.errors import DataError, UsageError
from torchbrdf.experiment.metric_training import read_training, study_data
from torchbrdf.lobes import make_model, write_fits
from torchbrdf.losses import LOSSES, LearnedLoss
from torchbrdf.measured import load, standins
from torchbrdf.perception import evaluate_brdfs, uniform_pairs
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
from torchbrdf.perception.learning.training import baseline_distances, train
from torchbrdf.perception.learning.training_set import make_training_set
from torchbrdf.reading import write_npz
from torchbrdf.recipe import RECIPES, configure, run


def recipe(**options: str):
    return configure(RECIPES["train_metric"], options)


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("metric") / "out"
    run(recipe(quick="true"), folder)
    return folder


def test_the_recipe_writes_a_metric_that_gives_the_shares_it_says(out: Path) -> None:
    metric = json.loads((out / "metric.json").read_text())
    loss = LearnedLoss(reduction="none", weights=out / "metric.json")
    data = synthetic_benchmark(seed=0)
    seen = evaluate_brdfs(data, uniform_pairs(500).to(dtype=torch.float32))
    training_set = make_training_set(data, seen)
    distance = baseline_distances(training_set, seen, {"learned": loss})["learned"]
    for name, own in training_set.statistics.items():
        share = float(own.agreement_rate(own.concordant(distance[None])))
        assert share == pytest.approx(metric["provenance"]["seen"][name], abs=0.01)  # weights have four digits
    assert metric["provenance"]["learned_from"][0]["mark"] == "made-up answers: nobody was asked"


def test_synthetic_answers_are_foretold(out: Path) -> None:
    table = json.loads((out / "held_out.json").read_text())
    assert set(table) == {"materials", "materials_and_method", "materials_and_two_methods"}
    for name, own in table["materials"].items():
        assert 0 <= own["learned"]["share"][1] <= own["learned"]["share"][0] <= own["learned"]["share"][2] <= 1, name
        assert set(own) == {"learned", *(set(LOSSES) - {"learned"})}


def test_the_page_says_that_nobody_was_asked(out: Path) -> None:
    page = (out / "report.html").read_text()
    for words in ("made-up answers: nobody was asked", "never saw", "pointwise", "data:image/png"):
        assert words in page
    assert "http://" not in page and "https://" not in page


def test_trainings_are_taken_up(out: Path, monkeypatch) -> None:
    before = (out / "metric.json").read_text()
    kept = sorted((out / "trainings").iterdir())
    kept[0].unlink()
    trained = []
    monkeypatch.setattr("torchbrdf.experiment.metric_training.train", lambda *a: trained.append(a[1].name) or train(*a))
    run(recipe(quick="true"), out)
    assert trained == [kept[0].stem] and (out / "metric.json").read_text() == before
    kept[1].write_bytes(b"half of it")
    with pytest.raises(DataError, match="expected a finished training; remove it to train again"):
        run(recipe(quick="true"), out)


GOOD = {"constants": np.linspace(0, 1, 4), "slopes": np.array([1.0, 7.0]), "mismatch": np.array([0.5, 0.6])}


@pytest.mark.parametrize(
    "wrong",
    [
        {"constants": np.ones(3)},
        {"constants": np.ones((4, 1))},
        {"constants": np.ones(0)},
        {"constants": np.full(4, np.nan)},
        {"slopes": np.array(["a", "b"])},
        {"slopes": np.array([1, 2])},
        {"mismatch": np.array(1.0)},
        {"mismatch": np.zeros(2).astype("M8[s]")},
    ],
)
def test_trainings_that_cannot_be_are_refused(tmp_path: Path, wrong: dict) -> None:
    write_npz(tmp_path / "all.npz", GOOD | wrong)
    with pytest.raises(DataError, match=r"all\.npz: expected .*; remove it to train again"):
        read_training(tmp_path / "all.npz", 4)


def test_trainings_that_were_changed_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "all.npz"
    write_npz(path, GOOD)
    whole = path.read_bytes()
    kept = read_training(path, 4).constants
    torch.testing.assert_close(kept, torch.from_numpy(GOOD["constants"]), rtol=0, atol=0)
    np.savez(path, **GOOD)
    bad = [path.read_bytes(), whole[:-30], b"", whole.replace(b"slopes", b"slopez")]
    np.savez(path, slopes=np.array([None]), constants=GOOD["constants"])
    for data in (*bad, path.read_bytes()):
        path.write_bytes(data)
        with pytest.raises(DataError, match=r"all\.npz: expected a finished training; remove it to train again"):
            read_training(path, 4)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "expected human, or study and answers"),
        ({"human": "h"}, "materials: expected a folder"),
        ({"study": "runs/x"}, "expected a study and its answers"),
        ({"quick": "true", "pointwise": "1"}, "pointwise: expected .*0.05 to 0.45"),
        ({"quick": "true", "samples": "0"}, "samples: expected a whole number from 2 to 200000, found '0'"),
    ],
)
def test_settings_that_cannot_be_are_refused(options, said) -> None:
    with pytest.raises(UsageError, match=said):
        recipe(**options)


@pytest.fixture(scope="module")
def studied(tmp_path_factory) -> Path:
    """What `fores2012` leaves: fits and settings; and answers that prefer the fit whose roughness is right."""
    from torchbrdf.fitting import fit

    folder = tmp_path_factory.mktemp("study")
    measured = load(standins()).batch(samples=torch.arange(0, 1_000_000, 100))
    records = []
    for name in ("rms", "cube_root"):
        result = fit(make_model("ward", 1), measured, LOSSES[name](), samples=500, strategy="staged")
        records += result.records()
    write_fits(folder / "fits.json", records)
    (folder / "recipe.json").write_text(json.dumps({"settings": {"materials": "stand-ins"}}))
    with (folder / "answers.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["observer", "material", "left", "right", "chosen"])
        for observer in range(3):
            for k, material in enumerate(measured.names):
                rows.writerow([f"o{observer}", material, "ward-rms", "ward-cube_root", 1 + (k + observer > 1)])
                rows.writerow([f"o{observer}", material, "ward-rms", "measured", 2])
                rows.writerow([f"o{observer}", material, "measured", "ward-cube_root-staged", 1])
    return folder


def test_materials_of_a_run_that_are_gone_are_named_with_the_run(tmp_path: Path) -> None:
    (tmp_path / "recipe.json").write_text(json.dumps({"settings": {"materials": "gone"}}))
    (tmp_path / "answers.csv").write_text("observer,left,right,chosen\no,a,b,1\n")
    with pytest.raises(DataError, match=r"recipe\.json: materials: gone: no such file or folder$"):
        study_data(tmp_path, tmp_path / "answers.csv", uniform_pairs(20), {})


@pytest.mark.slow
def test_ones_own_study_trains_a_metric(studied: Path, tmp_path: Path) -> None:
    options = {"study": str(studied), "answers": str(studied / "answers.csv"), "samples": "400", "repeats": "2"}
    run(recipe(**options, replicates="20"), tmp_path / "own")
    metric = json.loads((tmp_path / "own" / "metric.json").read_text())
    facts = metric["provenance"]["learned_from"][0]
    assert facts["answers"] == "90 choices of 3 observers of a study" and facts["mark"] == ""
    assert metric["provenance"]["seen"]["choices"] > 0.8
    one, other = torch.rand(2, 300, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert float(LearnedLoss(weights=tmp_path / "own" / "metric.json")(one, other, uniform_pairs(300))) > 0
    both = run(recipe(**options, quick="true"), tmp_path / "quick")
    assert both.is_file()


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (["o", "lead", "ward-rms", "measured", "1"], "expected materials of stand-ins, found 'lead'"),
        (["o", "nickel", "ward-rms", "phong-rms", "1"], "nickel: expected a fit of .*, found 'phong-rms'"),
    ],
)
def test_answers_about_something_else_are_refused(studied: Path, tmp_path: Path, row, said) -> None:
    path = tmp_path / "answers.csv"
    path.write_text("observer,material,left,right,chosen\n" + ",".join(row) + "\n")
    with pytest.raises(DataError, match=said):
        run(recipe(study=str(studied), answers=str(path)), tmp_path / "out")


def test_simulated_observers_are_called_so(studied: Path, tmp_path: Path) -> None:
    path = tmp_path / "answers.csv"
    path.write_text((studied / "answers.csv").read_text().replace("\no", "\nsimulated-"))
    options = {"study": str(studied), "answers": str(path), "samples": "200", "repeats": "1"}
    report = run(recipe(**options, replicates="5"), tmp_path / "out")
    assert "simulated observers: not people" in report.read_text()
