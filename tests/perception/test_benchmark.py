"""The benchmark of losses against human answers, on made-up ones."""

import csv
import json
import re

import numpy as np
import pytest
import torch

from torchbrdf.errors import DataError, UsageError
from torchbrdf.experiment.benchmark import read_distances
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, parameters, write_fits
from torchbrdf.losses import LOSSES, LearnedLoss
from torchbrdf.measured.catalogue import MERL_NAMES
from torchbrdf.perception import FORMULAS, Distances, statistics_of, tabulate
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
from torchbrdf.perception.discrimination.psychometric import read_discrimination
from torchbrdf.reading import write_npz
from torchbrdf.recipe import RECIPES, configure, run
from torchbrdf.report.human_page import trained

SETTINGS = {"quick": "true", "images": "true", "replicates": "50", "size": "16"}


def benchmark(**settings):
    return configure(RECIPES["human_benchmark"], settings)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark") / "out"
    run(benchmark(**SETTINGS), folder)
    return folder


def test_every_loss_has_a_score_with_an_interval(out):
    records = json.loads((out / "scores.json").read_text())
    names = {record["loss"] for record in records}
    assert names == {*LOSSES, *FORMULAS, "rendered_delta_e76"}
    every = ("pairs", "apart", "across")
    left_out = {f"{key}_without_guess-{k}" for key in every for k in (1, 2, 3)}
    assert {record["statistic"] for record in records} == {"majority", "votes", *every, *left_out}
    assert len(records) == 14 * len(names)
    for record in records:
        assert 0 <= record["low"] <= record["agreement"] <= record["high"] <= 1 and 0.5 < record["ceiling"] < 1
    with (out / "scores.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["agreement"]) for row in rows] == [record["agreement"] for record in records]


def test_answers_drawn_around_cube_roots_are_told_best_by_cube_roots(out):
    found = {(r["loss"], r["statistic"]): r["agreement"] for r in json.loads((out / "scores.json").read_text())}
    for statistic in ("majority", "votes", "pairs", "apart", "across"):
        assert found["cube_root", statistic] > found["rms", statistic] + 0.05


def test_what_distances_mean_is_calibrated_and_checked(out):
    found = read_discrimination(out / "discrimination.json")
    assert {path.stem for path in (out / "distances").iterdir()} == {*LOSSES, *FORMULAS, "rendered_delta_e76"}
    assert {"cube_root", "rendered_delta_e76"} <= set(found.metrics) <= {*LOSSES, *FORMULAS, "rendered_delta_e76"}
    assert set(found.provenance["probes"]) == set(found.metrics) - {"rendered_delta_e76"}
    # Answers were drawn around cube roots: these foretell them best.
    assert found.metrics["cube_root"].spread < found.metrics["rms"].spread
    with (out / "reliability.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["metric"] for row in rows} == set(found.metrics) and {row["part"] for row in rows} <= {
        "triplets",
        "pairs",
    }
    assert all(0.5 <= float(row["predicted"]) <= 1 and 0 <= float(row["observed"]) <= 1 for row in rows)
    page = (out / "report.html").read_text()
    assert "What a number means" in page and "Told apart by" in page


def test_the_page_says_in_large_letters_that_nobody_was_asked(out):
    page = (out / "report.html").read_text()
    assert re.search(r'class="made">MADE-UP ANSWERS\. Nobody was asked', page) and "font-size: 2em" in page
    for words in ("Stand-ins.", "95&nbsp;%", "ceiling: people", "Better than cube root?", "data:image/png"):
        assert words in page
    assert "images=true" not in page and "<title>" in page and page.count("<h1>") == 1
    assert "http://" not in page and "https://" not in page


def test_what_is_scored_is_not_scored_again(tmp_path, monkeypatch):
    out, settings = tmp_path / "out", SETTINGS | {"losses": "rms,log", "replicates": "5"}
    run(benchmark(**settings), out)
    before = {path: path.stat().st_mtime_ns for path in (out / "distances").iterdir()}
    assert {path.stem for path in before} == {"rms", "log", "rendered_delta_e76"}
    (out / "distances" / "rms.npz").unlink()
    scores = (out / "scores.json").read_text()
    run(benchmark(**settings), out)
    assert (out / "scores.json").read_text() == scores
    changed = {path.stem for path in before if path.stat().st_mtime_ns != before[path]}
    assert changed == {"rms"}

    def no_need(*_):
        raise AssertionError("looked at the values again")

    monkeypatch.setattr("torchbrdf.experiment.benchmark.evaluate_brdfs", no_need)
    run(benchmark(**settings), out)
    assert (out / "scores.json").read_text() == scores


def test_distances_that_were_changed_are_refused_and_those_of_others_scored_again(tmp_path):
    path = tmp_path / "rms.npz"
    good = {"triplets": np.full((3, 3), np.nan), "opinions": np.ones(5)}
    assert read_distances(path, 3, 5) is None
    write_npz(path, good, compressed=True)
    whole = path.read_bytes()
    assert read_distances(path, 3, 5).opinions.tolist() == [1] * 5
    assert read_distances(path, 3, 6) is None and read_distances(path, 4, 5) is None
    bad = [whole[:-30], b"", whole.replace(b"triplets", b"tripletz")]
    for arrays in ({"opinions": np.ones(5)}, good | {"opinions": np.array(["x"] * 5)}, good | {"other": np.ones(1)}):
        write_npz(path, arrays)
        bad.append(path.read_bytes())
    np.savez(path, **good)
    for data in (*bad, path.read_bytes()):
        path.write_bytes(data)
        with pytest.raises(DataError, match=r"rms\.npz: expected the distances of a loss \(remove it to score again\)"):
            read_distances(path, 3, 5)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({}, "materials: expected a folder; quick=true runs on made-up answers"),
        ({"materials": "merl"}, "human: expected a folder"),
        ({"quick": "true", "samples": "1"}, "samples: expected a whole number from 2 to 200000, found '1'"),
        ({"quick": "true", "max_theta": "95"}, "max_theta: expected a number from 1 to 90, found '95'"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, said):
    with pytest.raises(UsageError, match=said):
        benchmark(**settings)


def test_a_missing_file_is_named_with_where_it_comes_from(tmp_path):
    recipe = benchmark(materials=str(tmp_path), human=str(tmp_path))
    with pytest.raises(DataError, match="no such file; expected the fits"):
        run(recipe, tmp_path / "out")


def test_a_loss_that_fails_is_left_out_with_a_word(tmp_path, monkeypatch, caplog):
    def fails(self, prediction, target, pairs=None, weight=None):
        raise UsageError("not today")

    monkeypatch.setattr(LOSSES["log"], "forward", fails)
    report = run(benchmark(quick="true", losses="rms,log"), tmp_path / "out")
    assert "log is left out: not today" in caplog.text and "log: not today" in report.read_text()
    assert "Rendered-image losses were not scored" in report.read_text()
    assert {r["loss"] for r in json.loads((tmp_path / "out" / "scores.json").read_text())} == {"rms"}


def study(folder):
    """Files of a study about 100 diffuse materials, with approximations of ten; settings that name them."""
    generator = np.random.default_rng(0)
    names = sorted(MERL_NAMES, key=lambda name: f"{name}.binary")
    model = Sum(Lambert(), Ward())
    records = [FitRecord(name, "ward", 1, parameters(model)) for name in names]
    write_fits(folder / "materials.json", records)
    questions = [generator.permutation(100)[:3].tolist() for _ in range(100)]
    votes = [[int(first), 5 - int(first)] for first in generator.integers(0, 6, 100)]
    (folder / "triplets.json").write_text(json.dumps({"answers": questions, "agreement": votes}))
    rows = [f"{method},{name},{generator.random()}\n" for method in ("WARD", "SGD", "BAGHER") for name in names[:10]]
    (folder / "opinions.csv").write_text("method,material,distance\n" + "".join(rows))
    fits = {
        name: {"model": "NganWard", "diffuse": [0.1, 0.2, 0.3], "specular": [shine] * 3, "roughness": 0.1}
        for name, shine in zip(names[:10], generator.uniform(0.01, 0.1, 10), strict=True)
    }
    (folder / "fits.json").write_text(json.dumps({"ngan_ward": fits}))
    settings = {"materials": str(folder / "materials.json"), "human": str(folder), "fits": "fits.json"}
    return settings | {"triplets": "triplets.json", "opinions": "opinions.csv", "losses": "rms", "samples": "50"}


def test_factors_are_one_more_method_where_there_is_a_file(tmp_path):
    settings = study(tmp_path)

    def keys():
        page = run(benchmark(replicates="50", **settings), tmp_path / "out").read_text()
        return {r["statistic"] for r in json.loads((tmp_path / "out" / "scores.json").read_text())}, page

    found, page = keys()
    assert found == {"majority", "votes", "across"}
    assert "Left out: BAGHER, SGD." in page and "with BAGHER" not in page
    factors = np.random.default_rng(1).uniform(0.1, 1, (256, 512, 3)).astype("<f4")
    (tmp_path / "npf.bin").write_bytes(factors.tobytes())
    found, page = keys()  # the distances that are stored are of too few opinions
    assert found == {"majority", "votes", "pairs", "apart", "across", "across_with_bagher"}
    assert "Left out: SGD." in page and "<h3>Methods left out: across</h3>" in page and "with BAGHER (" in page


def test_a_trained_metric_is_said_to_have_seen_the_answers():
    data = synthetic_benchmark(questions=20)
    columns = statistics_of(data.triplets, data.opinions)
    count = len(data.triplets.materials)
    some = Distances(torch.rand(count, count, dtype=torch.float64), None)
    (line,) = trained(tabulate(columns, {"learned": some, "rms": some}, replicates=3))
    assert "may have seen" in line
    held_out = LearnedLoss().provenance.get("held_out", {})
    assert ("did not see" in line) == bool(held_out)
    assert not held_out or f"{held_out['majority'][0]:.3f}" in line
    assert trained(tabulate(columns, {"rms": some}, replicates=3)) == []


def test_opinions_about_unknown_materials_or_only_unknown_methods_are_refused(tmp_path):
    settings = study(tmp_path)
    path = tmp_path / "opinions.csv"
    good = path.read_text()
    path.write_text(good + "WARD,nickle,0.5\n")
    said = r"opinions\.csv: line 32: expected one of 100 materials, found 'nickle'; did you mean 'nickel'\?$"
    with pytest.raises(DataError, match=said):
        run(benchmark(**settings), tmp_path / "out")
    path.write_text(good.replace("WARD", "WRAD"))
    with pytest.raises(DataError, match=r"opinions\.csv: expected opinions of WARD, found only others: BAGHER, SGD, W"):
        run(benchmark(**settings), tmp_path / "out")
    assert {one.name for one in (tmp_path / "out").iterdir()} == {"recipe.json", "log.txt"}


def test_gloss_and_jod_have_their_parts_where_there_are_answers(tmp_path):
    settings = study(tmp_path)
    report = run(benchmark(**settings), tmp_path / "without")
    assert "Gloss against people" not in report.read_text() and "JOD scores" not in report.read_text()
    names = sorted(MERL_NAMES)[:20]
    source = np.random.default_rng(0)
    records = [
        FitRecord(name, "ward", 1, parameters(Sum(Lambert(), Ward(roughness=float(source.uniform(0.05, 0.3))))))
        for name in MERL_NAMES
    ]
    write_fits(tmp_path / "materials.json", records)
    head = "image,n,glossy_mean,odd_mean,glossy_sd,odd_sd\n"
    rows = [f"{name}_5PCs.png,9,{source.uniform(1, 5):.2f},3,0.5,0.5\n" for name in names]
    (tmp_path / "serrano2016_mean_ratings.csv").write_text(head + "".join(rows))
    scores = [
        f"{name}_{k},{model},0,{source.uniform(1, 40)},{source.uniform(2, 10)},3\n"
        for name in names[:3]
        for k, model in enumerate(("ward", "ggx", "nbrdf"), 1)
    ]
    jod = "material,model,level,DeltaE,JOD,class\n" + "".join(scores)
    (tmp_path / "kavoosighafi2025_jod_train.csv").write_text(jod)
    out = tmp_path / "with"
    page = run(benchmark(replicates="20", **settings), out).read_text()
    assert "Gloss against people" in page and "<h3>JOD scores</h3>" in page and "no metric of BRDFs can be" in page
    with (out / "appearance.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    assert len(found) == 10 and {row["attribute"] for row in found} == {"glossy", "odd"}
    assert {row["materials"] for row in found} == {"20"}
    approximations = [FitRecord(row.split(",")[0], "ward", 1, records[0].parameters) for row in scores[:5]]
    write_fits(tmp_path / "tables.json", approximations)
    more = {"jod_tables": str(tmp_path / "tables.json"), "ratings": "none"}
    page = run(benchmark(replicates="20", **settings, **more), tmp_path / "tables").read_text()
    assert "only those could be scored" in page and "Gloss against people" not in page
    with (tmp_path / "tables" / "jod.csv").open(newline="") as file:
        assert {row["loss"] for row in csv.DictReader(file)} == {"delta_e_of_the_study", "rms"}
    (tmp_path / "kavoosighafi2025_jod_train.csv").write_text(jod.replace("ggx", "../x"))
    with pytest.raises(DataError, match=r"kavoosighafi2025_jod_train\.csv: line 3: expected a name"):
        run(benchmark(**settings), tmp_path / "bad")
    assert not (tmp_path / "bad" / "report.html").exists() and not (tmp_path / "bad" / "scores.json").exists()
    with pytest.raises(DataError, match="no such file; expected the mean ratings"):
        run(benchmark(**settings, ratings="mine.csv", jod="none"), tmp_path / "none")


def test_a_metric_of_ones_own_has_a_row_and_is_scored_in_every_run(tmp_path, monkeypatch):
    module = tmp_path / "own.py"
    module.write_text("def far(prediction, target, pairs):\n    return (prediction - target).abs().mean((-2, -1))\n")
    settings = {"quick": "true", "losses": f"rms,{module}:far"}

    def scores():
        run(benchmark(**settings), tmp_path / "out")
        records = json.loads((tmp_path / "out" / "scores.json").read_text())
        return {r["statistic"]: r["agreement"] for r in records if r["loss"] == "own.py:far"}

    first = scores()
    assert len(first) == 14 and first["majority"] > 0.6
    assert {path.name for path in (tmp_path / "out" / "distances").iterdir()} == {"rms.npz"}
    module.write_text("def far(prediction, target, pairs):\n    return -(prediction - target).abs().mean((-2, -1))\n")
    assert scores()["majority"] == pytest.approx(1 - first["majority"])
