"""What each observer's answers look like, and whose look odd. Nobody is ever left out by this: a person decides."""

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchbrdf.psychophysics.comparisons import Comparisons, one_experiment
from torchbrdf.psychophysics.intervals import CHUNK
from torchbrdf.psychophysics.kendall import circular_triads, consistence, triads_by_chance
from torchbrdf.psychophysics.thurstone import PRIOR, map_estimate
from torchbrdf.study.answers import Answer, by_observer
from torchbrdf.study.plan import MEASURED

UNLIKELY_Z = -3.0
ONE_SIDED_P = 0.001
ATTENTIVE, FAILED_P = 0.1, 0.05
# With fewer, observers who see as well as the others often have as many circular ones as chance makes.
FEWEST_TRIPLES = 200


@dataclass(frozen=True)
class ObserverReport:
    """Report on an observer: what their answers look like, and what is odd about them.

    trials: how many. likelihood_z: `agreement_with_others`. triads, consistence: by material, circular triads and
    Kendall's zeta, nan where not each pair was judged once. repeats, repeats_same: trials shown again, and answered
    the same. catches, missed: trials with a known answer, and answered otherwise. left, left_p: how often the left
    picture was chosen, as a share of trials and repeats, and the two-sided binomial p of that. seconds: the median
    response time of trials. flags: what is odd, in words. Figures of which nothing is known are nan.
    """

    observer: str
    trials: int
    likelihood_z: float
    triads: dict[str, float]
    consistence: dict[str, float]
    repeats: int
    repeats_same: int
    catches: int
    missed: int
    left: float
    left_p: float
    seconds: float
    flags: list[str] = field(default_factory=list)


def observer_reports(
    answers: Iterable[Answer], experiment: str | None = None, prior: float = PRIOR
) -> list[ObserverReport]:
    """Reports on all observers with answers to trials of one experiment. Errors as `Comparisons.from_answers`.

    Flags: a likelihood_z below -3; a left_p below 0.001; more catch trials missed than somebody makes likely who
    misses one in ten (binomial p < 0.05); circular triads no fewer than by chance (p > 0.05), if there are 200 triples
    or more and most observers do better. Simulated, 0 to 3 % of observers have a likelihood_z below -3 who are like
    the others (4 % with 6 trials each), and all who guess, from 75 trials with stimuli 0.5 units apart on average.
    """
    answers = one_experiment(answers, experiment)
    comparisons = Comparisons.from_answers(answers)
    likely = agreement_with_others(comparisons, prior).tolist()
    triads, zeta = circular_triads(comparisons.wins), consistence(comparisons.wins)
    circular = _triad_flags(comparisons.wins, triads)
    found = []
    theirs = by_observer(answers)
    for k, observer in enumerate(comparisons.observers):
        own = theirs[observer]
        trials = [answer for answer in own if answer.kind == "trial"]
        repeats, same = _repeated(own)
        catches = [answer for answer in own if answer.kind == "catch" and MEASURED in (answer.left, answer.right)]
        missed = sum(answer.chosen != MEASURED for answer in catches)
        sides = [answer.chosen == answer.left for answer in own if answer.kind != "catch"]
        left_p = _by_chance(sum(sides), len(sides))
        times = [answer.response_time for answer in trials if not math.isnan(answer.response_time)]
        flags = []
        if likely[k] < UNLIKELY_Z:
            flags.append(f"answers agree with the others' scales less than they should (z = {likely[k]:.1f})")
        if left_p < ONE_SIDED_P:
            share = 100 * sum(sides) / len(sides)
            flags.append(f"chose the left side in {share:.0f} % of {len(sides)} trials (p = {left_p:.1g})")
        if _at_least(missed, len(catches), ATTENTIVE) < FAILED_P:
            flags.append(f"missed {missed} of {len(catches)} catch trials")
        if circular[k]:
            flags.append(circular[k])
        found.append(
            ObserverReport(
                observer=observer,
                trials=len(trials),
                likelihood_z=likely[k],
                triads=dict(zip(comparisons.materials, triads[k].tolist(), strict=True)),
                consistence=dict(zip(comparisons.materials, zeta[k].tolist(), strict=True)),
                repeats=repeats,
                repeats_same=same,
                catches=len(catches),
                missed=missed,
                left=sum(sides) / len(sides),
                left_p=left_p,
                seconds=statistics.median(times) if times else math.nan,
                flags=flags,
            )
        )
    return found


def agreement_with_others(comparisons: Comparisons, prior: float = PRIOR) -> Tensor:
    """Likelihood of each observer's answers under scales fitted to all the others', standardised: z, `(O,)`.

    l = sum of log P(choice) over the observer's trials, y = (l - E[l]) / sqrt(Var[l]), both under the same scales:
    with p the probability of a choice and q = 1 - p, E = sum of p log p + q log q, Var = sum of p q (log p - log q)^2.
    p = Phi(d / sqrt(1 + v)), the mean of Phi over what is not known about the difference d, v its variance.
    z = (y - median of y) / max(1, 1.4826 median of |y - median|), over observers: where stimuli are nearly alike,
    scales are mostly error and everybody's y is below 0; where observers differ, y spreads. nan where the others'
    answers say nothing.
    """
    found = _likelihoods(comparisons, prior)
    centre = found.nanquantile(0.5)
    deviation = 1.4826 * (found - centre).abs().nanquantile(0.5)
    return (found - centre) / deviation.clamp(min=1)


def _likelihoods(comparisons: Comparisons, prior: float) -> Tensor:
    """y of `agreement_with_others`, `(O,)`."""
    total, found = comparisons.total, []
    n = total.shape[-1]
    chunk = max(1, CHUNK // (len(total) * n * n))
    for own in comparisons.wins.split(chunk):
        scale, covariance = map_estimate(total - own, prior)
        single = covariance.diagonal(dim1=-2, dim2=-1)
        variance = single.unsqueeze(-1) + single.unsqueeze(-2) - 2 * covariance
        difference = (scale.unsqueeze(-1) - scale.unsqueeze(-2)) / (1 + variance.clamp(min=0)).sqrt()
        log = torch.special.log_ndtr(difference.nan_to_num())
        chance, compared = log.exp(), own + own.mT
        likelihood = (own * log).sum((-3, -2, -1))
        expected = (compared * chance * log).sum((-3, -2, -1))
        # Each pair is here twice.
        variance_of_log = (compared * chance * (1 - chance) * (log - log.mT).square()).sum((-3, -2, -1)) / 2
        found.append(((likelihood - expected) / variance_of_log.sqrt()).masked_fill(variance_of_log <= 0, torch.nan))
    return torch.cat(found)


def _triad_flags(wins: Tensor, triads: Tensor) -> list[str]:
    """Words about observers whose circular triads, of all materials, are no fewer than by chance; else nothing."""
    mean, variance = (part.nansum(-1) for part in triads_by_chance(wins))
    found = triads.nansum(-1)
    z = (found - mean) / variance.sqrt()
    triples = 4 * mean
    likely = statistics.NormalDist().inv_cdf(0.05)
    by_chance = (z > likely) & (triples >= FEWEST_TRIPLES)
    # Where stimuli are alike for everybody, nobody does better.
    by_chance &= (z < likely).to(torch.float64).mean() > 0.5
    return [
        f"{found[k]:.0f} circular triads of {triples[k]:.0f} triples, no fewer than by chance" if by_chance[k] else ""
        for k in range(len(wins))
    ]


def _by_chance(chosen: int, count: int) -> float:
    """How likely one side of two is chosen as unevenly by chance, two-sided binomial p."""
    return min(1.0, 2 * _at_least(max(chosen, count - chosen), count, 0.5))


def _at_least(least: int, count: int, share: float) -> float:
    """How likely so many of `count` come up, or more, of which each does with the probability `share`."""
    binomial = torch.distributions.Binomial(count, torch.tensor(share, dtype=torch.float64, device="cpu"))
    counts = torch.arange(least, count + 1, dtype=torch.float64, device="cpu")
    return float(binomial.log_prob(counts).exp().sum())


def _repeated(answers: Sequence[Answer]) -> tuple[int, int]:
    """How many trials an observer answered a second time, and how many the same."""
    first = {
        (answer.material, frozenset((answer.left, answer.right))): answer.chosen
        for answer in answers
        if answer.kind == "trial"
    }
    again = [
        (first[pair], answer.chosen)
        for answer in answers
        if answer.kind == "repeat" and (pair := (answer.material, frozenset((answer.left, answer.right)))) in first
    ]
    return len(again), sum(before == after for before, after in again)
