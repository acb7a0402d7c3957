"""How many observers: beside scipy's exact test, and beside simulated studies that are scaled."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from torchbrdf.errors import UsageError
from torchbrdf.psychophysics import Comparisons, observers_needed, power_of, scale, simulated_wins


@settings(max_examples=20)
@given(difference=st.floats(-2, 2), observers=st.integers(1, 60), alpha=st.sampled_from([0.001, 0.01, 0.05, 0.1, 0.3]))
def test_two_stimuli_have_the_power_of_scipys_binomial_test(difference, observers, alpha):
    rejected = [k for k in range(observers + 1) if stats.binomtest(k, observers).pvalue <= alpha]
    expected = stats.binom.pmf(rejected, observers, stats.norm.cdf(difference)).sum()
    assert power_of(difference, observers, alpha) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("difference", "power", "alpha"), [(0.5, 0.8, 0.05), (0.25, 0.9, 0.05), (0.7, 0.8, 0.05)])
def test_any_larger_number_of_observers_is_enough_too(difference, power, alpha):
    needed = observers_needed(difference, power, alpha)
    powers = [power_of(difference, count, alpha) for count in range(1, 3 * needed)]
    assert min(powers[needed - 1 :]) >= power > powers[needed - 2]
    # The first number that is enough by chance is a smaller one: it is a saw-tooth.
    assert next(count for count, found in enumerate(powers, 1) if found >= power) < needed


def test_numbers_of_observers_are_near_those_of_the_normal_distribution():
    for difference in (0.03, 0.05, 0.1):
        p = stats.norm.cdf(difference)
        z, more = stats.norm.isf(0.025), stats.norm.ppf(0.8)
        expected = ((0.5 * z + more * np.sqrt(p * (1 - p))) / (p - 0.5)) ** 2
        assert observers_needed(difference) == pytest.approx(expected, rel=0.06)


def excluded(difference, observers, stimuli):
    """How often, of 3000 simulated studies, the interval of the difference of the two at the ends excludes 0."""
    generator = torch.Generator().manual_seed(2)
    truth = torch.linspace(0, difference, stimuli).double()
    wins = simulated_wins(truth, torch.ones(observers, 3000, stimuli, stimuli).double(), generator)
    names = [f"s{k}" for k in range(stimuli)]
    comparisons = Comparisons([f"m{k}" for k in range(3000)], [names] * 3000, [f"o{k}" for k in range(observers)], wins)
    found = scale(comparisons, draws=0)
    intervals = [found.difference(m, stimuli - 1, 0) for m in range(3000)]
    return np.mean([low > 0 or high < 0 for _, low, high in intervals])


@pytest.mark.parametrize(
    ("difference", "observers", "stimuli"),
    [(0.5, 20, 2), (1.0, 15, 2), (0.5, 15, 3), (0.5, 30, 3), (1.0, 10, 3), (0.5, 20, 4), (1.0, 8, 4), (0.7, 10, 6)],
)
def test_simulated_studies_tell_stimuli_apart_as_often(difference, observers, stimuli):
    expected = power_of(difference, observers, stimuli=stimuli)
    assert excluded(difference, observers, stimuli) == pytest.approx(expected, abs=0.06)


def test_more_stimuli_or_a_larger_difference_take_fewer_observers():
    for stimuli in (2, 3, 5, 9):
        needed = [observers_needed(difference, stimuli=stimuli) for difference in (0.1, 0.3, 0.6, 1.2, 2.0)]
        assert needed == sorted(needed, reverse=True) and needed[0] > needed[-1]
    by_stimuli = [observers_needed(0.4, stimuli=stimuli) for stimuli in (3, 4, 6, 9, 15)]
    assert all(more > fewer for more, fewer in itertools.pairwise(by_stimuli))
    assert power_of(0.4, by_stimuli[0], stimuli=3) >= 0.8 > power_of(0.4, by_stimuli[0] - 1, stimuli=3)


def test_without_a_difference_the_power_is_the_level():
    assert power_of(0.0, 40, stimuli=5) == pytest.approx(0.05)
    assert power_of(0.0, 40) <= 0.05
    assert power_of(-0.6, 25) == power_of(0.6, 25)
    assert power_of(-0.6, 25, stimuli=4) == power_of(0.6, 25, stimuli=4)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"difference": 0.0}, "other than 0"),
        ({"difference": 1e-4}, "takes some [0-9]+ observers or more"),
        ({"difference": float("nan")}, "difference: expected at most"),
        ({"difference": 3.0, "stimuli": 3}, "expected at most 2.5 units, found 3.0"),
        ({"difference": 1e-300}, "takes some 1000000000000000 observers or more"),
        ({"difference": 1e-9, "stimuli": 3}, "takes some [0-9]+ observers or more"),
        ({"difference": float("inf")}, "expected at most 10.0 units, found inf"),
        ({"difference": 1.0, "power": 1.0}, "expected more than alpha, 0.05, and at most 0.999999, found 1.0"),
        ({"difference": 1.0, "power": 1e-300}, "expected more than alpha, 0.05, and at most 0.999999, found 1e-300"),
        ({"difference": 1.0, "power": float("nan")}, "expected more than alpha"),
        ({"difference": 1.0, "alpha": 0.0}, "alpha: expected 1e-06 to 0.5, found 0.0"),
        ({"difference": 1.0, "alpha": 1e-300}, "alpha: expected 1e-06 to 0.5, found 1e-300"),
        ({"difference": 1.0, "stimuli": 1}, "stimuli: expected 2 to 1000, found 1"),
        ({"difference": 1.0, "stimuli": 3001}, "stimuli: expected 2 to 1000, found 3001"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, words):
    with pytest.raises(UsageError, match=words):
        observers_needed(**arguments)


@pytest.mark.parametrize("stimuli", [2, 3, 100])
@pytest.mark.parametrize("power", [0.5000001, 0.999999])
@pytest.mark.parametrize("alpha", [1e-6, 0.5])
@pytest.mark.parametrize("difference", [0.1, 2.5])
def test_at_the_ends_of_what_is_allowed_there_is_a_number(stimuli, power, alpha, difference):
    needed = observers_needed(difference, power, alpha, stimuli)
    assert 1 <= needed <= 100_000 and power_of(difference, needed, alpha, stimuli) >= power


def test_no_observers_have_no_power():
    with pytest.raises(UsageError, match="observers: expected 1 to 400000, found 0"):
        power_of(1.0, 0)
