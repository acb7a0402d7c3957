"""Matching: the choice among fits, what is kept in a folder, and where a match is said to be bad."""

import pickle
import re
from dataclasses import replace

import pytest
import torch
from helpers.measured_files import synthetic_bsdf, tensor_file

from torchbrdf.errors import DataError, UsageError
from torchbrdf.experiment import matching
from torchbrdf.experiment.matching import BUDGETS, Budget, Candidate, Figures, Judge, Tried, find_budget, find_matches
from torchbrdf.experiment.matching.search import ranked
from torchbrdf.experiment.matching.shortfall import angles, in_words, parts
from torchbrdf.experiment.matching.training import evenly, find_loss, seen_by, training_loss
from torchbrdf.export.blender import BLENDER
from torchbrdf.export.gltf import GLTF
from torchbrdf.export.mtlx import OPENPBR
from torchbrdf.fitting.known import digest
from torchbrdf.lobes import FitRecord, Lambert, Sum, read_fits
from torchbrdf.losses import CompressedLoss
from torchbrdf.measured import Measured, load, standins
from torchbrdf.pairs import Pairs
from torchbrdf.perception import told_apart, uniform_pairs
from torchbrdf.render import Scene, sphere

TINY = Budget("tiny", (Candidate("ggx", 1), Candidate("ward", 1)), None, size=8, views=1, all_of_them=True)


@pytest.fixture(scope="module")
def scenes():
    return {"ball": Scene(sphere(3), size=16, nodes=16, light_samples=32)}


@pytest.fixture(scope="module")
def nickel():
    return load(standins()).batch([6])


def tried(model, lobes, *delta_e76, loss="learned"):
    record = FitRecord("paint", model, lobes, {}, loss=loss)
    return Tried(Candidate(model, lobes), record, {str(k): Figures({"delta_e76": x}) for k, x in enumerate(delta_e76)})


@pytest.mark.parametrize(
    ("fits", "expected"),
    [
        ([("ggx", 1, 0.5, 0.6), ("ggx", 2, 0.1, 0.1)], 0),  # neither can be told: the simpler
        ([("ggx", 1, 0.5, 0.9), ("ggx", 2, 0.3, 0.3)], 1),  # the first can, in one of the scenes
        ([("ggx", 1, 3.0, 3.0), ("ggx", 2, 2.9, 2.9), ("ggx", 3, 2.95, 2.95)], 0),  # as good as the best
        ([("ggx", 1, 3.0, 3.0), ("ggx", 2, 2.0, 2.0), ("ggx", 3, 2.05, 1.9)], 1),
        ([("ggx", 1, 2.0, 2.0), ("ggx", 1, 1.95, 1.95), ("ggx", 2, 1.94, 1.94)], 1),  # of one model the nearest
    ],
)
def test_the_simplest_that_cannot_be_told_or_the_best(fits, expected):
    made = [tried(*one) for one in fits]
    order = ranked(made)
    assert order[0] is made[expected]
    rest = [one.means.mean for one in order[1:]]
    assert len(order) == len(made) and rest == sorted(rest)


def test_shares_are_those_of_all_commands():
    """Who guesses is not counted."""
    assert Figures({"delta_e76": 1.4}).told == told_apart("delta_e76", 1.4)
    assert Figures({"delta_e76": 0.0}).told.value == 0


def test_budgets():
    assert find_budget("120").seconds == 120 and find_budget("120").candidates == BUDGETS["default"].candidates
    for text in ("", "much", "nan", "0", "-3", "inf"):
        with pytest.raises(UsageError, match="expected quick, default, thorough or a number of seconds"):
            find_budget(text)
    for budget in BUDGETS.values():
        sizes = [sum(value.numel() for value in one.make().state_dict().values()) for one in budget.candidates]
        assert sizes[0] == min(sizes)


def test_a_match_is_found_again_without_fits(tmp_path, nickel, scenes, monkeypatch):
    calls = []
    (first,) = find_matches([nickel], "mitsuba", TINY, out=tmp_path, scenes=scenes, progress=lambda *x: calls.append(x))
    assert {one.record.model for one in first.tried} == {"ggx", "ward"}
    assert calls[-1] == (2, 2)
    assert first.chosen.means.mean == min(one.means.mean for one in first.tried)
    assert first.chosen.means.mean < 5

    def refuse(*_args, **_settings):
        raise AssertionError("nothing is fitted again")

    monkeypatch.setattr("torchbrdf.fitting.blocks.fit", refuse)
    (again,) = find_matches([nickel], "mitsuba", TINY, out=tmp_path, scenes=scenes)
    assert again.chosen.record == first.chosen.record and again.chosen.figures == first.chosen.figures


def test_another_material_of_the_same_name_is_refused(tmp_path, nickel, scenes):
    find_matches([nickel], "mitsuba", TINY, out=tmp_path, scenes=scenes)
    other = load(standins()).batch([5])
    other.source.names[5] = "nickel"
    with pytest.raises(DataError, match=r"nickel: expected the material that .* has, found another"):
        find_matches([other], "mitsuba", TINY, out=tmp_path, scenes=scenes)


def test_what_cannot_be_matched_leaves_the_others_be(nickel, scenes):
    angle = torch.rand(1, 50)
    pairs, none = Pairs.from_half_diff(angle, angle, angle), torch.zeros(1, 50, 1)
    samples = Measured.from_samples(pairs, torch.rand(1, 50, 3), none, names=["loose"])
    bad = []
    found = find_matches([samples, nickel, nickel], "mitsuba", TINY, scenes=scenes, bad=bad)
    assert [one.material for one in found] == ["nickel"]
    assert "loose:" in str(bad[0]) and re.search(r"nickel: comes twice, in .*\.json and .*\.json; give", str(bad[1]))
    with pytest.raises(DataError, match="loose: "):
        find_matches([samples], "mitsuba", TINY, scenes=scenes)


def test_nothing_is_tried_after_what_cannot_be_told(nickel, scenes, monkeypatch):
    monkeypatch.setattr(matching.search, "CANNOT_BE_TOLD", 0.9)
    (found,) = find_matches([nickel], "mitsuba", replace(TINY, all_of_them=False), scenes=scenes)
    assert [one.record.model for one in found.tried] == ["ggx"]


def test_time_is_up_after_the_first_candidate(nickel, scenes):
    (found,) = find_matches([nickel], "mitsuba", replace(TINY, seconds=1e-6), scenes=scenes)
    assert [one.record.model for one in found.tried] == ["ggx"]
    assert found.untried == len(TINY.candidates) - 1


def test_a_target_with_a_model_of_its_own_gets_that(monkeypatch):
    monkeypatch.setattr(matching.candidates, "OWN_MODEL", {"gltf": ("ward", "not_there"), "mtlx": ("not_there",)})
    assert matching.candidates_for("gltf", TINY) == (Candidate("ward"),)
    assert matching.candidates_for("mtlx", TINY) == TINY.candidates


def test_a_target_s_own_model_is_what_its_file_shows():
    """Another one would be refitted when it is written."""
    for target in (GLTF, OPENPBR, BLENDER):
        assert matching.candidates_for(target.name, TINY) == (Candidate(target.model),)


def test_a_material_among_larger_ones_is_the_one_alone(tmp_path):
    for name, size in (("large", 20), ("small", 8)):
        (tmp_path / f"{name}.bsdf").write_bytes(tensor_file(synthetic_bsdf(size=size)))
    both, alone = load([tmp_path / "large.bsdf", tmp_path / "small.bsdf"]), load(tmp_path / "small.bsdf")
    assert digest(both.batch([1])) == digest(alone) != digest(both.batch([0]))


def test_where_a_match_is_bad(scenes):
    record = read_fits(standins())[6]
    judge = Judge(load(standins()).batch([6]), scenes)
    assert in_words(parts(judge, record), angles(judge, record)) == ["Nothing stands out."]
    found = parts(judge, Sum(Lambert(albedo=0.9)))
    assert sum(one.share for one in found) == pytest.approx(1) and sum(one.pixels for one in found) == pytest.approx(1)
    words = in_words(found, angles(judge, Sum(Lambert(albedo=0.9))))
    assert any("too light" in line for line in words) and any("degrees" in line for line in words)


def test_losses_of_values_see_all_directions(nickel, tmp_path):
    path = tmp_path / "made-up.bsdf"
    path.write_bytes(tensor_file(synthetic_bsdf()))
    found = evenly(load(path))
    assert found.names == ["made-up"] and found.values.shape == (1, 20_000, 3)
    torch.testing.assert_close(found.values, load(path).reciprocal_at(found.pairs))
    again = pickle.loads(pickle.dumps(found))
    others = uniform_pairs(50).to(dtype=torch.float32)
    torch.testing.assert_close(again.reciprocal_at(others), load(path).reciprocal_at(others.unsqueeze()))
    pictures = training_loss(8, 1)
    table, values, both = nickel, CompressedLoss(), find_loss("compressed+rendered", pictures)
    assert [seen_by(loss, table) is table for loss in (values, pictures, both)] == [True, True, False]
    assert [seen_by(loss, load(path)).source.format for loss in (values, pictures, both)] == [
        "samples",
        "rgl",
        "samples",
    ]


def test_losses_by_their_names():
    pictures = training_loss(8, 1)
    assert find_loss("rendered", pictures) is pictures
    assert find_loss("log", pictures).registered_name == "log"
    assert find_loss("log+rendered", pictures).registered_name == "log+rendered_delta_e76"
    assert {name for one in BUDGETS["default"].candidates for name in one.losses(BUDGETS["default"])} == {
        "learned", "rendered", "compressed", "log", "compressed+rendered",
    }  # fmt: skip


def test_fits_under_both_are_found_again(tmp_path, nickel, scenes, monkeypatch):
    budget = replace(TINY, candidates=(Candidate("distribution_based", 1, ("compressed", "compressed+rendered")),))
    (first,) = find_matches([nickel], "mitsuba", budget, out=tmp_path, scenes=scenes)
    assert [one.record.loss for one in first.tried] == ["compressed", "compressed+rendered_delta_e76"]
    monkeypatch.setattr("torchbrdf.fitting.blocks.fit", None)
    (again,) = find_matches([nickel], "mitsuba", budget, out=tmp_path, scenes=scenes)
    assert [one.record for one in again.tried] == [one.record for one in first.tried]
