"""Simulated observers, and what figures and pages make of answers."""

import csv
import json
import math
from collections import Counter

import pytest
from scipy.stats import norm, spearmanr

from torchbrdf.cli import main
from torchbrdf.errors import UsageError
from torchbrdf.report.claims import benefits, claim, confused
from torchbrdf.report.drawing import drawing
from torchbrdf.report.judged import judge
from torchbrdf.report.observers import SIMULATED_MARK, write_scales
from torchbrdf.study import (
    MEASURED,
    Answer,
    Experiment,
    Material,
    Plan,
    Stimulus,
    read_answers,
    simulate,
    simulated,
    write_answers,
)

LOSSES = ("rms", "cosine_rms", "cube_root")


def made(differences, orders=None):
    """A plan: differences[material][stimulus name], a stimulus MODEL-LOSS or measured."""
    materials = []
    for k, (name, own) in enumerate(differences.items()):
        stimuli = {}
        for stimulus, difference in own.items():
            model, _, loss = stimulus.partition("-")
            stimuli[stimulus] = Stimulus(
                f"{name}-{stimulus}.png", model if loss else None, loss or None, False, difference
            )
        materials.append(Material(name, f"{name}.png", stimuli, order=orders[k] if orders else float(k)))
    names = tuple(next(iter(differences.values())))
    return Plan(tuple(materials), (Experiment("1", "all", names),))


def wards(rms, cosine, cuberoot):
    return {"ward-rms": rms, "ward-cosine_rms": cosine, "ward-cube_root": cuberoot}


def test_simulated_observers_choose_with_thurstones_probability():
    plan = made({"nickel": {"ward-rms": 5.0, "ward-cube_root": 3.0, "ward-log": 3.5}})
    answers = simulate(plan, plan.experiment("1"), 3000, noise=2.0)
    assert len(answers) == 9000
    for better, worse, gap in (("ward-cube_root", "ward-rms", 2.0), ("ward-cube_root", "ward-log", 0.5)):
        own = [a.chosen == better for a in answers if {a.left, a.right} == {better, worse}]
        expected = norm.cdf(gap / (math.sqrt(2) * 2.0))
        assert abs(sum(own) / 3000 - expected) < 4 * math.sqrt(expected * (1 - expected) / 3000)
    lefts = Counter(a.chosen == a.left for a in answers)
    assert abs(lefts[True] - lefts[False]) < 4 * math.sqrt(9000)


def test_simulated_observers_are_seeded_and_named():
    plan = made({"nickel": wards(5.0, 4.0, 3.0)})
    first, again = (simulate(plan, plan.experiment("1"), 4, seed=1) for _ in range(2))
    assert [(a.left, a.chosen) for a in first] == [(a.left, a.chosen) for a in again]
    other = simulate(plan, plan.experiment("1"), 4, seed=2)
    assert [a.left for a in first] == [a.left for a in other] and first != other
    assert simulated(first) and {a.observer for a in first} == {f"simulated-00{k}" for k in (1, 2, 3, 4)}


@pytest.mark.parametrize(
    ("more", "said"), [({"observers": 0}, "expected at least 1"), ({"observers": 2, "noise": 0.0}, "noise: expected")]
)
def test_simulations_that_cannot_be_are_refused(more, said):
    plan = made({"nickel": wards(5.0, 4.0, 3.0)})
    with pytest.raises(UsageError, match=said):
        simulate(plan, plan.experiment("1"), **more)


def test_a_difference_that_is_not_known_cannot_be_seen():
    plan = made({"nickel": wards(5.0, None, 3.0)})
    with pytest.raises(UsageError, match="ward-cosine_rms of nickel: its difference is not known"):
        simulate(plan, plan.experiment("1"), 1)


def judged_of(plan, observers=30, noise=2.0):
    (judged,) = judge(simulate(plan, plan.experiment("1"), observers, noise), plan)
    return judged


def test_the_papers_claim_is_said_as_it_comes_out():
    angles = [0.5, 1.0, 3.0, 6.0, 12.0]
    falls = made({f"m{k}": wards(12.0 - 2 * k, 5.0, 2.0) for k in range(5)}, angles)
    judged = judged_of(falls, observers=60, noise=4.0)
    overall, by_gloss, *_ = claim(judged.scales, falls)
    assert "Of 5 materials and models it is better for 5, worse for 0" in overall and "holds everywhere" in overall
    assert ": supported by these answers" in by_gloss
    found = {one.material: one.value for one in benefits(judged.scales, falls, "cube_root", "rms")}
    expected = spearmanr(angles, [found[f"m{k}"] for k in range(5)], alternative="less")
    assert f"is {expected.statistic:.2f} (one-sided p = {expected.pvalue:.2g})" in by_gloss

    rises = made({f"m{k}": wards(4.0 + 2 * k, 5.0, 2.0) for k in range(5)}, angles)
    assert "not supported by these answers" in claim(judged_of(rises).scales, rises)[1]

    worse = made({f"m{k}": wards(2.0, 5.0, 6.0) for k in range(2)})
    overall, *_ = claim(judged_of(worse).scales, worse)
    assert "worse for 2" in overall and "does not hold for 2 of them (m0 Ward, m1 Ward)" in overall


def test_answers_about_something_else_claim_nothing():
    plan = made({"nickel": {"ward-log": 3.0, "ward-rms": 4.0, MEASURED: 0.0}})
    assert claim(judged_of(plan).scales, plan) == []


def test_what_observers_cannot_tell_from_the_measured_material_is_confused_with_it():
    plan = made({"nickel": {"ward-cube_root": 0.0, "cook-cube_root": 9.0, MEASURED: 0.0}})
    assert confused(judged_of(plan).scales) == {"nickel": {"ward-cube_root"}}
    better = made({"nickel": {"ward-cube_root": 0.0, "cook-cube_root": 9.0, MEASURED: 5.0}})
    assert "ward-cube_root" in confused(judged_of(better).scales)["nickel"]


def test_scales_find_what_simulated_observers_see():
    plan = made({"nickel": wards(5.0, 4.0, 3.0), "nylon": wards(2.0, 2.0, 2.0)})
    judged = judged_of(plan, observers=2000)
    unit = math.sqrt(2) * 2.0
    known = {(record["material"], record["stimulus"]): record["scale"] for record in judged.scales.records()}
    for k, name in enumerate(("ward-rms", "ward-cosine_rms", "ward-cube_root")):
        assert known["nickel", name] == pytest.approx((k - 1) / unit, abs=0.05)
        assert known["nylon", name] == pytest.approx(0, abs=0.05)


def test_figures_say_what_they_are_made_of(tmp_path):
    with drawing(tmp_path / "x.png", 3, 2, "simulated observers: not people " * 3) as figure:
        figure.subplots()
    assert figure._suptitle.get_text().replace("\n", " ").strip() == ("simulated observers: not people " * 3).strip()
    assert "\n" in figure._suptitle.get_text()  # it fits the width


def test_a_folder_of_scales_holds_all_of_them(tmp_path):
    plan = made({f"m{k}": wards(6.0, 5.0, 2.0) | {MEASURED: 0.0} for k in range(3)})
    answers = simulate(plan, plan.experiment("1"), 8)
    said = write_scales(tmp_path, answers, plan, method="likelihood", seed=0, source="answers.csv")
    assert SIMULATED_MARK in said and any("cube root" in line for line in said)
    page = (tmp_path / "scales.html").read_text()
    assert SIMULATED_MARK in page and "http" not in page and page.count("data:image/png") == 1
    rows = list(csv.DictReader((tmp_path / "scales.csv").open()))
    assert len(rows) == 12 and {row["material"] for row in rows} == {"m0", "m1", "m2"}
    record = json.loads((tmp_path / "scales.json").read_text())
    assert record["simulated"] and record["seed"] == 0 and "torch" in record["versions"]
    for row, same in zip(rows, record["scales"], strict=True):
        assert float(row["scale"]) == pytest.approx(same["scale"]) and same["low"] < same["scale"] < same["high"]
    for name in ("m0", "m1", "m2"):
        own = {row["stimulus"]: float(row["scale"]) for row in rows if row["material"] == name}
        assert sum(own.values()) == pytest.approx(0, abs=1e-9)
        assert max(own, key=own.__getitem__) == MEASURED
    assert len(list(csv.DictReader((tmp_path / "observers.csv").open()))) == 8


def test_anybodys_comparisons_can_be_scaled(tmp_path, capsys):
    path = tmp_path / "tmo.csv"
    rows = ["observer,scene,condition_1,condition_2,selection"]
    for k in range(12):
        rows += [f"o{k},window,a,b,{1 if k < 9 else 2}", f"o{k},window,b,c,{1 if k < 8 else 2}", f"o{k},window,c,a,2"]
        rows += [f"o{k},corridor,x,y,{1 + k % 2}"]
    path.write_text("\n".join(rows) + "\n")
    assert main(["study", "scale", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "12 observers, 48 answers" in printed and printed.rstrip().endswith("scales.html")
    assert "not people" not in printed
    rows = list(csv.DictReader((tmp_path / "scales" / "scales.csv").open()))
    scale = {row["stimulus"]: float(row["scale"]) for row in rows}
    assert scale["a"] > scale["b"] > scale["c"] and scale["x"] == pytest.approx(scale["y"], abs=1e-6)


@pytest.fixture
def run(tmp_path):
    """A run folder with a plan and its pictures."""
    plan = made({f"m{k}": wards(6.0, 5.0, 2.0) | {MEASURED: 0.0} for k in range(2)})
    for material in plan.materials:
        for picture in (material.reference, *(stimulus.picture for stimulus in material.stimuli.values())):
            (tmp_path / picture).write_bytes(b"png")
    plan.save(tmp_path)
    return tmp_path


def test_a_user_adds_an_experiment_simulates_and_scales_it(run, capsys):
    arguments = ["study", "add", str(run), "mine", "--stimuli", "ward-c*,measured", "--repeats", "2", "--catch", "1"]
    assert main(arguments) == 0
    assert "experiment mine: 3 stimuli, 2 materials, 9 trials an observer" in capsys.readouterr().out
    out = run / "simulated.csv"
    assert main(["study", "simulate", str(run), "--experiment", "mine", "--observers", "6", "--out", str(out)]) == 0
    assert "who are no people" in capsys.readouterr().out
    answers = read_answers(out)
    assert len(answers) == 54 and Counter(a.kind for a in answers) == {"trial": 36, "repeat": 12, "catch": 6}
    assert main(["study", "scale", str(out), "--method", "least_squares", "--out", str(run / "s")]) == 0
    printed = capsys.readouterr().out
    assert "simulated observers: not people" in printed and "6 observers, 36 answers" in printed
    assert "confused with the measured one" in printed


def test_pairs_can_be_chosen(run, capsys):
    assert main(["study", "add", str(run), "few", "--pairs", "ward-rms:ward-cube_root,ward-cosine_rms:measured"]) == 0
    assert Plan.load(run).experiment("few").pairs == (("ward-rms", "ward-cube_root"), ("ward-cosine_rms", MEASURED))
    assert "4 trials an observer" in capsys.readouterr().out


def test_power_says_how_many_observers(capsys):
    assert main(["study", "power", "--difference", "0.6745"]) == 0
    assert "observers" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["serve", "nowhere"], 1, "run a recipe such as fores2012 first"),
        (["serve", "RUN", "--experiment", "7"], 2, "unknown experiment '7'; expected one of 1"),
        (["add", "RUN", "1"], 2, "there is an experiment '1'"),
        (["add", "RUN", "x", "--stimuli", "ward-log"], 2, "no stimulus is called ward-log"),
        (["add", "RUN", "x", "--pairs", "ward-rms"], 2, "--pairs: expected a:b,c:d"),
        (["add", "RUN", "x", "--compare", "9"], 2, "compare: expected 2 to 3 of 4 stimuli, found 9"),
        (["export", "RUN"], 1, "torchbrdf study serve"),
        (["scale", "nowhere.csv"], 1, "cannot be read"),
        (["scale", "BAD"], 1, "expected a column condition_1"),
        (["scale", "GOOD", "--method", "guess"], 2, "unknown method of scaling 'guess'"),
        (["simulate", "RUN", "--observers", "0"], 2, "expected at least 1"),
        (["power", "--difference", "0"], 2, "difference"),
    ],
)
def test_bad_input_gets_one_line(run, capsys, arguments, status, said):
    (run / "bad.csv").write_text("observer,chosen\no,1\n")
    write_answers(run / "good.csv", [Answer("o", "1", "m0", "a", "b", "b")])
    places = {"RUN": str(run), "BAD": str(run / "bad.csv"), "GOOD": str(run / "good.csv")}
    assert main(["study", *(places.get(a, a) for a in arguments)]) == status
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and printed.err.startswith("torchbrdf: ") and said in printed.err


def test_help_of_the_study_teaches(capsys):
    with pytest.raises(SystemExit):
        main(["study", "--help"])
    assert "torchbrdf study serve runs/fores2012" in capsys.readouterr().out
