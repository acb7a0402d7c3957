"""Grids of fits that were interrupted: what was fitted is kept in parts, and the end is as if nothing had been."""

import json
import logging

import pytest

from torchbrdf.errors import DataError
from torchbrdf.experiment import grid as grid_module
from torchbrdf.experiment.grid import FitGrid
from torchbrdf.experiment.unfinished import FOLDER
from torchbrdf.files import write_json
from torchbrdf.losses import CompressedLoss, RMSLoss
from torchbrdf.measured import load, standins
from torchbrdf.recipe import RunFolder


def grid_in(path, models=("ward", "ggx")):
    losses = {"rms": RMSLoss(), "compressed": CompressedLoss()}
    group = load(standins()).batch([6, 7])
    return FitGrid(RunFolder(path), [group], list(models), losses, lobes=(1,), max_theta=20.0, samples=200)


def timeless(path):
    return [{**record, "seconds": 0} for record in json.loads((path / "fits.json").read_text())]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    path = tmp_path_factory.mktemp("undisturbed")
    grid_in(path).fit()
    return timeless(path)


@pytest.fixture
def interrupted(tmp_path, monkeypatch):
    """A run that was ended after the first of two models, and which models are fitted from then on."""
    made, inner = [], FitGrid._fit

    def until_the_second(self, strategy, model, *rest):
        if model == "ggx" and not made:
            made.append("ended")
            raise KeyboardInterrupt
        if made:
            made.append(model)
        return inner(self, strategy, model, *rest)

    monkeypatch.setattr(FitGrid, "_fit", until_the_second)
    with pytest.raises(KeyboardInterrupt):
        grid_in(tmp_path).fit()
    assert not (tmp_path / "fits.json").exists()
    return made


def test_what_was_fitted_is_not_fitted_again(tmp_path, interrupted, undisturbed):
    grid_in(tmp_path).fit()
    assert interrupted == ["ended", "ggx"]
    assert timeless(tmp_path) == undisturbed
    assert not (tmp_path / FOLDER).exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fits.csv", "fits.json", "log.txt"]


def test_a_part_that_was_cut_short_is_made_again(tmp_path, interrupted, undisturbed, caplog):
    part = sorted(tmp_path.glob(f"{FOLDER}/*/fits/part-*"))[0]
    part.write_bytes(part.read_bytes()[:-30])
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        grid_in(tmp_path).fit()
    assert "it was cut short; its fits are made again" in caplog.text
    assert interrupted == ["ended", "ward", "ggx"]
    assert timeless(tmp_path) == undisturbed


def test_parts_of_another_run_are_refused(tmp_path, interrupted):
    with pytest.raises(DataError, match=f"{FOLDER}: fit 0: expected one of the models of this run, found 'ward'"):
        grid_in(tmp_path, ["ggx"]).fit()


def test_the_table_is_written_once(tmp_path, monkeypatch):
    written, inner = [], grid_module.write_fits
    monkeypatch.setattr(grid_module, "write_fits", lambda *of: written.append(of) or inner(*of))
    grid_in(tmp_path).fit()
    assert len(written) == 1
    grid_in(tmp_path).fit()
    assert len(written) == 1


def test_folders_of_before_are_taken_up(tmp_path, undisturbed, monkeypatch):
    # An earlier version wrote the table after each model.
    write_json(tmp_path / "fits.json", [{**record, "differences": {"x": 1.0}} for record in undisturbed[:4]])
    made, inner = [], FitGrid._fit
    monkeypatch.setattr(FitGrid, "_fit", lambda self, *of: made.append(of[1]) or inner(self, *of))
    grid_in(tmp_path).fit()
    assert made == ["ggx"]
    found = timeless(tmp_path)
    assert [record.pop("differences", None) for record in found] == [{"x": 1.0}] * 4 + [None] * 4
    assert found == undisturbed
