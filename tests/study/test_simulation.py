"""Simulated observers: what they see, choose, and are called."""

import math
from collections import Counter

import pytest
from helpers.simulated_plan import make_plan, wards
from scipy.stats import norm

from torchbrdf.errors import UsageError
from torchbrdf.study import simulate, simulated


def test_simulated_observers_choose_with_thurstones_probability():
    plan = make_plan({"nickel": {"ward-rms": 5.0, "ward-cube_root": 3.0, "ward-log": 3.5}})
    answers = simulate(plan, plan.experiment("1"), 3000, noise=2.0)
    assert len(answers) == 9000
    for better, worse, gap in (("ward-cube_root", "ward-rms", 2.0), ("ward-cube_root", "ward-log", 0.5)):
        own = [a.chosen == better for a in answers if {a.left, a.right} == {better, worse}]
        expected = norm.cdf(gap / (math.sqrt(2) * 2.0))
        assert abs(sum(own) / 3000 - expected) < 4 * math.sqrt(expected * (1 - expected) / 3000)
    lefts = Counter(a.chosen == a.left for a in answers)
    assert abs(lefts[True] - lefts[False]) < 4 * math.sqrt(9000)


def test_simulated_observers_are_seeded_and_named():
    plan = make_plan({"nickel": wards(5.0, 4.0, 3.0)})
    first, again = (simulate(plan, plan.experiment("1"), 4, seed=1) for _ in range(2))
    assert [(a.left, a.chosen) for a in first] == [(a.left, a.chosen) for a in again]
    other = simulate(plan, plan.experiment("1"), 4, seed=2)
    assert [a.left for a in first] == [a.left for a in other] and first != other
    assert simulated(first) and {a.observer for a in first} == {f"simulated-00{k}" for k in (1, 2, 3, 4)}


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"observers": 0}, "expected at least 1"),
        ({"observers": 10**9}, "expected at most [0-9]+ with [0-9]+ trials each, found 1000000000"),
        ({"observers": 2, "noise": 0.0}, "noise: expected"),
        ({"observers": 2, "noise": math.inf}, "noise: expected a number above 0 up to 1e6, found inf"),
        ({"observers": 2, "noise": math.nan}, "noise: expected"),
    ],
)
def test_simulations_that_cannot_be_are_refused(more, said):
    plan = make_plan({"nickel": wards(5.0, 4.0, 3.0)})
    with pytest.raises(UsageError, match=said):
        simulate(plan, plan.experiment("1"), **more)


def test_a_difference_that_is_not_known_cannot_be_seen():
    plan = make_plan({"nickel": wards(5.0, None, 3.0)})
    with pytest.raises(UsageError, match="ward-cosine_rms of nickel: its difference is not known"):
        simulate(plan, plan.experiment("1"), 1)
