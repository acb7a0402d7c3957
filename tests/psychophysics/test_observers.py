"""Kendall's coefficients beside published values and all tournaments; reports on observers who are made odd."""

import itertools
import math
import random

import numpy as np
import pytest
import torch
from scipy import stats

from torchbrdf.errors import DataError, UsageError
from torchbrdf.psychophysics import (
    Comparisons,
    agreement_with_others,
    circular_triads,
    consistence,
    kendall_agreement,
    observer_reports,
    observers,
    simulated_wins,
)
from torchbrdf.psychophysics.kendall import triads_by_chance
from torchbrdf.study import MEASURED, Answer


def tournaments(n):
    """All ways to judge every pair of n stimuli once, `(2^(n (n - 1) / 2), n, n)`."""
    pairs = list(itertools.combinations(range(n), 2))
    wins = torch.zeros(2 ** len(pairs), n, n).double()
    for k, choices in enumerate(itertools.product((0, 1), repeat=len(pairs))):
        for (i, j), first in zip(pairs, choices, strict=True):
            wins[k, i, j], wins[k, j, i] = first, 1 - first
    return wins


def counted(wins):
    """Circular triads, by looking at each triple."""
    n, found = wins.shape[-1], 0
    for a, b, c in itertools.combinations(range(n), 3):
        found += (
            wins[..., a, b] * wins[..., b, c] * wins[..., c, a] + wins[..., b, a] * wins[..., c, b] * wins[..., a, c]
        )
    return found


@pytest.mark.parametrize("n", [3, 4, 5])
def test_triads_of_all_tournaments(n):
    wins = tournaments(n)
    found = circular_triads(wins)
    torch.testing.assert_close(found, counted(wins))
    mean, variance = triads_by_chance(wins)
    torch.testing.assert_close(mean[0], found.mean())
    torch.testing.assert_close(variance[0], found.var(correction=0))
    zeta = consistence(wins)
    assert zeta.min() == 0 and zeta.max() == 1
    assert torch.equal(zeta == 1, found == 0)
    assert found.max() == {3: 1, 4: 2, 5: 5}[n]


def test_coefficients_are_not_known_where_pairs_are_missing_or_judged_twice():
    wins = torch.ones(4, 4).triu(1).double().expand(4, 4, 4).clone()
    wins[1, 0, 1] = 0
    wins[2, 1, 0] = 1
    wins[3, 3] = wins[3, :, 3] = 0  # three of four stimuli, each pair once
    assert circular_triads(wins).isnan().tolist() == [False, True, True, False]
    assert consistence(wins).tolist()[0] == 1 and consistence(wins).tolist()[3] == 1
    assert consistence(wins)[1:3].isnan().all()
    assert consistence(torch.ones(2, 2).triu(1).double()).isnan()


def judged(totals, judges):
    """Comparisons of one material in which totals[i, j] of the judges prefer i to j."""
    n = len(totals)
    wins = torch.zeros(judges, 1, n, n).double()
    for i, j in itertools.combinations(range(n), 2):
        wins[: totals[i][j], 0, i, j] = 1
        wins[totals[i][j] :, 0, j, i] = 1
    return Comparisons(["gold"], [[f"s{k}" for k in range(n)]], [f"o{k}" for k in range(judges)], wins)


def test_agreement_has_the_published_test():
    """The boys of Kendall and Babington Smith (1940): 21 judges, 13 school subjects, u = 0.1866.

    The R package eba (kendall.u) gives chi2 = 412.22, df = 90.75, p = 1.721e-42. The test depends on the counts only by
    the sum of agreeing pairs of judges, 9718 for this u: 7800 if all pairs are judged 11 to 10, 110 more for each
    that is unanimous, 42 for 17 to 4, and 6 for 13 to 8.
    """
    counts = [21] * 17 + [17, 13] + [11] * 59
    totals = [[0] * 13 for _ in range(13)]
    for (i, j), count in zip(itertools.combinations(range(13), 2), counts, strict=True):
        totals[i][j] = count
    found = kendall_agreement(judged(totals, 21))
    assert found.u.item() == pytest.approx(0.1866, abs=5e-5)
    assert found.chi_square.item() == pytest.approx(412.22, abs=5e-3)
    assert found.dof.item() == pytest.approx(90.75, abs=5e-3)
    assert found.p.item() == pytest.approx(1.721e-42, rel=1e-3)


@pytest.mark.parametrize(("judges", "least"), [(2, -1.0), (4, -1 / 3), (5, -1 / 5)])
def test_agreement_reaches_from_one_to_its_least(judges, least):
    assert kendall_agreement(judged([[0, judges, judges], [0, 0, judges], [0, 0, 0]], judges)).u.item() == 1
    half = judges // 2
    found = kendall_agreement(judged([[0, half, half], [0, 0, half], [0, 0, 0]], judges))
    assert found.u.item() == pytest.approx(least)
    assert found.p.isnan().item() == (judges < 3)


def test_agreement_by_chance_is_seldom_significant():
    generator = torch.Generator().manual_seed(0)
    wins = simulated_wins(torch.zeros(6).double(), torch.ones(10, 1000, 6, 6).double(), generator)
    names = [f"s{k}" for k in range(6)]
    found = kendall_agreement(
        Comparisons([f"m{k}" for k in range(1000)], [names] * 1000, [f"o{k}" for k in range(10)], wins)
    )
    assert found.u.mean().abs() < 0.01
    assert (found.p < 0.05).double().mean().item() == pytest.approx(0.05, abs=0.025)


def test_agreement_is_not_known_of_other_designs():
    comparisons = judged([[0, 3, 3], [0, 0, 3], [0, 0, 0]], 4)
    wins = comparisons.wins.clone()
    wins[0, 0, 0, 1] = wins[0, 0, 1, 0] = 0
    assert kendall_agreement(
        Comparisons(comparisons.materials, comparisons.stimuli, comparisons.observers, wins)
    ).u.isnan()
    wins[0, 0, 2] = wins[0, 0, :, 2] = 0
    wins[0, 0, 0, 1] = 1  # every pair of two stimuli, where the others judged three
    assert kendall_agreement(
        Comparisons(comparisons.materials, comparisons.stimuli, comparisons.observers, wins)
    ).u.isnan()
    wins[0] = 0  # one who did not judge this material at all does not count
    found = kendall_agreement(Comparisons(comparisons.materials, comparisons.stimuli, comparisons.observers, wins))
    same = kendall_agreement(comparisons.select([1, 2, 3]))
    assert found.u == same.u and found.p == same.p


MATERIALS, STIMULI = 6, 5


def study(count=15, choose=None, gap=0.7, materials=MATERIALS):
    """Answers of observers who see stimuli s0 to s4 so far apart, but for observer 0, who chooses by `choose`."""
    source = random.Random(5)
    answers = []
    for k in range(count):
        for m in range(materials):
            for i, j in itertools.combinations(range(STIMULI), 2):
                left, right = source.sample([i, j], 2)
                prefers_left = source.gauss(0, 1) < gap * (right - left)
                if k == 0 and choose is not None:
                    prefers_left = choose(left, right, source)
                shown = (f"observer {k}", "e", f"m{m}", f"s{left}", f"s{right}")
                answers.append(Answer(*shown, f"s{left if prefers_left else right}", 1 + k + 0.1 * m))
    return answers


def test_observers_who_are_alike_are_not_flagged():
    reports = observer_reports(study())
    assert [report.observer for report in reports] == [f"observer {k}" for k in range(15)]
    assert all(report.flags == [] for report in reports)
    assert all(report.trials == MATERIALS * 10 for report in reports)
    assert reports[3].seconds == pytest.approx(4.25)
    assert all(report.repeats == report.catches == 0 for report in reports)


def test_nobody_is_flagged_for_stimuli_that_all_see_alike():
    """Though everybody chooses by chance, and has as many circular triads as that makes."""
    reports = observer_reports(study(gap=0.0))
    assert sum(sum(report.triads.values()) for report in reports) > 0.2 * 15 * MATERIALS * 10
    assert all(report.flags == [] for report in reports)


@pytest.mark.parametrize(
    ("choose", "words"),
    [
        (lambda left, right, source: source.random() < 0.5, ["less than they should"]),
        (lambda left, right, source: left > right, ["less than they should"]),
        (lambda left, right, source: True, ["less than they should", "chose the left side in 100 % of 60 trials"]),
    ],
    ids=["guesses", "reversed", "left"],
)
def test_who_is_odd_is_flagged_and_nobody_else(choose, words):
    reports = observer_reports(study(choose=choose))
    assert len(reports) == 15
    for word in words:
        assert any(word in flag for flag in reports[0].flags)
    assert all(report.flags == [] for report in reports[1:])


def test_who_goes_round_in_circles_is_flagged_where_there_are_enough_triples():
    guesses, *others = observer_reports(study(choose=lambda left, right, source: source.random() < 0.5, materials=25))
    assert any("of 250 triples, no fewer than by chance" in flag for flag in guesses.flags)
    assert all(report.flags == [] for report in others)


def test_repeats_and_catch_trials_are_counted():
    answers = study(4)
    first = [answer for answer in answers if answer.observer == "observer 0"][:5]
    for k, answer in enumerate(first):
        chosen = answer.rejected if k == 4 else answer.chosen
        answers.append(Answer("observer 0", "e", answer.material, answer.right, answer.left, chosen, kind="repeat"))
    answers.append(Answer("observer 0", "e", "m0", "s0", "never shown", "s0", kind="repeat"))
    for observer, missed in (("observer 0", 1), ("observer 1", 3)):
        for k in range(4):
            chosen = "s4" if k < missed else MEASURED
            answers.append(Answer(observer, "e", "m0", "s4", MEASURED, chosen, kind="catch"))
    zero, one, *others = observer_reports(answers)
    assert (zero.repeats, zero.repeats_same, zero.catches, zero.missed) == (5, 4, 4, 1)
    assert (one.repeats, one.catches, one.missed) == (0, 4, 3)
    assert zero.flags == [] and one.flags == ["missed 3 of 4 catch trials"]
    assert all(other.catches == 0 for other in others)
    # Neither counts for scales.
    assert all(MEASURED not in names for names in Comparisons.from_answers(answers).stimuli)


def test_sides_and_triads_are_those_of_the_answers():
    answers = study(3)
    report = observer_reports(answers)[1]
    own = [answer for answer in answers if answer.observer == "observer 1"]
    lefts = sum(answer.chosen == answer.left for answer in own)
    assert report.left == lefts / len(own)
    assert report.left_p == pytest.approx(stats.binomtest(lefts, len(own)).pvalue)
    comparisons = Comparisons.from_answers(answers)
    assert report.triads == {f"m{m}": counted(comparisons.wins[1, m]).item() for m in range(MATERIALS)}
    assert report.consistence == pytest.approx({name: 1 - triads / 5 for name, triads in report.triads.items()})


def test_what_is_not_known_is_nan():
    answers = [Answer("ann", "e", "m", "a", "b", "a"), Answer("ann", "e", "m", "b", "c", "b")]
    (report,) = observer_reports(answers)
    assert math.isnan(report.likelihood_z) and math.isnan(report.seconds)
    assert math.isnan(report.triads["m"]) and math.isnan(report.consistence["m"])
    assert report.flags == []


def test_reports_are_on_one_experiment():
    other = Answer("ann", "f", "m", "a", "b", "a")
    with pytest.raises(UsageError, match="expected the name of one experiment, found e, f"):
        observer_reports([*study(2), other])
    assert [report.observer for report in observer_reports([*study(2), other], "f")] == ["ann"]
    with pytest.raises(DataError, match="expected answers to trials, found none"):
        observer_reports([])


def simulated_study(scales, count, seed, own=0.0):
    """Comparisons of observers who judge each pair once: a material for each scale `(M, n)`."""
    generator = torch.Generator().manual_seed(seed)
    materials, n = scales.shape
    taste = own * torch.randn(count, materials, n, generator=generator).double()
    wins = simulated_wins(scales + taste, torch.ones(count, materials, n, n).double(), generator)
    names = [f"s{k}" for k in range(n)]
    return Comparisons([f"m{k}" for k in range(materials)], [names] * materials, [f"o{k}" for k in range(count)], wins)


@pytest.mark.parametrize("own", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("gap", [0.0, 0.5, 1.0])
def test_few_who_are_alike_look_odd(gap, own):
    """Also where stimuli are alike, and where each observer has preferences: at most 3 % of z below -3."""
    scales = gap * torch.arange(6).double().expand(8, 6)
    z = torch.cat([agreement_with_others(simulated_study(scales, 15, seed, own)) for seed in range(20)])
    assert (z < -3).double().mean() <= 0.03
    assert 0.7 < z.std() < 1.3 and z.mean().abs() < 0.3


def test_the_likelihood_is_standardised_as_by_simulation(monkeypatch):
    """Before the median is subtracted: with many others, of mean 0 and variance 1 under the true scales."""
    scales = torch.tensor([[0.9, 0.2, 0.0, -1.1]]).double()
    found = observers._likelihoods(simulated_study(scales, 4000, 1), 1.5)
    assert found.mean().item() == pytest.approx(0, abs=0.05)
    assert found.std().item() == pytest.approx(1, abs=0.05)
    own = simulated_study(scales, 40, 2)
    together = agreement_with_others(own)
    monkeypatch.setattr(observers, "CHUNK", 1)
    torch.testing.assert_close(agreement_with_others(own), together, rtol=0, atol=1e-9)


def test_the_likelihood_by_hand():
    """Two stimuli: 30 observers prefer the first, 10 the second; nothing but a logarithm differs."""
    wins = torch.zeros(40, 1, 2, 2).double()
    wins[:30, 0, 0, 1] = wins[30:, 0, 1, 0] = 1
    found = observers._likelihoods(Comparisons(["m"], [["a", "b"]], [f"o{k}" for k in range(40)], wins), 1e4)
    share = 30 / 39  # of the others, for one who prefers the second
    apart = stats.norm.ppf(share)
    variance = share * (1 - share) / 39 / stats.norm.pdf(apart) ** 2
    p = stats.norm.cdf(apart / np.sqrt(1 + variance))
    expected = (math.log(1 - p) - p * math.log(p) - (1 - p) * math.log(1 - p)) / (
        math.sqrt(p * (1 - p)) * abs(math.log(p / (1 - p)))
    )
    np.testing.assert_allclose(found[30:], expected, rtol=1e-5)
