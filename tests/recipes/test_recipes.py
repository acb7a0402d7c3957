"""Recipes: settings, folders, resuming, and every recipe in its quick form."""

import json
import math
import re
from collections import Counter
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchbrdf.errors import DataError, UsageError
from torchbrdf.files import is_passing, locked, write_text
from torchbrdf.measured import PAPER_TEN, load, standins
from torchbrdf.recipe import RECIPES, Recipe, configure, describe, find_recipe, parse, run
from torchbrdf.study import MEASURED, Plan, read_answers, simulated


@dataclass(frozen=True)
class Toy(Recipe):
    """Counts how often it ran."""

    name = "toy"
    number: int = 3
    share: float = 0.5
    names: tuple[str, ...] = ("a", "b")
    limit: int | None = 7

    def steps(self, folder):
        path = folder.path / "runs.txt"
        write_text(path, (path.read_text() if path.exists() else "") + f"{self.number}\n")
        return path


def test_settings_are_typed():
    recipe = configure(Toy, {"number": "5", "share": "0.25", "names": "x, y,z", "limit": "none", "quick": "true"})
    assert recipe == Toy(number=5, share=0.25, names=("x", "y", "z"), limit=None, quick=True)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("number", "five", "toy: number: expected a whole number, found 'five'"),
        ("share", "half", "toy: share: expected a finite number, found 'half'"),
        ("quick", "maybe", "toy: quick: expected true or false, found 'maybe'"),
        ("number", "1" * 23, "toy: number: expected a whole number, found '1+'"),
        ("limit", "1" * 5000, r"toy: limit: expected a whole number, found '1+ \.\.\. 1+'$"),
        ("share", "nan", "toy: share: expected a finite number, found 'nan'"),
        ("share", "inf", "toy: share: expected a finite number, found 'inf'"),
        ("names", "a\0b", r"toy: names: expected printable characters, found 'a\\x00b'"),
        ("numbr", "5", "unknown setting of toy 'numbr'.*did you mean 'number'"),
    ],
)
def test_wrong_settings_are_refused_in_a_line(key, value, said):
    with pytest.raises(UsageError, match=said):
        configure(Toy, {key: value})


def numbers_of(kind: type[Recipe]) -> list[tuple[str, Any, Any]]:
    """The settings of a recipe that are numbers, with a low and a high bound."""
    hints = {name: str(hint) for name, hint in get_type_hints(kind).items()}
    numeric = [one for one in fields(kind) if re.search(r"\b(int|float)\b", hints[one.name])]
    return [(one.name, one.metadata.get("low"), one.metadata.get("high")) for one in numeric]


SETTINGS = [(kind, *one) for kind in RECIPES.values() for one in numbers_of(kind)]


@pytest.mark.parametrize(
    ("kind", "key", "low", "high"), SETTINGS, ids=[f"{kind.name}-{key}" for kind, key, *_ in SETTINGS]
)
def test_every_number_has_bounds_that_hold(kind, key, low, high):
    assert low is not None and high is not None
    for text in ("nan", "inf", "-inf", "1e999", "1" * 23, "9" * 5000, str(low - 2), str(high * 2 + 1), "x", "{}"):
        with pytest.raises(UsageError, match=rf"^{kind.name}: {key}: expected a (whole )?number from ") as caught:
            configure(kind, {key: text})
        assert len(str(caught.value)) < 200
    for value in (math.nan, math.inf, low - 2, high * 2 + 1, "x"):
        shown = (value, value) if isinstance(getattr(kind(quick=True), key), tuple) else value
        with pytest.raises(UsageError, match=rf"^{kind.name}: {key}: expected a (whole )?number from "):
            kind(quick=True, **{key: shown})


@pytest.mark.parametrize("text", ["none", "all", "0"])
def test_all_pairs_are_asked_for_in_any_words(text):
    assert configure(RECIPES["fores2012"], {"samples": text}).samples is None


@given(st.text())
def test_no_text_makes_parse_fail_in_another_way(text):
    for expected in (bool, int, float, int | None, tuple[int, ...]):
        try:
            parse(text, expected, "x")
        except UsageError as error:
            assert "expected" in str(error)


def test_a_run_records_what_repeats_it(tmp_path):
    run(Toy(number=4), tmp_path / "out")
    record = json.loads((tmp_path / "out" / "recipe.json").read_text())
    assert record["recipe"] == "toy"
    assert record["settings"]["number"] == 4 and record["settings"]["seed"] == 0
    assert {"python", "torch", "torchbrdf"} <= set(record["versions"])
    assert "toy begins" in (tmp_path / "out" / "log.txt").read_text()


def test_a_run_goes_on_in_its_own_folder_only(tmp_path):
    out = tmp_path / "out"
    run(Toy(), out)
    assert run(Toy(), out).read_text() == "3\n3\n"
    with pytest.raises(UsageError, match="holds a run with other settings"):
        run(Toy(number=9), out)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("x")
    with pytest.raises(UsageError, match="expected an empty folder"):
        run(Toy(), foreign)


def test_a_folder_where_another_process_runs_is_refused_in_a_line(tmp_path):
    with locked(tmp_path / "out"), pytest.raises(DataError, match="another process has been at work in it"):
        run(Toy(), tmp_path / "out")
    assert run(Toy(), tmp_path / "out").read_text() == "3\n"
    assert not any(is_passing(path) for path in (tmp_path / "out").iterdir())


def test_a_run_that_was_killed_as_it_began_is_taken_up(tmp_path):
    (tmp_path / ".lock").touch()
    (tmp_path / ".tmp-00000000-1-00000000.json").write_text("{")
    assert run(Toy(), tmp_path).read_text() == "3\n"


def test_a_folder_that_cannot_be_written_is_a_clear_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(DataError, match="cannot be written"):
        run(Toy(), tmp_path / "file" / "out")


def test_a_recipe_can_be_a_file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "from dataclasses import dataclass\n"
        "from torchbrdf.recipe import Recipe\n"
        "@dataclass(frozen=True)\n"
        "class Mine(Recipe):\n"
        "    '''Mine.'''\n"
        "    name = 'mine'\n"
        "    colour: str = 'red'\n"
        "    def steps(self, folder):\n"
        "        return folder.path / self.colour\n"
    )
    recipe = configure(find_recipe(str(path)), {"colour": "blue"})
    assert run(recipe, tmp_path / "out").name == "blue"
    with pytest.raises(UsageError, match="no such file"):
        find_recipe(str(tmp_path / "other.py"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import nowhere_at_all", r"cannot be loaded: ModuleNotFoundError: .* \(line 1\)"),
        ("\n1 +", "cannot be loaded: SyntaxError: .*line 2"),
        ("raise SystemExit(3)", "cannot be loaded: SystemExit: 3"),
        ("x = 1", "expected one subclass of Recipe, found 0"),
        ("from torchbrdf.recipe import Recipe\nclass R(Recipe): pass", "expected a name, such as name = 'mine', in R"),
    ],
)
def test_a_file_that_holds_no_recipe_is_refused_in_a_line(tmp_path, text, said):
    (tmp_path / "mine.py").write_text(text)
    with pytest.raises(UsageError, match=said) as caught:
        find_recipe(str(tmp_path / "mine.py"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["7", "[]", "NaN", "{", "[" * 100_000, '{"recipe": "toy", "settings": 3}', "\xff"])
def test_a_recipe_json_that_is_none_is_refused_in_a_line(tmp_path, text):
    (tmp_path / "recipe.json").write_text(text, encoding="latin-1")
    with pytest.raises(
        (DataError, UsageError), match=r"recipe.json: expected the JSON object|other settings"
    ) as caught:
        run(Toy(), tmp_path)
    assert str(caught.value).startswith(str(tmp_path)) and "\n" not in str(caught.value)


def test_help_lists_every_setting():
    text = describe(Toy)
    for part in ("number=3", "names=a,b", "limit=7", "seed=0"):
        assert part in text


def test_the_bundled_stand_ins_are_the_papers_ten():
    measured = load(standins())
    assert sorted(measured.names) == sorted(PAPER_TEN)
    assert measured.stand_in


WHOLE = {"report.html", "fits.json", "fits.csv", "renders", "figures", "tonemap.json"}
QUICK = {
    "fores2012": WHOLE | {"study.json", "simulated.csv"},
    "image_vs_analytic": WHOLE,
    "human_benchmark": {"report.html", "scores.json", "scores.csv", "distances", "discrimination.json", "figures"},
}


def test_an_unknown_name_is_said_before_a_folder_is_written():
    for settings in ({"losses": ("nope",)}, {"models": ("nope",)}, {"strategy": "nope"}):
        with pytest.raises(UsageError, match=r"unknown .* 'nope'"):
            find_recipe("fores2012")(**settings)


# Fewer pairs to fit than quick ones have, and fewer models.
FEWER = {
    "fores2012": {"samples": "200", "max_theta": "40", "models": "ward,ashikhmin_shirley"},
    "image_vs_analytic": {"samples": "200", "max_theta": "40"},
}


@pytest.mark.slow  # the study below is a small one that always runs
@pytest.mark.parametrize("name", list(RECIPES))
def test_every_recipe_runs_in_its_quick_form(name, tmp_path):
    out = tmp_path / name
    report = run(configure(RECIPES[name], {"quick": "true", **FEWER.get(name, {})}), out)
    assert report.is_file() and report.stat().st_size > 1000
    assert {"recipe.json", "log.txt"} | QUICK.get(name, set()) <= {path.name for path in out.iterdir()}
    assert not list(out.rglob(".*"))  # nothing half-written is left


# Few pairs to fit and to score.
FEW_SETTINGS = {"quick": "true", "models": "ward", "samples": "500", "max_theta": "30", "size": "32"}
# A quick study compares strategies only where another than its default is asked for.
SMALL = FEW_SETTINGS | {"lobes": "1", "strategy": "staged", "compare_strategy": "global"}


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("study") / "out"
    run(configure(RECIPES["fores2012"], SMALL), out)
    return out


def test_a_study_has_a_record_for_every_fit(study):
    records = json.loads((study / "fits.json").read_text())
    keys = {(r["material"], r["model"], r["loss"], r["lobes"], r["strategy"]) for r in records}
    assert len(keys) == len(records) == 2 * 1 * 3 * (2 + 1)
    for record in records:
        assert set(record["errors"]) == {"rms", "cosine_rms", "cube_root"}
        assert record["errors"][record["loss"]] == pytest.approx(record["error"], rel=1e-6)
        beaten = any(
            other["errors"][record["loss"]] < record["error"] * (1 - 1e-4)
            for other in records
            if all(other[key] == record[key] for key in ("material", "lobes", "strategy"))
        )
        assert record["outlier"] == beaten
        assert ("differences" in record) == (record["lobes"] == 1)


def test_a_report_is_one_file_that_shows_every_picture(study):
    page = (study / "report.html").read_text()
    assert "http://" not in page and 'src="renders' not in page
    assert page.count("data:image/webp") == 2 * (1 + 1 + 3)  # reference, turned, three fits
    assert "Stand-ins." in page and "1 lobe or 2" in page
    assert "Global beside staged" in page and "Does lower error look better?" in page
    assert (study / "figures" / "strategies.png").stat().st_size > 1000


def test_a_report_shows_what_simulated_observers_say_and_that_they_are_no_people(study):
    page = (study / "report.html").read_text()
    assert page.count("simulated observers: not people") == 2
    for words in ("Experiment 1: models and error metrics", "Experiment 2: models under", "Is the cube root at least"):
        assert words in page
    assert all((study / "figures" / f"scales-{k}.png").stat().st_size > 1000 for k in (1, 2))
    answers = read_answers(study / "simulated.csv")
    assert simulated(answers) and Counter(a.experiment for a in answers) == {"1": 15 * 2 * 3, "2": 20 * 2 * 1}


def test_the_plan_of_a_study_is_served_as_it_is(study):
    plan = Plan.load(study)
    first, second = plan.experiments
    assert first.stimuli == ("ward-rms", "ward-cosine_rms", "ward-cube_root") and second.stimuli[-1] == MEASURED
    assert "stand-in" in plan.mark
    records = json.loads((study / "fits.json").read_text())
    for material in plan.materials:
        assert material.reference == f"renders/{material.name}-turned.png"
        assert material.stimuli[MEASURED].picture == f"renders/{material.name}-reference.png"
        for record in records:
            if record["material"] == material.name and "differences" in record:
                compared = "-global" if record["strategy"] == "global" else ""
                stimulus = material.stimuli[f"ward-{record['loss']}{compared}"]
                assert stimulus.picture == f"renders/{material.name}-ward-{record['loss']}{compared}.png"
                assert stimulus.difference == record["differences"]["delta_e76"]
                assert stimulus.outlier == record["outlier"]


@pytest.mark.slow
def test_a_recipe_can_say_other_words_and_screen(tmp_path):
    fores2012 = RECIPES["fores2012"]

    class Ours(fores2012):
        texts: ClassVar = {"consent": "Take part?"}
        screening: ClassVar = {"colour_vision": ("normal",)}

    settings = FEW_SETTINGS | {"losses": "rms", "compare_strategy": "none"}
    run(configure(Ours, settings), tmp_path / "out")
    plan = Plan.load(tmp_path / "out")
    assert plan.text("consent") == "Take part?" and plan.screening == {"colour_vision": ("normal",)}
    assert [experiment.name for experiment in plan.experiments] == ["2"]  # there is nothing to compare in the first
    with pytest.raises(UsageError, match="observers: expected two numbers"):
        configure(fores2012, {"observers": "15"})


def test_a_study_takes_up_what_is_finished(study):
    before = {path: path.stat().st_mtime_ns for path in (study / "renders").glob("*.exr")}
    (study / "renders" / "aluminium-turned.exr").unlink()
    run(configure(RECIPES["fores2012"], SMALL), study)
    again = {path: path.stat().st_mtime_ns for path in (study / "renders").glob("*.exr")}
    assert set(again) == set(before)
    assert {path.stem for path in before if again[path] != before[path]} == {"alum-bronze-turned", "aluminium-turned"}


def test_what_sees_pictures_stands_beside_what_does_not(tmp_path):
    """Rendered, combined and image-driven fits: their records, their rows in the report, and that they are kept."""
    names = ("cube_root", "compressed", "rendered_delta_e76", "compressed+rendered_delta_e76", "image_driven_delta_e76")
    settings = FEW_SETTINGS | {"lobes": "1", "losses": ",".join(names[:2]), "rendered": "delta_e76"}
    settings |= {"combined": "compressed"}
    recipe = configure(RECIPES["image_vs_analytic"], settings | {"train_size": "16", "differences": "delta_e76"})
    page = run(recipe, tmp_path / "out").read_text()
    records = json.loads((tmp_path / "out" / "fits.json").read_text())
    assert Counter(record["loss"] for record in records) == dict.fromkeys(names, 2)
    for record in records:
        chosen = record["loss"] == "image_driven_delta_e76"
        assert record["strategy"].startswith("ImageDriven" if chosen else "global") and ("chosen" in record) == chosen
        assert bool(record.get("scene")) == (record["loss"] not in names[:2])
        assert set(record["errors"]) == set(names) and set(record["pictures"]) == {"training", "unseen"}
        if chosen and record["chosen"] in names:
            same = [one for one in records if one["loss"] == record["chosen"] and one["material"] == record["material"]]
            assert record["parameters"] == same[0]["parameters"]
            others = [one["errors"]["rendered_delta_e76"] for one in records if one["material"] == record["material"]]
            assert sorted(others)[2] >= record["error"] * (1 - 1e-6)  # the rendered and the combined fit may be nearer
    for words in ("compressed + rendered ΔE 76", "What image-driven ΔE 76 chose", "Cost"):
        assert words in page
    run(recipe, tmp_path / "out")
    again = json.loads((tmp_path / "out" / "fits.json").read_text())
    assert [record["seconds"] for record in again] == [record["seconds"] for record in records]  # not made again


def test_a_bad_file_is_left_out_with_a_word(tmp_path, caplog):
    folder = tmp_path / "materials"
    folder.mkdir()
    (folder / "good.json").write_bytes(standins().read_bytes())
    (folder / "broken.binary").write_bytes(b"\x5a\x00\x00\x00\x5a\x00\x00\x00\xb4\x00\x00\x00")
    settings = FEW_SETTINGS | {"losses": "rms", "compare_strategy": "none", "materials": str(folder)}
    report = run(configure(RECIPES["fores2012"], settings), tmp_path / "out")
    assert "broken.binary" in caplog.text and "left out" in (tmp_path / "out" / "log.txt").read_text()
    assert "broken.binary" in report.read_text()


@pytest.mark.parametrize(("asked", "fitted"), [({"models": "ward,ggx"}, ("ward", "ggx")), ({}, ("ward",))])
def test_a_quick_run_leaves_out_only_models_that_nobody_asked_for(tmp_path, monkeypatch, asked, fitted):
    def make_grid(recipe, folder, groups, losses, *, models):
        raise RuntimeError(f"models {models}")

    monkeypatch.setattr(type(RECIPES["image_vs_analytic"]()), "make_grid", make_grid)
    small = {"quick": "true", "size": "16", "train_size": "16"}
    with pytest.raises(RuntimeError, match=re.escape(f"models {fitted}")):
        run(configure(RECIPES["image_vs_analytic"], small | asked), tmp_path / "out")
