"""How many observers a study needs."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from torchbrdf.errors import UsageError

MOST_OBSERVERS = 400_000
# Information alone says less and less about stimuli that are further apart, and telling them apart is no question.
LARGEST_DIFFERENCE = 2.5
# Of two stimuli: one answer in 10^23 goes the other way.
LARGEST_OF_TWO = 10.0
# Beyond, what is wanted is no study: tests at such levels, powers so near to 1, and pairs of so many stimuli.
LEVELS = (1e-6, 0.5)
LARGEST_POWER = 1 - 1e-6
MOST_STIMULI = 1000


def power_of(difference: float, observers: int, alpha: float = 0.05, stimuli: int = 2) -> float:
    """Power of a study: the chance to tell two stimuli apart, each pair judged once by each observer.

    stimuli 2: the two-sided binomial test against 1/2, exact. More: in a complete design with the two at the ends and
    the others evenly spread between them, the test of whether the difference of their scale values is 0,
    Phi(d / sigma - z) + Phi(-d / sigma - z), z of alpha/2, sigma^2 by the expected information of all pairs; for at
    most 2.5 units. Observers are alike. Simulated, the intervals of `scale` exclude 0 as often within 0.05, with 8
    observers or more.
    """
    _check(difference, alpha, stimuli)
    if not 1 <= observers <= MOST_OBSERVERS:
        raise UsageError(f"power: observers: expected 1 to {MOST_OBSERVERS}, found {observers}")
    return float(_powers(difference, np.array([observers]), alpha, stimuli)[0])


def observers_needed(difference: float, power: float = 0.8, alpha: float = 0.05, stimuli: int = 2) -> int:
    """How many observers a study needs to tell two stimuli apart.

    The power of the exact binomial test goes up and down with the number of observers: with any larger number it is
    at least `power` too.

    Args:
        difference: Of the two, in units of the scale, other than 0.
        power: The chance to tell them apart, above alpha, which it is without a difference, and at most 0.999999.
        alpha: The level of the test, 1e-6 to 0.5.
        stimuli: Of a material, 2 to 1000.

    Returns:
        The number of observers from which on the power is at least `power`.

    Raises:
        UsageError: A number is out of range, or a hundred thousand observers or more are needed.

    Example:
        >>> observers_needed(0.5)
        61
    """
    _check(difference, alpha, stimuli)
    if not alpha < power <= LARGEST_POWER:
        raise UsageError(f"power: expected more than alpha, {alpha:g}, and at most {LARGEST_POWER}, found {power}")
    if difference == 0:
        raise UsageError("power: difference: expected a number other than 0, found 0")
    # Well beyond what a normal distribution needs; there the ups and downs no longer reach down to `power`.
    about = _about(difference, max(power, 0.5), alpha, stimuli)
    if 4 * about > MOST_OBSERVERS:
        raise UsageError(f"power: a difference of {difference} takes some {min(about, 1e15):.0f} observers or more")
    most = math.ceil(4 * about) + 200
    enough = _powers(difference, np.arange(1, most + 1), alpha, stimuli) >= power
    short = np.flatnonzero(~enough)
    return int(short[-1]) + 2 if len(short) else 1


def _check(difference: float, alpha: float, stimuli: int) -> None:
    if not 2 <= stimuli <= MOST_STIMULI:
        raise UsageError(f"power: stimuli: expected 2 to {MOST_STIMULI}, found {stimuli}")
    largest = LARGEST_DIFFERENCE if stimuli > 2 else LARGEST_OF_TWO
    if not abs(difference) <= largest:
        raise UsageError(f"power: difference: expected at most {largest} units, found {difference}")
    if not LEVELS[0] <= alpha <= LEVELS[1]:
        raise UsageError(f"power: alpha: expected {LEVELS[0]:g} to {LEVELS[1]}, found {alpha}")


def _powers(difference: float, observers: NDArray[np.int64], alpha: float, stimuli: int) -> NDArray[np.float64]:
    if stimuli == 2:
        chance = stats.norm.cdf(abs(difference))
        # The most answers for one side that are too few; and as many for the other.
        too_few = stats.binom.ppf(alpha / 2, observers, 0.5)
        too_few -= stats.binom.cdf(too_few, observers, 0.5) > alpha / 2 * (1 + 1e-9)
        low, high = (stats.binom.cdf(too_few, observers, p) for p in (chance, 1 - chance))
        return np.asarray(low + high)
    shift = abs(difference) * np.sqrt(observers) / _sigma(difference, stimuli)
    z = stats.norm.isf(alpha / 2)
    return np.asarray(stats.norm.cdf(shift - z) + stats.norm.cdf(-shift - z))


def _about(difference: float, power: float, alpha: float, stimuli: int) -> float:
    """How many observers are enough by a normal distribution; inf for a difference that rounding hides."""
    if abs(difference) < 1e-12:
        return math.inf
    z, more = stats.norm.isf(alpha / 2), stats.norm.ppf(power)
    if stimuli == 2:
        chance = stats.norm.cdf(abs(difference))
        return float(((0.5 * z + math.sqrt(chance * (1 - chance)) * more) / (chance - 0.5)) ** 2)
    return float(((z + more) * _sigma(difference, stimuli) / difference) ** 2)


def _sigma(difference: float, stimuli: int) -> float:
    """Standard deviation of the difference of the two at the ends, from one observer's answers to all pairs."""
    places = np.linspace(0, abs(difference), stimuli)
    gaps = places[:, None] - places
    weights = np.exp(2 * stats.norm.logpdf(gaps) - stats.norm.logcdf(gaps) - stats.norm.logcdf(-gaps))
    np.fill_diagonal(weights, 0)
    # 1 / n everywhere makes it invertible, and leaves differences as they are.
    matrix = np.diag(weights.sum(1)) - weights + 1 / stimuli
    ends = np.zeros(stimuli)
    ends[0], ends[-1] = -1, 1
    return math.sqrt(ends @ np.linalg.solve(matrix, ends))
