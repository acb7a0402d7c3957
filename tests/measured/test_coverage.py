"""What `info` says of every format: angles covered, units, bands, and whether it could be a surface's."""

import json

import numpy as np
import pytest
import torch
from helpers.listed_files import angles, columns
from helpers.measured_files import synthetic_bsdf, tensor_file

from torchbrdf.cli import main
from torchbrdf.measured import Measured, describe, load, standins
from torchbrdf.measured.coverage import BINS, FULL, LOWER, NONE, UPPER, coverage, lines_of
from torchbrdf.pairs import Pairs


@pytest.fixture
def paint(tmp_path):
    path = tmp_path / "paint.csv"
    path.write_text(columns(angles(lights=(0, 20, 45))))
    return path


def test_ranges_and_plot(paint):
    found = coverage(load(paint))
    assert (found["light"], found["viewer"], found["azimuth between"]) == ([0, 45], [0, 80], [0, 180])
    title, *rows, axis = found["plot"]
    assert title == "viewer, degrees" and len(rows) == BINS // 2 and axis.endswith("light, degrees")
    cells = [row[4:] for row in rows]
    # Samples at 0, 10, ... fill the lower half of each row, at three angles of the light.
    assert all(row[::2] == row[1::2] and set(row) == {LOWER, NONE} for row in cells)
    assert [k for k, cell in enumerate(cells[0][::2]) if cell != NONE] == [0, 4, 9]
    assert found["share"] == round(3 * 9 / BINS**2, 3)


def test_halves_of_characters():
    seen = torch.tensor([[2.0, 7.0, 17.0]], dtype=torch.float64).deg2rad()
    zero = torch.zeros_like(seen)
    wo = torch.stack([seen.sin(), zero, seen.cos()], -1)
    up = torch.stack([zero, zero, zero + 1], -1)
    found = coverage(Measured.from_samples(Pairs.from_directions(up, wo), torch.ones(1, 3, 3)))
    assert [row[4] for row in found["plot"][1:-1]][-2:] == [UPPER, FULL]
    assert found["azimuth between"] is None and found["light"] == [0, 0]
    none = Measured.from_samples(Pairs.from_directions(up, wo), torch.ones(1, 3, 3), torch.zeros(1, 3, 1))
    assert coverage(none)["light"] is None and coverage(none)["share"] == 0


def test_terminals_without_the_characters():
    plot = [f"80 {FULL}{UPPER}{LOWER}{NONE}"]
    assert lines_of(plot, "utf-8") == plot
    assert lines_of(plot, "ascii") == lines_of(plot, None) == lines_of(plot, "no such") == ["80 #',."]


def test_json_has_ranges_and_no_picture(paint, tmp_path, capsys):
    assert main(["info", str(paint), str(tmp_path / "nowhere"), "--json"]) == 1
    said = capsys.readouterr()
    assert said.err.count("\n") == 1 and "nowhere" in said.err
    facts = json.loads(said.out)[str(paint)]
    assert facts["angles covered, degrees"]["light"] == [0, 45] and "plot" not in facts["angles covered, degrees"]
    assert facts["bands"] == "linear RGB"


def test_text_has_the_picture(paint, capsys):
    assert main(["info", str(paint)]) == 0
    said = capsys.readouterr().out
    assert "\n    viewer, degrees\n     80 " in said and "light, degrees\n" in said


def test_figures_of_every_format(paint, merl_file, tmp_path):
    rgl = tmp_path / "made_rgb.bsdf"
    rgl.write_bytes(tensor_file(synthetic_bsdf()))
    for path in (paint, merl_file, rgl):
        facts = describe(path)
        assert facts["quantity"] == "BRDF, 1/sr" and facts["bands"] == "linear RGB"
        assert 0 <= facts["invalid share"] < 1 and "reciprocity error" in facts
        assert facts["white furnace: albedo at 0 degrees"] > 0
        assert facts["angles covered, degrees"]["viewer"][1] > 75
    assert describe(merl_file)["reciprocity error"] == "none, by how values are stored"
    assert float(describe(rgl)["reciprocity error"].split()[0]) > 0
    model = describe("zoo:nickel")
    assert model["reciprocity error"].startswith("0 %") and "angles covered, degrees" not in model
    assert np.isclose(describe(paint)["invalid share"], 0)
    assert len(describe(standins())["nickel"]) > 10
