"""Scales beside published values, closed forms and scipy's maximum of the same likelihood."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import minimize

from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.psychophysics import (
    Comparisons,
    goodness,
    least_squares,
    map_estimate,
    scale,
    simulated_wins,
)
from torchbrdf.psychophysics.thurstone import LARGEST_PRIOR
from torchbrdf.study import Answer

# J. P. Guilford, Psychometric Methods, 1954: 148 people and nine vegetables, the share that preferred the column to the
# row, and the scale that he gives; both as in the R package psych, data set veg.
VEGETABLES = """
.500 .818 .770 .811 .878 .892 .899 .892 .926
.182 .500 .601 .723 .743 .736 .811 .845 .858
.230 .399 .500 .561 .736 .676 .845 .797 .818
.189 .277 .439 .500 .561 .588 .676 .601 .730
.122 .257 .264 .439 .500 .493 .574 .709 .764
.108 .264 .324 .412 .507 .500 .628 .682 .628
.101 .189 .155 .324 .426 .372 .500 .527 .642
.108 .155 .203 .399 .291 .318 .473 .500 .628
.074 .142 .182 .270 .236 .372 .358 .372 .500
"""
GUILFORD = (0.00, 0.52, 0.65, 0.98, 1.12, 1.14, 1.40, 1.44, 1.63)


def vegetables():
    """Wins `(9, 9)` of 148 people."""
    win_rates = torch.tensor(
        [[float(cell) for cell in row.split()] for row in VEGETABLES.strip().splitlines()]
    ).double()
    return 148 * (win_rates - torch.diag(win_rates.diagonal())).mT


def unbalanced(seed, n, answers=40):
    """Random wins `(n, n)`: a chain of pairs, and others, each compared some times."""
    random = np.random.default_rng(seed)
    wins = np.zeros((n, n))
    pairs = [(k, k + 1) for k in range(n - 1)]
    pairs += [tuple(random.choice(n, 2, replace=False)) for _ in range(random.integers(0, 2 * n))]
    for i, j in pairs:
        wins[i, j] += random.integers(0, answers)
        wins[j, i] += random.integers(1, answers)
    return torch.from_numpy(wins)


def one(wins, names=None):
    """Comparisons of one material: wins `(O, n, n)`."""
    names = names or [f"s{k}" for k in range(wins.shape[-1])]
    return Comparisons(["gold"], [names], [f"o{k}" for k in range(len(wins))], wins[:, None])


def test_least_squares_give_the_published_scale_of_vegetables():
    found = least_squares(vegetables())
    np.testing.assert_allclose(found - found.min(), GUILFORD, atol=0.006)
    assert abs(found.sum().item()) < 1e-12


def test_the_most_likely_scale_of_vegetables_is_near():
    found = map_estimate(vegetables())[0]
    np.testing.assert_allclose(found - found.min(), GUILFORD, atol=0.08)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), n=st.integers(2, 8), prior=st.sampled_from([0.5, 1.5, 20.0]))
def test_most_likely_scales_end_where_scipy_does(seed, n, prior):
    wins = unbalanced(seed, n)
    precision = 12 / (prior**2 * (n**2 - 1))
    counts = wins.numpy()

    def objective(s):
        apart = s[:, None] - s
        ratio = counts * np.exp(stats.norm.logpdf(apart) - stats.norm.logcdf(apart))
        value = (counts * stats.norm.logcdf(apart)).sum() - 0.5 * precision * (s**2).sum()
        return -value, -(ratio.sum(1) - ratio.sum(0)) + precision * s

    expected = minimize(objective, np.zeros(n), jac=True, method="BFGS", options={"gtol": 1e-9})
    found = map_estimate(wins, prior)[0]
    np.testing.assert_allclose(found, expected.x, atol=1e-6)
    assert abs(found.sum().item()) < 1e-9


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), n=st.integers(2, 8))
def test_least_squares_of_incomplete_data_are_those_of_numpy(seed, n):
    wins = unbalanced(seed, n).numpy()
    rows, right = [np.ones(n)], [0.0]
    for i in range(n):
        for j in range(i):
            count = wins[i, j] + wins[j, i]
            if count:
                rows.append(np.eye(n)[i] - np.eye(n)[j])
                right.append(stats.norm.ppf(np.clip(wins[i, j] / count, 0.5 / count, 1 - 0.5 / count)))
    expected = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    np.testing.assert_allclose(least_squares(torch.from_numpy(wins)), expected, atol=1e-10)


def test_least_squares_of_complete_data_are_means_of_rows():
    wins = torch.tensor([[0.0, 7, 10], [3, 0, 6], [0, 4, 0]]).double()
    z = stats.norm.ppf([[0.5, 0.7, 0.95], [0.3, 0.5, 0.6], [0.05, 0.4, 0.5]])  # 10 of 10 becomes 1 - 1/20
    np.testing.assert_allclose(least_squares(wins), z.mean(1), atol=1e-12)


@pytest.mark.parametrize(("won", "lost"), [(7, 3), (90, 10), (1, 19)])
def test_two_stimuli_are_as_far_apart_as_their_share_says(won, lost):
    wins = torch.tensor([[0.0, won], [lost, 0.0]]).double()
    apart = stats.norm.ppf(won / (won + lost))
    value, covariance = map_estimate(wins, LARGEST_PRIOR)
    np.testing.assert_allclose(value, [apart / 2, -apart / 2], atol=1e-6)
    np.testing.assert_allclose(least_squares(wins), [apart / 2, -apart / 2], atol=1e-12)
    variance = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
    expected = won * lost / (won + lost) ** 3 / stats.norm.pdf(apart) ** 2  # by the delta method
    np.testing.assert_allclose(variance, expected, rtol=1e-5)


def test_the_covariance_is_the_inverse_of_the_expected_hessian():
    wins = unbalanced(4, 6)
    value, covariance = map_estimate(wins, 1.5)
    expected_wins = (wins + wins.mT) * torch.special.ndtr(value[:, None] - value)
    precision = 12 / (1.5**2 * 35)

    def density(s):
        return -(expected_wins * torch.special.log_ndtr(s[:, None] - s)).sum() + precision * s.square().sum() / 2

    hessian = torch.autograd.functional.hessian(density, value)
    basis = torch.linalg.qr(torch.cat([torch.ones(6, 1), torch.eye(6)[:, 1:]], 1).double())[0][:, 1:]
    expected = basis @ torch.linalg.inv(basis.mT @ hessian @ basis) @ basis.mT
    torch.testing.assert_close(covariance, expected, rtol=1e-9, atol=1e-12)


def test_unanimous_answers_have_a_finite_scale():
    n = 6
    wins = 20 * torch.ones(n, n).triu(1).double()
    value, covariance = map_estimate(wins)
    assert (value.diff() < -0.5).all() and (value.abs() < 10).all()
    assert torch.isfinite(covariance).all()
    assert (least_squares(wins).diff() < 0).all()
    # With next to no prior, values are far away, but still numbers.
    assert torch.isfinite(map_estimate(wins, LARGEST_PRIOR)[0]).all()


def test_a_scale_does_not_depend_on_its_batch_mates_or_on_padding():
    some = [unbalanced(seed, 5) for seed in range(12)]
    batch = torch.stack([*some, torch.zeros(5, 5).double()]).reshape(13, 1, 5, 5)
    value, covariance = map_estimate(batch)
    for k, wins in enumerate(some):
        alone, its = map_estimate(wins)
        torch.testing.assert_close(value[k, 0], alone, rtol=0, atol=1e-12)
        torch.testing.assert_close(covariance[k, 0], its, rtol=0, atol=1e-12)
    assert value[12].isnan().all() and covariance[12].isnan().all()
    padded = torch.zeros(7, 7).double()
    padded[:5, :5] = some[0]
    for method in (least_squares, lambda wins: map_estimate(wins)[0]):
        found = method(padded)
        torch.testing.assert_close(found[:5], method(some[0]), rtol=0, atol=1e-12)
        assert found[5:].isnan().all()


def test_parts_without_a_comparison_between_them_are_refused_by_name():
    wins = torch.zeros(2, 5, 5).double()
    wins[0, 0, 1] = wins[1, 2, 3] = wins[0, 3, 4] = 1
    comparisons = one(wins, ["ward", "cook", "phong", "ggx", "lafortune"])
    with pytest.raises(DataError, match=r"^gold: .* 2 parts .*, those of .*$") as error:
        scale(comparisons)
    assert "'ward'" in str(error.value) and "'phong'" in str(error.value)
    assert least_squares(comparisons.total).isnan().all()
    wins[0, 1, 2] = 1
    scale(one(wins), draws=2)


@pytest.mark.parametrize(
    "wins",
    [torch.zeros(3, 2).double(), torch.zeros(3, 3), -torch.ones(2, 2).double().triu(1), torch.eye(3).double()],
)
def test_what_is_no_count_of_wins_is_refused(wins):
    with pytest.raises(ShapeError, match=r"^wins: expected"):
        map_estimate(wins)
    with pytest.raises(ShapeError, match=r"^wins: expected"):
        least_squares(wins)


@pytest.mark.parametrize("prior", [0.0, -1.0, math.inf, math.nan])
def test_a_prior_that_is_none_is_refused(prior):
    with pytest.raises(UsageError, match=r"^prior: expected more than 0"):
        map_estimate(vegetables(), prior)


def answer(observer, material, left, right, chosen, kind="trial", experiment="e"):
    return Answer(observer, experiment, material, left, right, chosen, kind=kind)


ANSWERS = [
    answer("ann", "gold", "a", "b", "a"),
    answer("ann", "gold", "b", "a", "a", "repeat"),
    answer("ann", "steel", "c", "b", "b"),
    answer("ann", "gold", "measured", "b", "b", "catch"),
    answer("bob", "gold", "b", "a", "b"),
    answer("bob", "gold", "d", "a", "a"),
]


def test_trials_are_counted():
    found = Comparisons.from_answers(ANSWERS)
    assert (found.materials, found.observers) == (["gold", "steel"], ["ann", "bob"])
    assert found.stimuli == [["a", "b", "d"], ["c", "b"]]
    expected = torch.zeros(2, 2, 3, 3).double()
    expected[0, 0, 0, 1] = expected[0, 1, 1, 0] = expected[1, 0, 1, 0] = expected[1, 0, 0, 2] = 1
    assert torch.equal(found.wins, expected)
    assert torch.equal(found.present, torch.tensor([[True, True, True], [True, True, False]]))
    assert found.compared[0].tolist() == [[0, 2, 1], [2, 0, 0], [1, 0, 0]]
    bob = found.select([1])
    assert bob.observers == ["bob"] and torch.equal(bob.wins, expected[1:]) and bob.stimuli == found.stimuli
    assert bob.present[1].sum() == 0


def test_one_experiment_is_scaled_at_a_time():
    other = answer("cat", "gold", "a", "b", "b", experiment="f")
    with pytest.raises(UsageError, match=r"^answers: expected the name of one experiment, found e, f$"):
        Comparisons.from_answers([*ANSWERS, other])
    assert Comparisons.from_answers([*ANSWERS, other], "f").observers == ["cat"]
    with pytest.raises(UsageError, match="unknown experiment 'g'"):
        Comparisons.from_answers(ANSWERS, "g")
    with pytest.raises(DataError, match="expected answers to trials, found none"):
        Comparisons.from_answers([one for one in ANSWERS if one.kind != "trial"])
    with pytest.raises(DataError, match="expected answers to trials, found none"):
        Comparisons.from_answers([])


def test_comparisons_that_do_not_fit_together_are_refused():
    with pytest.raises(ShapeError, match=r"wins: expected \(1, 1, 2, 2\)"):
        Comparisons(["gold"], [["a", "b"]], ["ann"], torch.zeros(2, 1, 2, 2).double())
    with pytest.raises(ShapeError, match="expected float64"):
        Comparisons(["gold"], [["a", "b"]], ["ann"], torch.zeros(1, 1, 2, 2))


def test_scales_have_a_row_for_each_stimulus():
    found = scale(Comparisons.from_answers(ANSWERS), draws=20)
    rows = found.records()
    assert [(row["material"], row["stimulus"]) for row in rows] == [
        ("gold", "a"),
        ("gold", "b"),
        ("gold", "d"),
        ("steel", "c"),
        ("steel", "b"),
    ]
    assert all(row["low"] < row["scale"] < row["high"] for row in rows)
    assert [row["observations"] for row in rows] == [1.5, 1.5, 1.5, 1, 1]
    assert all(math.isnan(row["montag_low"]) for row in rows)  # not defined for so few
    draws = torch.cat([found.draws[:, 0], found.draws[:, 1, :2]], dim=1).numpy()
    ends = [(row["bootstrap_low"], row["bootstrap_high"]) for row in rows]
    np.testing.assert_allclose(ends, np.nanpercentile(draws, [2.5, 97.5], axis=0).T)
    assert math.isnan(scale(Comparisons.from_answers(ANSWERS), draws=0).records()[0]["bootstrap_low"])
    assert found.value[1, 2].isnan() and found.low[1, 2].isnan()
    assert found.draws.shape == (20, 2, 3)
    assert found.goodness.dof.tolist() == [0, 0] and found.goodness.p.isnan().all()


@pytest.mark.parametrize("method", ["likelihood", "least_squares"])
def test_the_difference_of_two_stimuli_is_twice_the_value_of_one(method):
    wins = simulated_wins(torch.tensor([0.4, 0.0]).double(), torch.ones(30, 2, 2).double(), torch.Generator())
    found = scale(one(wins), method=method, draws=0)
    value, low, high = found.difference(0, 0, 1)
    np.testing.assert_allclose([value, low, high], 2 * torch.stack([found.value, found.low, found.high])[:, 0, 0])
    np.testing.assert_allclose(found.difference(0, 1, 0), [-value, -high, -low])
    assert found.difference(0, 1, 1) == (0, 0, 0)


def test_the_same_seed_gives_the_same_scales():
    wins = simulated_wins(torch.tensor([0.5, 0.0, -0.5]).double(), torch.ones(9, 3, 3).double(), torch.Generator())
    first, again, other = (scale(one(wins), draws=30, seed=seed) for seed in (1, 1, 2))
    assert torch.equal(first.draws, again.draws) and torch.equal(first.goodness.p, again.goodness.p)
    assert not torch.equal(first.draws, other.draws)
    assert torch.equal(first.low, other.low)


def test_an_unknown_method_is_refused():
    with pytest.raises(UsageError, match=r"unknown method of scaling 'likelyhood'.*did you mean 'likelihood'"):
        scale(one(vegetables()[None]), method="likelyhood")


@pytest.mark.slow
def test_the_fit_of_many_answers_is_tested_as_by_chi_square():
    """With 2000 answers a pair, G^2 of true scales is chi-square, and so is its p by simulation."""
    generator = torch.Generator().manual_seed(3)
    truth = torch.tensor([0.8, 0.3, 0.0, -0.2, -0.9]).double()
    wins = simulated_wins(truth.expand(300, 5), 2000 * (1 - torch.eye(5)).double(), generator)
    found = goodness(wins, map_estimate(wins)[0], draws=400, seed=1)
    assert set(found.dof.tolist()) == {6}
    assert stats.kstest(found.statistic.numpy(), stats.chi2(6).cdf).pvalue > 0.01
    assert stats.kstest(found.p.numpy(), "uniform").pvalue > 0.01
    expected = stats.chi2.sf(found.statistic.numpy(), 6)
    np.testing.assert_allclose(found.p, expected, atol=4 * 0.5 / 400**0.5)


@pytest.mark.parametrize(("reach", "answers", "wrong"), [(0.5, 6, 0.115), (2.0, 12, 0.009)])
@pytest.mark.parametrize(("studies", "within"), [(150, 0.07), pytest.param(1000, 0.02, marks=pytest.mark.slow)])
def test_the_test_of_the_fit_holds_its_level_with_few_answers(reach, answers, wrong, studies, within):
    """Where a chi-square distribution does not: it rejects true scales too often, or hardly ever."""
    generator = torch.Generator().manual_seed(4)
    truth = torch.linspace(-reach, reach, 5).double()
    wins = simulated_wins(truth.expand(studies, 5), answers * (1 - torch.eye(5)).double(), generator)
    found = goodness(wins, map_estimate(wins)[0], draws=200)
    assert (found.p < 0.05).double().mean().item() == pytest.approx(0.05, abs=within)
    by_chi_square = (stats.chi2.sf(found.statistic.numpy(), 6) < 0.05).mean()
    assert by_chi_square == pytest.approx(wrong, abs=within)


@pytest.mark.parametrize("method", ["likelihood", "least_squares"])
def test_circular_preferences_have_no_scale(method):
    """A over B, B over C, C over A, each by 24 of 30; and beside, answers that have one."""
    circle = torch.tensor([[0.0, 24, 6], [6, 0, 24], [24, 6, 0]]).double()
    line = torch.tensor([[0.0, 24, 29], [6, 0, 24], [1, 6, 0]]).double()
    wins = torch.stack([circle, line])[None]
    found = scale(Comparisons(["round", "straight"], [["a", "b", "c"]] * 2, ["all"], wins), method=method, draws=400)
    assert found.goodness.dof.tolist() == [1, 1]
    assert found.goodness.p[0] < 0.01 and found.goodness.p[1] > 0.1
    np.testing.assert_allclose(found.value[0], 0, atol=1e-9)
    expected = 2 * 90 * (0.8 * math.log(0.8 / 0.5) + 0.2 * math.log(0.2 / 0.5))
    assert found.goodness.statistic[0].item() == pytest.approx(expected)


def test_simulated_answers_have_the_chances_of_the_model():
    scale_values = torch.tensor([1.0, 0.0, torch.nan]).double()
    compared = torch.tensor([[0.0, 400_000, 0], [400_000, 0, 0], [0, 0, 0]]).double()
    wins = simulated_wins(scale_values, compared, torch.Generator().manual_seed(0))
    assert torch.equal(wins + wins.mT, compared)
    assert wins[0, 1].item() / 400_000 == pytest.approx(stats.norm.cdf(1), abs=0.003)


def test_what_would_take_days_or_all_memory_is_refused(monkeypatch):
    names = [f"s{k}" for k in range(3001)]
    answers = [Answer("o", "", "m", left, right, left) for left, right in itertools.pairwise(names)]
    comparisons = Comparisons.from_answers(answers)
    with pytest.raises(UsageError, match="expected at most 669 stimuli with 1 materials, 1 observers and 1000 draws"):
        scale(comparisons)
    with pytest.raises(UsageError, match="expected at most"):
        scale(comparisons, draws=-1)
    many = [replace(answer, observer=f"o{k}") for k in range(20) for answer in answers]
    with pytest.raises(DataError, match="expected at most 1073741824 bytes of counts, found 1440960160: 20"):
        Comparisons.from_answers(many)
    monkeypatch.setenv("TORCHBRDF_MAX_BYTES", "1000")
    with pytest.raises(DataError, match="expected at most 1000 bytes of counts"):
        Comparisons.from_answers(answers[:20])


def test_a_scale_says_how_far_it_is():
    answers = [Answer(f"o{k}", "", "m", "a", "b", "ab"[k % 2]) for k in range(5)]
    said = []
    scale(Comparisons.from_answers(answers), draws=7, progress=lambda done, total: said.append((done, total)))
    assert said[-1] == (14, 14) and said == sorted(said)
