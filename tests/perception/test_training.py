"""Learning a metric from answers: the training set, the likelihood, cross-validation, and the recipe."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.optimize import check_grad
from scipy.stats import norm

from torchbrdf.errors import DataError, UsageError
from torchbrdf.experiment.metric_training import read_training, study_data
from torchbrdf.lobes import make_model, write_fits
from torchbrdf.losses import LOSSES, LearnedLoss, RMSLoss
from torchbrdf.losses.learned import THETA_H_BINS
from torchbrdf.measured import load, standins
from torchbrdf.perception import evaluate_brdfs, uniform_pairs
from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
from torchbrdf.perception.learning.training import (
    LAPSE,
    MIN_POINTWISE_SHARE,
    PART_SLOPE,
    PART_WEIGHT,
    Split,
    baseline_distances,
    best_iteration,
    held_out,
    negative_log_likelihood,
    normalized_weights,
    select_judgments,
    splits,
    train,
)
from torchbrdf.perception.learning.training_set import (
    TrainingSet,
    make_training_set,
    merge_training_sets,
    training_set_from_choices,
)
from torchbrdf.reading import write_npz
from torchbrdf.recipe import RECIPES, configure, run

DATA = synthetic_benchmark(questions=200)
BRDFS = evaluate_brdfs(DATA, uniform_pairs(300))
TRAINING_SET = make_training_set(DATA, BRDFS)
ALL = Split("all", torch.ones(len(TRAINING_SET.names), dtype=torch.bool))


def test_distances_of_a_training_set_are_those_of_the_loss() -> None:
    weights = train(TRAINING_SET, ALL, 5).weights[-1]
    named = normalized_weights(TRAINING_SET, weights)
    loss = LearnedLoss(reduction="none", weights={"weights": named})
    found = baseline_distances(TRAINING_SET, BRDFS, {"learned": loss})["learned"]
    own = TRAINING_SET.distances(weights)
    own = own / own[TRAINING_SET.method < 0].mean()
    torch.testing.assert_close(found, own, rtol=2e-4, atol=1e-6)  # weights have four digits
    assert float(found[TRAINING_SET.method < 0].mean()) == pytest.approx(1, rel=1e-3)


def test_comparisons_are_those_of_the_statistics() -> None:
    """A question of the triplets, a pair of opinions, found again among the training set's places."""
    triplets, opinions = DATA.triplets, DATA.opinions
    judgments = TRAINING_SET.judgments["triplets"]
    for k in (0, 17, 199):
        reference, a, b = triplets.questions[k].tolist()
        for place, candidate in ((judgments.first[k], a), (judgments.second[k], b)):
            assert {int(TRAINING_SET.first[place]), int(TRAINING_SET.second[place])} == {reference, candidate}
        assert float(judgments.share[k]) == triplets.votes[k, 0] / triplets.votes[k].sum()
    pairs = TRAINING_SET.judgments["pairs"]
    for k in range(len(pairs)):
        one, other = (int(TRAINING_SET.first[place]) for place in (pairs.first[k], pairs.second[k]))
        assert opinions.materials[one] == opinions.materials[other] and opinions.methods[one] != opinions.methods[other]
        assert opinions.distance[one] < opinions.distance[other] and 0.5 < float(pairs.share[k]) <= 1
    assert {TRAINING_SET.methods[int(k)] for k in TRAINING_SET.method[TRAINING_SET.method >= 0]} == set(
        opinions.methods
    )


def test_the_mismatch_is_thurstones() -> None:
    generator = torch.Generator().manual_seed(1)
    weights = torch.rand(TRAINING_SET.features.shape[1], generator=generator, dtype=torch.float64)
    slopes = torch.tensor([0.3, -0.2], dtype=torch.float64)
    distance, expected = TRAINING_SET.distances(weights), 0.0
    for part, own in TRAINING_SET.judgments.items():
        slope = PART_SLOPE[part] * float(slopes[0 if part == "triplets" else 1].exp())
        total = 0.0
        for k in range(len(own)):
            z = max(-6.0, min(6.0, slope * float(distance[own.second[k]] - distance[own.first[k]])))
            p = LAPSE + (1 - 2 * LAPSE) * norm.cdf(z)
            share = float(own.share[k])
            total -= float(own.count[k]) * (share * norm.logpdf(0) * 0 + share * _log(p) + (1 - share) * _log(1 - p))
        expected += PART_WEIGHT[part] * total / float(own.count.sum())
    assert float(negative_log_likelihood(TRAINING_SET, TRAINING_SET.judgments, weights, slopes)) == pytest.approx(
        expected, rel=1e-10
    )


def _log(p: float) -> float:
    return float(torch.tensor(p, dtype=torch.float64).log())


def test_its_gradient_is_finite_where_two_are_equal() -> None:
    equal = TrainingSet(**{**vars(TRAINING_SET), "features": TRAINING_SET.features * 0})
    weights = torch.ones(TRAINING_SET.features.shape[1], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(
        negative_log_likelihood(equal, equal.judgments, weights, torch.zeros(2, dtype=torch.float64)), weights
    )
    assert bool(slope.isfinite().all())

    def value(x):
        return float(
            negative_log_likelihood(
                TRAINING_SET, TRAINING_SET.judgments, torch.from_numpy(x), torch.zeros(2, dtype=torch.float64)
            )
        )

    def gradient(x):
        point = torch.from_numpy(x).requires_grad_()
        (found,) = torch.autograd.grad(
            negative_log_likelihood(TRAINING_SET, TRAINING_SET.judgments, point, torch.zeros(2, dtype=torch.float64)),
            point,
        )
        return found.numpy()

    start = torch.rand(len(slope), generator=torch.Generator().manual_seed(2), dtype=torch.float64).numpy()
    assert check_grad(value, gradient, start) < 1e-4


def test_training_learns_and_keeps_to_its_bounds() -> None:
    history = train(TRAINING_SET, ALL, 12)
    assert history.curve.shape == (12, 2) and history.weights.shape == (12, TRAINING_SET.features.shape[1])
    assert float(history.curve[-1, 0]) < float(history.curve[0, 0]) - 0.01
    assert float(history.weights.min()) >= 0
    scaled = history.weights * TRAINING_SET.features[TRAINING_SET.method < 0].mean(0)
    assert float((scaled[:, :THETA_H_BINS].sum(1) / scaled.sum(1)).min()) >= MIN_POINTWISE_SHARE * (1 - 1e-9)
    again = train(TRAINING_SET, ALL, 12)
    assert torch.equal(again.weights, history.weights)


def test_a_split_does_not_look_at_what_it_is_judged_on() -> None:
    every = list(splits(TRAINING_SET, 2, seed=3))
    assert len(every) == 4 + 2 * len(TRAINING_SET.methods)
    assert torch.equal(every[0].materials, ~next(s for s in every if s.name == "half-0-1").materials)
    for split in every:
        for own in TRAINING_SET.judgments.values():
            seen, unseen = (select_judgments(TRAINING_SET, own, split, seen=x) for x in (True, False))
            assert bool(split.materials[seen.materials].all()) and not bool(split.materials[unseen.materials].any())
            if split.without >= 0:
                assert not bool((TRAINING_SET.method[torch.stack([seen.first, seen.second])] == split.without).any())
                about = TRAINING_SET.method[torch.stack([unseen.first, unseen.second])] == split.without
                assert bool(about.any(0).all())
    # Answers about what is held out do not change what is learned.
    split = every[0]
    other = dict(TRAINING_SET.judgments)
    judgments = other["triplets"]
    mixed = ~split.materials[judgments.materials].all(1)
    other["triplets"] = type(judgments)(
        judgments.first,
        judgments.second,
        torch.where(mixed, 1 - judgments.share, judgments.share),
        judgments.count,
        judgments.materials,
    )
    turned = TrainingSet(**{**vars(TRAINING_SET), "judgments": other})
    assert torch.equal(train(turned, split, 3).weights, train(TRAINING_SET, split, 3).weights)


def test_what_is_held_out_is_counted_right() -> None:
    """By hand: the mean over splits of whether a comparison of unseen materials is ordered right."""
    every = [split for split in splits(TRAINING_SET, 2, seed=3) if split.without < 0]
    histories = [train(TRAINING_SET, split, 4) for split in every]
    best = best_iteration(histories)
    judged = [(split, history.weights[best]) for split, history in zip(every, histories, strict=True)]
    others = baseline_distances(TRAINING_SET, BRDFS, {"rms": RMSLoss(reduction="none")})
    found = held_out(TRAINING_SET, judged, others, replicates=50)
    own = TRAINING_SET.statistics["majority"]
    shares, theirs = [], []
    for k in range(len(own)):
        right = [
            float(TRAINING_SET.distances(weights)[own.nearer[k]] < TRAINING_SET.distances(weights)[own.farther[k]])
            for split, weights in judged
            if not bool(split.materials[own.materials[k]].any())
        ]
        if right:
            shares.append(sum(right) / len(right))
            theirs.append(float(others["rms"][own.nearer[k]] < others["rms"][own.farther[k]]))
    mine, rms = found["majority"]["learned"], found["majority"]["rms"]
    assert mine["share"][0] == pytest.approx(sum(shares) / len(shares))
    assert rms["share"][0] == pytest.approx(sum(theirs) / len(theirs))
    assert rms["gain"][0] == pytest.approx(mine["share"][0] - rms["share"][0])
    assert mine["share"][1] <= mine["share"][0] <= mine["share"][2] and mine["gain"] == [0, 0, 0]


def test_training_sets_are_merged() -> None:
    reverse = TrainingSet(
        **{**vars(TRAINING_SET), "names": TRAINING_SET.names[::-1]}
    )  # the same answers about materials of other names
    both = merge_training_sets([TRAINING_SET, reverse])
    assert both.names == TRAINING_SET.names and both.methods == TRAINING_SET.methods
    assert len(both.features) == 2 * len(TRAINING_SET.features)
    for name, own in TRAINING_SET.judgments.items():
        part, count = both.judgments[name], len(own)
        assert torch.equal(part.first[count:], own.first + len(TRAINING_SET.features))
        assert torch.equal(part.materials[count:], len(TRAINING_SET.names) - 1 - own.materials)
    for name, own in TRAINING_SET.statistics.items():
        there = both.statistics[name].materials[len(own) :]
        assert torch.equal(there < 0, own.materials < 0)


def test_choices_become_a_training_set() -> None:
    votes = torch.tensor([[3, 1], [2, 2], [0, 4]])
    pairs = torch.tensor([[0, 1], [0, 2], [1, 2]])
    stimuli = list(DATA.opinions.methods)
    own = training_set_from_choices(TRAINING_SET.names, stimuli, BRDFS, pairs, votes)
    judgments, counted = own.judgments["choices"], own.statistics["choices"]
    assert judgments.share.tolist() == [0.75, 0.5, 0] and judgments.count.tolist() == [4, 4, 4]
    assert counted.nearer.tolist() == [0, 2] and counted.farther.tolist() == [1, 1]
    with pytest.raises(DataError, match="expected choices, found none"):
        training_set_from_choices(TRAINING_SET.names, stimuli, BRDFS, pairs[:0], votes[:0])


# --- the recipe ---------------------------------------------------------------------------------------------------


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
    assert set(table) == {"materials", "methods"}
    for name, own in table["materials"].items():
        assert own["learned"]["share"][0] > (0.6 if name == "majority" else 0.5)
        assert set(own) == {"learned", *(set(LOSSES) - {"learned"})}


def test_the_page_says_that_nobody_was_asked(out: Path) -> None:
    page = (out / "report.html").read_text()
    for words in ("made-up answers: nobody was asked", "never saw", "theta_h", "data:image/png"):
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


CURVE, WEIGHTS = np.linspace(0, 1, 6).reshape(3, 2), np.linspace(0, 1, 12).reshape(3, 4)
GOOD = {"curve": CURVE, "weights": WEIGHTS}


@pytest.mark.parametrize(
    "wrong",
    [
        {"curve": CURVE[:2]},
        {"weights": WEIGHTS[:, :3]},
        {"weights": WEIGHTS.T},
        {"weights": WEIGHTS[:, :0]},
        {"weights": np.full_like(WEIGHTS, np.nan)},
        {"curve": CURVE.astype(str)},
        {"curve": CURVE.astype(int)},
        {"curve": np.array(1.0)},
        {"curve": CURVE.astype("M8[s]")},
    ],
)
def test_trainings_that_cannot_be_are_refused(tmp_path: Path, wrong: dict) -> None:
    write_npz(tmp_path / "all.npz", GOOD | wrong)
    with pytest.raises(DataError, match=r"all\.npz: expected .*; remove it to train again"):
        read_training(tmp_path / "all.npz", 3, 4)


def test_trainings_that_were_changed_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "all.npz"
    write_npz(path, GOOD, compressed=True)
    whole = path.read_bytes()
    torch.testing.assert_close(read_training(path, 3, 4).weights, torch.from_numpy(WEIGHTS), rtol=0, atol=0)
    np.savez(path, **GOOD)
    bad = [path.read_bytes(), whole[:-30], b"", whole.replace(b"weights", b"weightz")]
    np.savez(path, curve=np.array([None]), weights=WEIGHTS)
    for data in (*bad, path.read_bytes()):
        path.write_bytes(data)
        with pytest.raises(DataError, match=r"all\.npz: expected a finished training; remove it to train again"):
            read_training(path, 3, 4)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "expected human, or study and answers"),
        ({"human": "h"}, "materials: expected a folder"),
        ({"study": "runs/x"}, "expected a study and its answers"),
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
    measured = load(standins())
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
    run(recipe(**options, iterations="8", replicates="20"), tmp_path / "own")
    metric = json.loads((tmp_path / "own" / "metric.json").read_text())
    facts = metric["provenance"]["learned_from"][0]
    assert facts["answers"] == "90 choices of 3 observers of a study" and facts["mark"] == ""
    assert metric["provenance"]["seen"]["choices"] > 0.8
    assert float(
        LearnedLoss(weights=tmp_path / "own" / "metric.json")(BRDFS.materials[:1], BRDFS.materials[1:2], BRDFS.pairs)
    )
    both = run(recipe(**options, quick="true", iterations="8"), tmp_path / "quick")
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
    options = {"study": str(studied), "answers": str(path), "samples": "200", "repeats": "1", "iterations": "2"}
    report = run(recipe(**options, replicates="5"), tmp_path / "out")
    assert "simulated observers: not people" in report.read_text()
