"""The recipe of the zoo: what it keeps of the fits, and how it says where materials are from."""

import json

import pytest

from torchbrdf.experiment.matching.candidates import Candidate
from torchbrdf.experiment.matching.judge import Figures
from torchbrdf.experiment.matching.search import Match, Tried
from torchbrdf.lobes import FitRecord, make_model, parameters, read_fits
from torchbrdf.measured import standins
from torchbrdf.recipe import run
from torchbrdf.recipes import make_zoo

# What a recipe takes from there when it runs.
SEARCH = "torchbrdf.experiment.matching.search.find_matches"


def tried(model, loss, delta_e76, lobes=None):
    made = make_model(model, lobes)
    record = FitRecord("x", model, lobes or 1, parameters(made), loss=loss, seconds=3.0, status="converged")
    return Tried(Candidate(model, lobes), record, {"room": Figures({"delta_e76": delta_e76, "delta_e_itp": 3.14159})})


@pytest.fixture
def matches(monkeypatch):
    """Fits of one material of each origin, two of one model, in the place of a search."""

    def find(groups, target, budget, **more):
        return [Match(groups[0].names[0], None, [tried("gltf", "a", 2.0), tried("gltf", "b", 1.23456789)])]

    monkeypatch.setattr(SEARCH, find)


def test_of_each_model_the_nearest_is_kept(matches, tmp_path):
    path = run(make_zoo.MakeZoo(), tmp_path / "out")
    (record,) = read_fits(path)
    assert (record.material, record.model, record.loss) == ("standin-alum-bronze", "gltf", "b")
    assert record.pictures == {"room": {"delta_e76": 1.235, "delta_e_itp": 3.142}}
    assert "seconds" not in json.loads(path.read_text())[0]


def test_it_says_where_materials_are_from(matches, tmp_path):
    recipe = make_zoo.MakeZoo(tables=str(standins()), said="made up", standins="none")
    path = run(recipe, tmp_path / "out")
    (record,) = read_fits(path)
    assert (record.material, record.extra) == ("alum-bronze", {"source": "made up"})
    assert path.read_text().count("\n") == 3  # a record a line


def test_what_cannot_be_matched_is_said(monkeypatch, tmp_path, caplog):
    from torchbrdf.errors import DataError

    monkeypatch.setattr(
        "torchbrdf.experiment.matching.search.find_matches",
        lambda *given, bad, **more: bad.append(DataError("nylon: no")) or [],
    )
    path = run(make_zoo.MakeZoo(), tmp_path / "out")
    assert json.loads(path.read_text()) == [] and "nylon: no" in caplog.text
