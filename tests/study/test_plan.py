"""Plans, trials and answers: what is asked, in which order, and how answers are kept."""

import json
import os
from collections import Counter
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchbrdf.errors import DataError, UsageError
from torchbrdf.study import (
    MEASURED,
    Experiment,
    Material,
    Plan,
    Stimulus,
    trials,
)
from torchbrdf.study.design import mirrored

NINE = tuple(f"{model}-{loss}" for model in ("ward", "cook", "ash") for loss in ("rms", "cosine_rms", "cube_root"))


def made(stimuli=NINE, materials=10, seed=0, **more):
    """A plan of one experiment."""
    shown = tuple(
        Material(
            f"m{k}",
            f"m{k}-turned.png",
            {name: Stimulus(f"m{k}-{name}.png", difference=float(d)) for d, name in enumerate(stimuli)},
        )
        for k in range(materials)
    )
    return Plan(shown, (Experiment("1", "all", tuple(stimuli), **more),), seed=seed)


def asked(plan, index):
    return trials(plan, plan.experiments[0], index)


def pair_of(trial):
    return trial.material, frozenset((trial.left, trial.right))


def test_the_papers_experiments_have_360_and_60_trials():
    first, second = made(), made(("ward", "cook", "ash", MEASURED))
    assert len(asked(first, 0)) == 360 and len(asked(second, 3)) == 60
    pairs = {(f"m{k}", frozenset(pair)) for k in range(10) for pair in combinations(NINE, 2)}
    assert {pair_of(trial) for trial in asked(first, 0)} == pairs


@given(st.integers(2, 9), st.integers(0, 40), st.integers(0, 5))
def test_every_stimulus_stands_on_either_side_as_often(count, index, seed):
    plan = made(NINE[:count], 2, seed)
    shown = asked(plan, index)
    for material in ("m0", "m1"):
        left = Counter(trial.left for trial in shown if trial.material == material)
        right = Counter(trial.right for trial in shown if trial.material == material)
        assert all(abs(left[name] - right[name]) <= 1 for name in NINE[:count])


@pytest.mark.parametrize("couple", range(6))
def test_two_observers_see_each_pair_on_either_side_and_in_their_own_order(couple):
    plan = made(materials=3)
    first, second = asked(plan, 2 * couple), asked(plan, 2 * couple + 1)
    assert {(t.material, t.left, t.right) for t in first} == {(t.material, t.right, t.left) for t in second}
    assert [pair_of(t) for t in first] != [pair_of(t) for t in second]


def test_the_same_seed_asks_the_same_and_another_asks_otherwise():
    assert asked(made(), 7) == asked(made(), 7)
    assert asked(made(), 7) != asked(made(seed=1), 7)
    assert asked(made(), 7) != asked(made(), 8)


@given(st.integers(5, 12), st.data())
def test_with_many_stimuli_each_meets_a_few_and_all_are_joined(count, data):
    names = tuple(f"s{k}" for k in range(count))
    compare = data.draw(st.integers(2, count - 1))
    shown = asked(made(names, 1, compare=compare), data.draw(st.integers(0, 20)))
    pairs = [pair_of(trial)[1] for trial in shown]
    assert len(set(pairs)) == len(pairs)
    meets = Counter(name for pair in pairs for name in pair)
    assert set(meets.values()) <= {compare, compare + 1}
    assert sum(meets.values()) == compare * count + (compare * count) % 2
    joined, todo = {names[0]}, [names[0]]
    while todo:
        here = todo.pop()
        new = {name for pair in pairs if here in pair for name in pair} - joined
        joined |= new
        todo += new
    assert joined == set(names)


def test_couples_of_observers_meet_other_pairs():
    plan = made(materials=1, compare=2)
    chosen = [{pair_of(trial) for trial in asked(plan, k)} for k in range(40)]
    assert chosen[0] == chosen[1] and chosen[0] != chosen[2]
    assert len(set.union(*chosen)) == 36


def test_repeats_come_later_with_sides_changed_and_do_not_count():
    shown = asked(made(materials=4, repeats=30), 2)
    assert Counter(trial.kind for trial in shown) == {"trial": 144, "repeat": 30}
    for k, trial in enumerate(shown):
        if trial.kind == "repeat":
            first = next(
                j for j, other in enumerate(shown) if other.kind == "trial" and pair_of(other) == pair_of(trial)
            )
            assert first < k and shown[first].left == trial.right
    late = [k for k, trial in enumerate(shown) if trial.kind == "repeat"]
    assert min(late) > 30


def test_catch_trials_have_a_known_answer():
    shown = asked(made((*NINE[:3], MEASURED), 3, catch=5), 1)
    caught = [trial for trial in shown if trial.kind == "catch"]
    assert len(caught) == 5 and len(shown) == 23
    assert all({trial.left, trial.right} == {MEASURED, NINE[2]} for trial in caught)
    with pytest.raises(UsageError, match="catch trials: expected measured among the stimuli of m0"):
        made(catch=1)


def test_chosen_pairs_only():
    plan = made(pairs=((NINE[0], NINE[2]), (NINE[3], NINE[5])))
    assert len(asked(plan, 0)) == 20
    assert {pair_of(trial)[1] for trial in asked(plan, 0)} == {frozenset(NINE[:3:2]), frozenset(NINE[3:6:2])}


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"pairs": (("ward-rms", "ward-log"),)}, "pairs: expected two of its stimuli, found ward-rms and ward-log"),
        ({"pairs": (("ward-rms", "ward-rms"),)}, "pairs: expected two of its stimuli"),
        ({"compare": 9}, "compare: expected 2 to 8 of 9 stimuli, found 9"),
        ({"compare": 2, "pairs": (("ward-rms", "cook-rms"),)}, "expected pairs or compare, found both"),
        ({"repeats": -1}, "repeats: expected 0 to 100000, found -1"),
        ({"stimuli": ("ward-rms",)}, "stimuli: expected two or more"),
        ({"catch": 10**9}, "catch: expected 0 to 100000, found 1000000000"),
        ({"repeats": 10**400}, "repeats: expected 0 to 100000, found 1000000000 ... 00000"),
        ({"repeats": 99_999}, "at most 100000 trials an observer, found 100359: 36 pairs of 10 materials; `compare`"),
    ],
)
def test_experiments_that_cannot_be_are_refused(more, said):
    with pytest.raises(UsageError, match=said):
        made(**more)


def test_3001_stimuli_are_compared_with_a_few_others_each_or_not_at_all():
    names = tuple(f"s{k}" for k in range(3001))
    with pytest.raises(UsageError, match="expected at most 100000 trials an observer, found 4501500"):
        made(names, 1)
    plan = made(names, 1, compare=4)
    assert len(asked(plan, 0)) == plan.experiments[0].pair_count == 6002


@given(st.integers(3, 12), st.data())
def test_pairs_are_counted_before_they_are_made(count, data):
    names = tuple(f"s{k}" for k in range(count))
    compare = data.draw(st.one_of(st.none(), st.integers(2, count - 1)))
    plan = made(names, 1, compare=compare)
    assert len(asked(plan, 0)) == plan.experiments[0].pair_count


def test_plans_that_cannot_be_are_refused():
    plan = made(materials=2)
    with pytest.raises(UsageError, match="expected materials, each once"):
        Plan((plan.materials[0],) * 2, plan.experiments)
    with pytest.raises(DataError, match="expected a name"):
        Plan((Material("a\nb", "r.png", plan.materials[0].stimuli),), plan.experiments)
    with pytest.raises(UsageError, match="unknown text of a study 'welcome'"):
        Plan(plan.materials, plan.experiments, texts={"welcome": "hello"})
    with pytest.raises(UsageError, match="unknown stimulus of m0 'ward-log'"):
        Plan(plan.materials, (Experiment("1", "x", ("ward-log", "ward-rms")),))
    with pytest.raises(UsageError, match="unknown experiment '3'"):
        plan.experiment("3")


@pytest.fixture
def folder(tmp_path):
    for material in made(materials=2).materials:
        for picture in (material.reference, *(stimulus.picture for stimulus in material.stimuli.values())):
            (tmp_path / picture).write_bytes(b"png")
    return tmp_path


def test_a_plan_is_read_as_it_was_written(folder):
    plan = made(materials=2, pairs=((NINE[0], NINE[1]),), repeats=2)
    plan = Plan(plan.materials, plan.experiments, 5, {"thanks": "Bye"}, {"colour_vision": ("normal",)})
    assert plan.save(folder) == folder / "study.json"
    assert Plan.load(folder) == plan
    assert plan.text("thanks") == "Bye" and plan.text("pause").startswith("Paused")


def test_a_plan_shows_only_pictures_of_its_folder(folder):
    plan = made(materials=2)
    plan.save(folder)
    (folder / "m0-turned.png").unlink()
    with pytest.raises(DataError, match=r"m0-turned\.png: no such picture"):
        Plan.load(folder)
    (folder / "m0-turned.png").symlink_to("/etc/hostname")
    with pytest.raises(DataError, match="expected pictures in"):
        Plan.load(folder)
    text = (folder / "study.json").read_text().replace("m0-turned.png", "../../etc/hostname")
    (folder / "study.json").write_text(text)
    with pytest.raises(DataError, match="expected pictures in"):
        Plan.load(folder)


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        (("seed",), 10**400, "seed: expected at most 1e+32, found"),
        (("seed",), 1.5, "expected `int`, got `float` - at `$.seed`"),
        (("mark",), None, "expected `str`, got `null` - at `$.mark`"),
        (("texts",), {"title": None}, "expected `str`, got `null` - at `$.texts"),
        (("texts",), {"title": "a\0b"}, "text 'title': expected printable lines, found 'a\\x00b'"),
        (("texts",), {"title": "a\x1cb"}, "text 'title': expected printable lines, found 'a\\x1cb'"),
        (("texts",), {"titel": "x"}, "unknown text of a study 'titel'; expected one of"),
        (("screening",), {"color": ["normal"]}, "unknown self-report to screen by 'color'; expected one of acuity"),
        (("screening",), {"room": [["dark"]]}, "expected `str`, got `array`"),
        (("screening",), {"room": ["bleak"]}, "unknown answer to room 'bleak'; expected one of bright, dark, dim"),
        (("colour",), 1, "unknown key of a plan 'colour'; expected one of experiments, mark"),
        (("materials", 0, "a\nb"), 1, "unknown key of materials[0] 'a\\nb'; expected one of name, order, reference"),
        (("materials", 0, "name"), "../m", "expected a name (one line, no path, at most 200 bytes), found '../m'"),
        (("materials", 0, "order"), 1e300, "order: expected a number up to 1e+12, found 1e+300"),
        (("materials", 1, "reference"), "m\0.png", "reference: expected one printable line, found 'm\\x00.png'"),
        (("materials", 1, "reference"), "x" * 5000, "expected a picture's path in"),
        (
            ("materials", 1, "stimuli", "ward-rms", "los"),
            "rms",
            "unknown key of materials[1].stimuli['ward-rms'] 'los'",
        ),
        (("materials", 1, "stimuli", "ward-rms", "outlier"), 1, "expected `bool`, got `int`"),
        (("materials", 1, "stimuli", "ward-rms", "difference"), 1e300, "difference: expected a number up to 1e+12"),
        (("experiments", 0, "catch"), 10**30, "catch: expected 0 to 100000, found"),
        (("experiments", 0, "pairs"), [["ward-rms"]], "expected `array` of length 2"),
        (("experiments", 0, "name"), "a/b", "experiment: expected a name"),
        (("experiments", 0, "title"), "a\nb", "title: expected one printable line, found 'a\\nb'"),
        (("experiments",), {}, "expected `array`, got `object` - at `$.experiments`"),
    ],
)
def test_what_a_plan_cannot_hold_is_named_with_the_file(folder, where, value, said):
    made(materials=2).save(folder)
    record = json.loads((folder / "study.json").read_text())
    *parents, last = where
    place = record
    for step in parents:
        place = place[step]
    place[last] = value
    (folder / "study.json").write_text(json.dumps(record))
    with pytest.raises(DataError, match=r"study\.json: ") as caught:
        Plan.load(folder)
    assert said in str(caught.value) and len(str(caught.value)) <= 300


def test_pictures_that_lead_nowhere_are_named(folder):
    made(materials=2).save(folder)
    (folder / "m0-turned.png").unlink()
    os.mkfifo(folder / "m0-turned.png")
    with pytest.raises(DataError, match=r"study\.json: m0-turned\.png: no such picture"):
        Plan.load(folder)
    (folder / "m0-turned.png").unlink()
    (folder / "m0-turned.png").symlink_to("m0-turned.png")
    with pytest.raises(DataError, match=r"study\.json: "):
        Plan.load(folder)


@given(
    text=st.one_of(
        st.text(),
        st.sampled_from(
            ["[" * 100_000, '{"seed": "\\ud800"}', "[]", "{}", '{"materials": 3}', "null", '{"materials": [{}]}']
        ),
    )
)
def test_no_text_makes_a_plan_fail_in_another_way(text, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    (folder / "study.json").write_text(text, encoding="utf-8", errors="replace")
    with pytest.raises(DataError, match=r"study\.json"):
        Plan.load(folder)


def test_a_folder_without_a_plan_says_what_to_do(tmp_path):
    with pytest.raises(DataError, match="run a recipe such as fores2012 first"):
        Plan.load(tmp_path)


def test_a_mirrored_trial_changes_sides_only():
    (trial, *_) = asked(made(materials=1), 0)
    assert mirrored(mirrored(trial)) == trial != mirrored(trial)
