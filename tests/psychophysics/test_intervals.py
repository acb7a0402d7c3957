"""Intervals of scales beside simulations with known truth, exact sums, and the formula of Montag."""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from torchbrdf.errors import UsageError
from torchbrdf.psychophysics import Comparisons, bootstrap, intervals, least_squares, montag, scale, simulated_wins

STIMULI, OBSERVATIONS = (3, 4, 6, 9, 14, 20), (15, 20, 30, 60, 100)


def exact_deviation(truth, count):
    """Standard deviation of least-squares scale values, root mean square over stimuli: a sum over all counts of wins.

    Pairs are independent, and a scale value is a mean of z over pairs; z of 0 and N is that of 1/2 and N - 1/2.
    """
    wins = np.arange(count + 1)
    z = stats.norm.ppf(wins.clip(0.5, count - 0.5) / count)
    chance = stats.binom.pmf(wins, count, stats.norm.cdf(truth[:, None] - truth)[..., None])
    variance = (chance * z**2).sum(-1) - (chance * z).sum(-1) ** 2
    np.fill_diagonal(variance, 0)
    return math.sqrt(variance.sum(1).mean()) / len(truth)


def off_by(span, n, count):
    """How much too large Montag's standard deviation is, as a share, for a scale that spans so many units."""
    expected = exact_deviation(np.linspace(0, span, n), count)
    return montag(torch.tensor(float(n)), torch.tensor(float(count))).item() / expected - 1


@pytest.mark.slow
def test_montags_formula_agrees_with_a_simulation_within_six_per_cent():
    """4000 studies of equal stimuli in each cell, scaled by least squares; 4.1 % is the most found."""
    generator, worst = torch.Generator().manual_seed(6), 0.0
    for n in STIMULI:
        for count in OBSERVATIONS:
            compared = count * (1 - torch.eye(n)).double()
            found = least_squares(simulated_wins(torch.zeros(4000, n).double(), compared, generator))
            deviation = found.square().mean().sqrt()
            sigma = montag(torch.tensor(float(n)), torch.tensor(float(count)))
            worst = max(worst, abs(sigma / deviation - 1).item())
            np.testing.assert_allclose(deviation, exact_deviation(np.zeros(n), count), rtol=0.025)
    assert worst < 0.06


def test_where_montags_formula_holds():
    """What its docstring says, by exact sums instead of a simulation."""
    off = {span: [off_by(span, n, count) for n in STIMULI for count in OBSERVATIONS] for span in (0.0, 0.5, 1.0, 2.0)}
    assert max(np.abs(off[0.0])) < 0.04 and max(np.abs(off[0.5])) < 0.04
    assert 0.06 < max(np.abs(off[1.0])) < 0.10
    assert -0.37 < min(off[2.0]) < -0.35
    apart = [off_by(n - 1.0, n, count) for n in STIMULI for count in OBSERVATIONS]
    assert -0.37 < min(apart) < -0.35 and 1.3 < max(apart) < 1.5


def test_montags_formula_by_hand():
    np.testing.assert_allclose(montag(torch.tensor(9.0), torch.tensor(30.0)), 0.07513, rtol=2e-4)
    assert montag(torch.tensor(4.0), torch.tensor(2.5)).isnan()


def spaced(gaps, count, n, generator):
    """Scales `(count, n)`, mean 0, with these gaps between neighbours, or uniform ones from 0 to 1."""
    steps = (
        torch.rand(count, n - 1, generator=generator).double()
        if gaps == "uniform"
        else torch.full((count, n - 1), gaps).double()
    )
    truth = torch.nn.functional.pad(steps.cumsum(-1), (1, 0))
    return truth - truth.mean(-1, keepdim=True)


def studied(truth, observers, generator, own=0.0, asked=1.0):
    """Comparisons of observers who judge each pair once: a material for each truth, `(M, n)`.

    own: the standard deviation of an observer's own preference for each stimulus. Phi of a difference is then still
    the mean share of wins, of a scale that is sqrt(1 + 2 own^2) times smaller, which is why it is made larger here.
    asked: the share of pairs that each observer judges, chosen at random.
    """
    count, n = truth.shape
    taste = own * torch.randn(observers, count, n, generator=generator).double()
    compared = (torch.rand(observers, count, n, n, generator=generator) < asked).double().triu(1)
    wins = simulated_wins(truth * math.sqrt(1 + 2 * own**2) + taste, compared + compared.mT, generator)
    names = [f"s{k}" for k in range(n)]
    return Comparisons([f"m{k}" for k in range(count)], [names] * count, [f"o{k}" for k in range(observers)], wins)


def coverage(truth, found):
    """How often the interval of each stimulus holds the truth, `(n,)`."""
    return ((found.low <= truth) & (truth <= found.high)).double().mean(0)


@pytest.mark.parametrize("gaps", ["uniform", 1.0, 0.0])
@pytest.mark.parametrize(("n", "observers"), [(3, 20), (4, 20), pytest.param(9, 15, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_at_their_rate(n, observers, gaps):
    """2000 repetitions with observers who are alike: of 500, chance alone moves the rate by 0.6 %."""
    generator = torch.Generator().manual_seed(1)
    truth = spaced(gaps, 2000, n, generator)
    rate = coverage(truth, scale(studied(truth, observers, generator), draws=0))
    assert 0.93 <= rate.mean() <= 0.97
    assert rate.min() >= 0.93 and rate.max() <= 0.98


@pytest.mark.parametrize("gaps", [0.0, *(pytest.param(gaps, marks=pytest.mark.slow) for gaps in ("uniform", 1.0))])
def test_intervals_hold_the_truth_where_observers_differ(gaps):
    """Which those by the model alone do not, at least where stimuli are near each other."""
    generator = torch.Generator().manual_seed(2)
    truth = spaced(gaps, 500, 9, generator)
    found = scale(studied(truth, 20, generator, own=0.5), draws=0)
    assert 0.93 <= coverage(truth, found).mean() <= 0.97
    if gaps == 0.0:
        half = 1.96 * found.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
        assert ((found.value - truth).abs() < half).double().mean() < 0.88


@pytest.mark.parametrize("gaps", ["uniform", 0.0])
def test_intervals_hold_the_truth_where_observers_judge_some_pairs(gaps):
    generator = torch.Generator().manual_seed(3)
    truth = spaced(gaps, 500, 6, generator)
    rate = coverage(truth, scale(studied(truth, 30, generator, asked=0.5), draws=0))
    assert 0.93 <= rate.mean() <= 0.97


def test_differences_hold_the_truth_at_their_rate():
    generator = torch.Generator().manual_seed(4)
    truth = spaced("uniform", 500, 5, generator)
    found = scale(studied(truth, 20, generator), draws=0)
    held = []
    for m in range(500):
        for i, j in ((0, 1), (0, 4), (2, 3)):
            _, low, high = found.difference(m, i, j)
            held.append(low <= truth[m, i] - truth[m, j] <= high)
    assert 0.93 <= np.mean(held) <= 0.97


@pytest.mark.parametrize("n", [3, 4, pytest.param(9, marks=pytest.mark.slow)])
def test_scales_are_as_wide_as_the_truth(n):
    """The bias by which the prior was chosen: within 5 % with neighbours 1 apart."""
    generator = torch.Generator().manual_seed(5)
    truth = spaced(1.0, 500, n, generator)
    found = scale(studied(truth, 20, generator), draws=0).value
    slope = (found * truth).sum() / truth.square().sum()
    assert slope.item() == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize(
    ("span", "low", "high"),
    [(0.0, 0.93, 0.97), pytest.param(1.6, 0.93, 0.98, marks=pytest.mark.slow), (4.0, 0.0, 0.8)],
)
def test_intervals_of_least_squares_hold_for_scales_of_two_units_only(span, low, high):
    generator = torch.Generator().manual_seed(7)
    truth = torch.linspace(-span / 2, span / 2, 9).double().expand(500, 9)
    rate = coverage(truth, scale(studied(truth, 20, generator), method="least_squares", draws=0))
    assert low <= rate.mean() <= high


def test_covariances_of_least_squares_are_exact_for_many_observers():
    truth = torch.tensor([[0.6, 0.1, -0.2, -0.5]]).double()
    generator = torch.Generator().manual_seed(8)
    found = scale(studied(truth, 3000, generator), method="least_squares", draws=0)
    expected = exact_deviation(truth[0].numpy(), 3000)
    for covariance in (found.covariance, found.between):
        assert covariance[0].diagonal().mean().sqrt().item() == pytest.approx(expected, rel=0.05)
        np.testing.assert_allclose(covariance[0].sum(0), 0, atol=1e-12)


def test_the_two_covariances_agree_where_observers_are_alike():
    truth = spaced("uniform", 3, 4, torch.Generator().manual_seed(9))
    found = scale(studied(truth, 4000, torch.Generator().manual_seed(9)), draws=0)
    size = found.covariance.abs().amax((-2, -1), keepdim=True)
    torch.testing.assert_close(found.between / size, found.covariance / size, rtol=0, atol=0.08)


def test_one_observer_says_nothing_about_how_observers_differ():
    truth = torch.tensor([[0.5, 0.0, -0.5]]).double()
    found = scale(studied(truth, 1, torch.Generator().manual_seed(0)), draws=3)
    assert not found.between.any()
    assert (found.low < found.value).all()


@pytest.mark.parametrize("method", [pytest.param("likelihood", marks=pytest.mark.slow), "least_squares"])
def test_the_bootstrap_spreads_as_the_covariance_says(method):
    truth = spaced(0.3, 4, 4, None)
    comparisons = studied(truth, 100, torch.Generator().manual_seed(10), own=0.5)
    found = scale(comparisons, method=method, draws=2000)
    assert found.draws.shape == (2000, 4, 4)
    spread = found.draws.std(0)
    expected = found.between.diagonal(dim1=-2, dim2=-1).sqrt()
    np.testing.assert_allclose(spread / expected, 1, atol=0.12)
    np.testing.assert_allclose((found.draws.mean(0) - found.value) / expected, 0, atol=0.4)


def test_draws_do_not_depend_on_how_many_are_made_at_once(monkeypatch):
    comparisons = studied(spaced(0.5, 3, 4, None), 8, torch.Generator().manual_seed(11))
    together = bootstrap(comparisons, 50, seed=3)
    monkeypatch.setattr(intervals, "CHUNK", 1)
    torch.testing.assert_close(bootstrap(comparisons, 50, seed=3), together, rtol=0, atol=1e-9)


@pytest.mark.parametrize("method", ["likelihood", "least_squares"])
def test_draws_that_fall_apart_are_left_empty(method):
    """Two observers, each of whom judged one half of a chain: half of the draws are without one half."""
    wins = torch.zeros(2, 1, 3, 3).double()
    wins[0, 0, 0, 1] = wins[1, 0, 1, 2] = 1
    comparisons = Comparisons(["gold"], [["a", "b", "c"]], ["ann", "bob"], wins)
    draws = bootstrap(comparisons, 400, method=method)
    assert torch.equal(draws.isnan().any(-1), draws.isnan().all(-1))
    assert 0.4 < draws.isnan().all(-1).double().mean() < 0.6


def test_a_negative_number_of_draws_is_refused():
    with pytest.raises(UsageError, match="draws: expected 0 or more, found -1"):
        bootstrap(studied(spaced(0.5, 1, 3, None), 4, torch.Generator()), -1)
