"""`torchbrdf study`: experiments that users add, simulate and scale."""

import csv
import os
from collections import Counter

import pytest
from helpers.simulated_plan import make_plan, wards

from torchbrdf.cli import main
from torchbrdf.study import MEASURED, Answer, Plan, read_answers, write_answers
from torchbrdf.study.store import STORE, Store


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
    plan = make_plan({f"m{k}": wards(6.0, 5.0, 2.0) | {MEASURED: 0.0} for k in range(2)})
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


@pytest.mark.parametrize(
    ("arguments", "fifo"),
    [
        (["simulate", "RUN", "--observers", "1000000", "--out", "FIFO"], "x.csv"),
        (["export", "RUN"], "answers.csv"),
        (["export", "RUN", "--out", "RUN/x.csv"], "x-observers.json"),
        (["scale", "RUN", "--out", "RUN"], "scales.html"),
        (["scale", "RUN", "--out", "RUN"], "scales.csv"),
    ],
)
def test_what_is_no_file_is_not_written_over(run, capsys, arguments, fifo):
    Store(run / STORE, Plan.load(run)).close()
    path = run / fifo
    os.mkfifo(path)
    before = set(run.iterdir())
    assert main(["study", *(a.replace("RUN", str(run)).replace("FIFO", str(path)) for a in arguments)]) == 1
    assert capsys.readouterr().err == f"torchbrdf: {path}: expected a file or a new name, found a FIFO\n"
    assert path.is_fifo() and set(run.iterdir()) == before


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
        (["scale", "nowhere.csv"], 1, "expected answers, found no such file"),
        (["scale", "x" * 300], 1, "expected answers, found File name too long"),
        (["scale", "a\0b"], 1, "expected answers, found no such file"),
        (["scale", "/dev/zero"], 1, "expected answers, found no regular file"),
        (["scale", "BAD"], 1, "expected a column condition_1"),
        (["scale", "GOOD", "--method", "guess"], 2, "unknown method of scaling 'guess'"),
        (["add", "RUN", "../x"], 1, "experiment: expected a name (one line, no path"),
        (["add", "RUN", "x", "--catch", "100000"], 2, "expected at most 100000 trials an observer, found 100012"),
        (["simulate", "RUN", "--observers", "1000000"], 2, "expected at most 83333 with 12 trials each, found 1000000"),
        (["power", "--difference", "0"], 2, "difference"),
        (["power", "--difference", "1e-300"], 2, "a difference of 1e-300 takes some 1000000000000000 observers"),
        (
            ["power", "--difference", "1", "--power", "1e-300"],
            2,
            "expected more than alpha, 0.05, and at most 0.999999",
        ),
    ],
)
def test_bad_input_gets_one_line(run, capsys, arguments, status, said):
    (run / "bad.csv").write_text("observer,chosen\no,1\n")
    write_answers(run / "good.csv", [Answer("o", "1", "m0", "a", "b", "b")])
    places = {"RUN": str(run), "BAD": str(run / "bad.csv"), "GOOD": str(run / "good.csv")}
    assert main(["study", *(places.get(a, a) for a in arguments)]) == status
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and printed.err.startswith("torchbrdf: ") and said in printed.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["add", "RUN", "x", "--catch", "1000000000"],
            "--catch: expected a whole number from 0 to 100000, found '1000",
        ),
        (["add", "RUN", "x", "--repeats", "-1"], "--repeats: expected a whole number from 0 to 100000, found '-1'"),
        (["add", "RUN", "x", "--compare", "1.5"], "--compare: expected a whole number from 2"),
        (["simulate", "RUN", "--observers", "0"], "--observers: expected a whole number from 1"),
        (["simulate", "RUN", "--noise", "inf"], "--noise: expected a number from 1e-06 to 1e+06, found 'inf'"),
        (["simulate", "RUN", "--noise", "nan"], "--noise: expected a number from 1e-06 to 1e+06, found 'nan'"),
        (["simulate", "RUN", "--seed", "1" * 23], "--seed: expected a whole number from 0 to 9223372036854775807"),
        (["scale", "RUN", "--seed", "-1"], "--seed: expected a whole number from 0"),
        (["power", "--difference", "nan"], "--difference: expected a number from -10 to 10, found 'nan'"),
        (["power", "--difference", "1", "--stimuli", "3001"], "--stimuli: expected a whole number from 2 to 1000"),
        (["power", "--difference", "1", "--alpha", "0"], "--alpha: expected a number from 1e-06 to 0.5, found '0'"),
    ],
)
def test_options_out_of_bounds_get_one_line(capsys, arguments, said):
    with pytest.raises(SystemExit) as caught:
        main(["study", *arguments])
    printed = capsys.readouterr().err
    assert caught.value.code == 2 and said in printed and printed.count("\n") == 1 and len(printed) <= 300


def test_help_of_the_study_teaches(capsys):
    with pytest.raises(SystemExit):
        main(["study", "--help"])
    assert "torchbrdf study serve runs/fores2012" in capsys.readouterr().out
