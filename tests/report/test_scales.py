"""Scales as files, figures and a page."""

import csv
import json
from itertools import combinations

import pytest
from helpers.simulated_plan import make_plan, wards

from torchbrdf.report.observers import SIMULATED_MARK, write_scales
from torchbrdf.report.scale_figures import ScalePoint, _bars
from torchbrdf.report.style import new_figure, plain_ticks
from torchbrdf.study import MEASURED, Answer, simulate


def test_figures_say_what_they_are_made_of(tmp_path):
    with new_figure(tmp_path / "x.png", 3, 2, "simulated observers: not people " * 3) as figure:
        figure.subplots()
    assert figure._suptitle.get_text().replace("\n", " ").strip() == ("simulated observers: not people " * 3).strip()
    assert "\n" in figure._suptitle.get_text()  # it fits the width


def test_a_folder_of_scales_holds_all_of_them(tmp_path):
    plan = make_plan({f"m{k}": wards(6.0, 5.0, 2.0) | {MEASURED: 0.0} for k in range(3)})
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


@pytest.mark.filterwarnings("error")
def test_names_in_answers_are_text_and_no_path_nor_formula(tmp_path):
    """A dollar sign begins no formula, and an experiment's name is no path."""
    names = [r"a$\x$", "_hidden", "=1+1", "中文"]
    answers = [
        Answer(f"o{k % 5}", "../../escaped", r"$\bad{$", first, second, first if k % 3 else second)
        for k, (first, second) in enumerate([*combinations(names, 2)] * 10)
    ]
    write_scales(tmp_path / "deep" / "out", answers, None, method="likelihood", seed=0, source="answers.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["deep"]
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["out"]
    text = (tmp_path / "deep" / "out" / "scales.csv").read_text(encoding="utf-8")
    assert "\n=1" not in text and ",=1" not in text


def test_a_legend_leaves_no_label_out(tmp_path):
    with new_figure(tmp_path / "x.png", 3, 2) as figure:
        panel = figure.subplots()
        for label in ("_hidden", "shown"):
            _bars(panel, [0], [1], [ScalePoint(1, 0.5, 1.5)], "black", "y", label)
        legend = panel.legend()
    assert [text.get_text().strip() for text in legend.get_texts()] == ["_hidden", "shown"]


@pytest.mark.parametrize("high", [1.5, 8.0, 1e4])
def test_numbers_of_a_logarithmic_axis_are_plain_text(tmp_path, high):
    with new_figure(tmp_path / "x.png", 3, 2) as figure:
        panel = figure.subplots()
        panel.set(xscale="log", xlim=(1.0, high))
        plain_ticks(panel.xaxis)
    labels = [label.get_text() for label in panel.get_xticklabels() + panel.get_xticklabels(minor=True)]
    assert any(labels) and not any("$" in label for label in labels)
