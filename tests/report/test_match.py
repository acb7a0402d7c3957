"""`match`: what it writes, what its page shows, and what it says of bad input."""

import dataclasses
import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.measured_files import merl_centres, synthetic_raw, write_raw_merl

import torchbrdf
from torchbrdf.cli import main
from torchbrdf.errors import DataError, UsageError
from torchbrdf.experiment.matching import BUDGETS, Budget, Candidate, candidates
from torchbrdf.export import export
from torchbrdf.measured import load, standins
from torchbrdf.render import Scene, sphere
from torchbrdf.report import match as module

TINY = Budget("tiny", (Candidate("ggx", 1), Candidate("ward", 1)), None, size=8, views=1, all_of_them=True)
SENTENCE = (
    r"(\S+) as one (GGX|Ward) lobe: Delta E \d+\.\d \(\d+\.\d to \d+\.\d over two scenes\); about \d+ % of observers "
    r"would pick it out beside the original"
)


@pytest.fixture(scope="module")
def scenes():
    small = {"size": 16, "nodes": 16, "light_samples": 32}
    return {"ball": Scene(sphere(3), **small), "ball & <light>": Scene(sphere(2), **small)}


@pytest.fixture(scope="module")
def written(scenes, tmp_path_factory):
    """Two matches in a folder."""
    out = tmp_path_factory.mktemp("match")
    two = load(standins()).batch([6, 7])
    return out, torchbrdf.match(two, "mitsuba", out, budget=TINY, scenes=scenes)


def test_it_writes_a_material_a_page_and_a_list(written):
    out, found = written
    for name in ("nickel", "nylon"):
        root = ElementTree.parse(out / f"{name}.xml").getroot()
        assert root.tag == "bsdf" and root.attrib["version"] == "3.0.0"
    assert all(re.fullmatch(SENTENCE, one.sentence) for one in found)
    entries = json.loads((out / "match.json").read_text(encoding="utf-8"))
    assert [entry["material"] for entry in entries] == ["nickel", "nylon"]
    for entry, one in zip(entries, found, strict=True):
        assert entry["model"] == one.chosen.record.model and entry["parameters"] == one.chosen.record.parameters
        assert set(entry["scenes"]) == {"ball", "ball & <light>"}
        for figures in entry["scenes"].values():
            assert {"delta_e76", "delta_e_itp", "told_apart"} <= set(figures)
        assert [tried["model"] for tried in entry["candidates"]] == ["ggx", "ward"]
        assert [tried["chosen"] for tried in entry["candidates"]].count(True) == 1
        assert entry["files"][0] == f"{entry['material']}.xml" and entry["where"]


def test_nothing_is_exported_over_its_files(written):
    out, found = written
    before = (out / "nickel.xml").read_bytes()
    with pytest.raises(DataError, match=r"nickel.xml: expected another folder, found a match's file, which match.json"):
        export(found[0].chosen.record, "mitsuba", out, name="nickel")
    assert (out / "nickel.xml").read_bytes() == before
    assert main(["export", str(out / "match.json"), "--to", "mitsuba", "--out", str(out)]) == 1
    assert (out / "nickel.xml").read_bytes() == before


def test_its_list_is_a_list_of_fits(written):
    out, found = written
    assert torchbrdf.model_of([record := torchbrdf.read_fits(out / "match.json")[1]]).components()
    assert (record.material, record.model) == ("nylon", found[1].chosen.record.model)
    assert torchbrdf.load(out / "match.json").names == ["nickel", "nylon"]


def test_the_page_shows_each_match_beside_its_measurement(written):
    out, found = written
    page = (out / "match.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])
    assert len(data) == 2
    for block in data:
        for scene in block["scenes"]:
            pictures = [scene["reference"], *scene["fits"], *scene["maps"]]
            assert len(scene["fits"]) == len(scene["maps"]) == 2
            assert all(one.startswith("data:image/webp;base64,") for one in pictures)
    for one in found:
        assert one.sentence in page
        for line in one.words:
            assert line in page
    assert "ball &amp; &lt;light&gt;" in page and "ball & <light>" not in page.split("</main>")[0]
    assert "http" not in page.replace("http-equiv", "")
    assert page.count('class="chosen"') == 2


def test_a_folder_keeps_what_other_matches_left(written, scenes):
    out, _ = written
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.suffix in (".xml", ".bsdf")}
    (third,) = torchbrdf.match(load(standins()).batch([5]), "brdf", out, budget=TINY, scenes=scenes)
    entries = json.loads((out / "match.json").read_text(encoding="utf-8"))
    assert [(entry["material"], entry["target"]) for entry in entries] == [
        ("nickel", "mitsuba"), ("nylon", "mitsuba"), ("light-red-paint", "brdf"),
    ]  # fmt: skip
    page = (out / "match.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])
    assert len(data) == 3 and page.count("<section") == 3 and third.sentence in page
    assert "<h2>nickel for mitsuba</h2>" in page
    assert {name: (out / name).read_bytes() for name in before} == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere.binary"], "nowhere.binary"),
        (["bad.bsdf"], "bad.bsdf"),
        (["--for", "unreal"], "unknown exporter 'unreal'"),
        (["--budget", "much"], "budget"),
    ],
)
def test_what_is_refused_leaves_no_folder(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.bsdf").write_bytes(b"nothing")
    words = words if not words[0].startswith("--") else ["bad.bsdf", *words]
    assert main(["match", *words, "--out", "new/folder"]) != 0
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.bsdf"]


def test_a_list_that_is_none_is_said_before_the_work(tmp_path):
    (tmp_path / "match.json").write_text('[{"material": 3}]', encoding="utf-8")
    with pytest.raises(DataError, match=r"match\.json: expected a list of matches, from match, found"):
        torchbrdf.match(load(standins()).batch([6]), out=tmp_path, budget=TINY)
    assert [path.name for path in tmp_path.iterdir()] == ["match.json"]


def test_what_no_surface_does_is_said(written, scenes, monkeypatch):
    out, _ = written
    bright = load(standins()).batch([6])
    found = module.check(bright)[0]
    monkeypatch.setattr(module, "check", lambda _brdf: [dataclasses.replace(found, below_zero=0.5, lowest=-2.0)])
    (one,) = torchbrdf.match(bright, "mitsuba", out, budget=TINY, scenes=scenes)
    line = "has a channel below 0 at 50 % of directions, down to -2 / sr"
    assert one.warnings == [f"the measurement {line}", f"the match {line}"]
    assert one.warnings[0] in (out / "match.html").read_text(encoding="utf-8")
    assert json.loads((out / "match.json").read_text(encoding="utf-8"))[0]["warnings"] == one.warnings


def test_without_a_folder_nothing_is_written(scenes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (found,) = torchbrdf.match(load(standins()).batch([6]), budget=TINY, scenes=scenes)
    assert found.files == [] and found.figures == found.chosen.figures
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("count", "said"), [(1, "over one scene)"), (9, "over 9 scenes)")])
def test_scenes_of_ones_own(scenes, count, said):
    own = {f"ball {k}": scenes["ball"] for k in range(count)}
    (found,) = torchbrdf.match(load(standins()).batch([6]), budget=TINY, scenes=own)
    assert said in found.sentence
    with pytest.raises(UsageError, match="scenes: expected at least one"):
        torchbrdf.match(load(standins()).batch([6]), budget=TINY, scenes={})


def test_what_the_target_cannot_show_gives_way_to_the_next(scenes, tmp_path, monkeypatch):
    real = module.material_of

    def picky(record, *rest, **options):
        if record is refused[0]:
            raise torchbrdf.errors.DataError("no such model there")
        return real(record, *rest, **options)

    refused = [None]
    one = load(standins()).batch([6])
    (before,) = torchbrdf.match(one, budget=TINY, scenes=scenes)
    monkeypatch.setattr(module, "material_of", picky)
    monkeypatch.setattr(module, "find_matches", lambda *_args, **_options: [before.match])
    refused[0] = before.chosen.record
    (found,) = torchbrdf.match(one, "mitsuba", tmp_path, budget=TINY, scenes=scenes)
    assert found.chosen is before.match.ranked[1] and found.files


def test_unknown_words(tmp_path):
    for options, said in (
        ({"target": "povray"}, "unknown exporter 'povray'"),
        ({"budget": "much"}, "budget: expected quick, default, thorough or a number of seconds, found 'much'"),
    ):
        with pytest.raises(UsageError, match=re.escape(said)):
            torchbrdf.match(load(standins()).batch([6]), out=tmp_path, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def small_command(scenes, monkeypatch):
    """The command, in small scenes."""
    monkeypatch.setattr(candidates, "BUDGETS", {**BUDGETS, "tiny": TINY})
    monkeypatch.setattr("torchbrdf.experiment.matching.search.unseen_scenes", lambda **_options: scenes)
    return lambda *words: main(["match", *map(str, words), "--budget", "tiny"])


def test_one_bad_file_spoils_nothing(small_command, merl_file, tmp_path, capsys):
    bad = tmp_path / "bad.binary"
    bad.write_bytes(merl_file.read_bytes()[:1000])
    assert small_command(merl_file, bad, "--out", tmp_path / "out") == 1
    said = capsys.readouterr()
    errors = [line for line in said.err.splitlines() if "left out" in line]
    assert len(errors) == 1 and str(bad) in errors[0] and len(errors[0]) < 350
    assert re.match(SENTENCE, said.out.splitlines()[0])
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"made-up.xml", "match.html", "match.json", "fits"} <= names
    assert not any(name.startswith(".tmp") for name in names)
    assert str(bad) in (tmp_path / "out" / "match.html").read_text(encoding="utf-8")


def test_a_file_that_reaches_60_degrees_is_said_to(small_command, tmp_path, capsys):
    theta_h, theta_d, phi_d = merl_centres()
    high, across = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    raw = synthetic_raw()
    raw[:, np.minimum(high - across, high + across) < 0.5] = -1.0
    short = write_raw_merl(tmp_path / "short.binary", raw)
    assert small_command(short) == 0
    said = "the measurement was measured only to 60 degrees from the normal; beyond, values are extrapolated"
    assert f"  ! {said}" in capsys.readouterr().out.splitlines()


def test_a_folder_that_cannot_be_written(small_command, merl_file, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert small_command(merl_file, "--out", tmp_path / "file") != 0
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("name", ["match.json", "match.html", "fits", "fits/pages"])
def test_what_stands_in_the_place_of_a_file_is_said_before_the_work(name, tmp_path, monkeypatch, capsys):
    place = tmp_path / name
    if place.suffix:
        place.mkdir()
    else:
        place.parent.mkdir(exist_ok=True)
        place.write_text("", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.setattr(module, "find_matches", lambda *_arguments, **_options: pytest.fail("the work was begun"))
    assert main(["match", str(standins()), "--out", str(tmp_path)]) != 0
    (said,) = capsys.readouterr().err.splitlines()
    assert re.search(rf"{name}(/pages)?: (expected|cannot be written)", said)
    assert sorted(tmp_path.rglob("*")) == before


def test_nothing_but_bad_files(small_command, tmp_path, capsys):
    (tmp_path / "bad.bsdf").write_bytes(b"nothing")
    assert small_command(tmp_path / "bad.bsdf", tmp_path / "nowhere", "--out", tmp_path / "out") == 1
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 2
