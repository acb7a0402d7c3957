"""From a distance to the share of observers who would tell the two apart, and to words."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.images import DIFFERENCES
from torchbrdf.names import check_name
from torchbrdf.reading import read_json

BUNDLED = "discrimination.json"
LARGEST, LARGEST_SPREAD, LARGEST_VARIANCE = 1e30, 10.0, 1e4
"""Of constants in any unit, and of logarithms: nothing that answers say is near these."""
LAPSE = 0.02
"""How often people answer at random, as in the likelihood that metrics are trained with."""
NORMAL = NormalDist()
NORMAL_95 = NORMAL.inv_cdf(0.975)
# One just-objectionable difference is what 75 % point out who must choose one of two.
JOD = NORMAL.inv_cdf(0.75)
NODES, NODE_WEIGHTS = (part.tolist() for part in np.polynomial.hermite_e.hermegauss(9))
_MASS = sum(NODE_WEIGHTS)


@dataclass(frozen=True)
class Share:
    """The share of observers who would be expected to tell two things apart, from 0 to 1.

    Args:
        value: Expected.
        low: Of the 95 % interval for one pair of things.
        high: The same.
        asked: Whether people were asked about such distances; if not, it is extrapolated.

    Example:
        >>> Share(0.4, 0.2, 0.65).text, Share(0.4, 0.2, 0.65).words
        ('40 % (20 to 65)', 'one in three')
    """

    value: float
    low: float
    high: float
    asked: bool = True

    @property
    def percent(self) -> str:
        """The share alone, such as `40 %`."""
        return f"{_percent(self.value)} %"

    @property
    def brief(self) -> str:
        """The share with its interval, such as `40 % (20 to 65)`; * where it is extrapolated."""
        if math.isnan(self.value):
            return "unknown"
        interval = f" ({_percent(self.low)} to {_percent(self.high)})" if self.high > self.low else ""
        return f"{self.percent}{interval}{'' if self.asked else '*'}"

    @property
    def text(self) -> str:
        """The same, and in words whether it is extrapolated."""
        return self.brief.replace("*", ", beyond what was asked")

    @property
    def words(self) -> str:
        """About how many people that is."""
        if math.isnan(self.value):
            return "unknown"
        return next(words for bound, words in LADDER if self.value < bound)


LADDER = (
    (1e-6, "nobody"),
    (0.03, "hardly anyone"),
    (0.075, "one in twenty"),
    (0.15, "one in ten"),
    (0.225, "one in five"),
    (0.29, "one in four"),
    (0.415, "one in three"),
    (0.585, "half"),
    (0.71, "two in three"),
    (0.825, "three in four"),
    (0.94, "nine in ten"),
    (0.98, "nearly everyone"),
    (math.inf, "everyone"),
)
"""Shares below the bound, and what they are called."""


@dataclass(frozen=True)
class Discrimination:
    """How well people tell apart what is so far apart under one metric.

    A distance d looks like psi(d e^(spread z)) with psi(d) = slope scale log(1 + d / scale): z, normal with variance 1,
    is how wrong the metric is about two things, and psi is in proportion near 0 and logarithmic further off. Of two
    distances from one original, the share

        LAPSE + (1 - 2 LAPSE) E Phi(psi(d_2 e^(spread z_2)) - psi(d_1 e^(spread z_1)))

    of observers finds the first smaller. Between the original itself, d = 0, and something else, Phi(psi(d)) choose the
    original; those who cannot tell guess, so the share of those who can is E (2 Phi(psi(d e^(spread z))) - 1).

    Args:
        slope: Per unit of the metric; 0.67 is one just-objectionable difference.
        scale: In units of the metric.
        spread: How wrong the metric is, as the standard deviation of a logarithm.
        covariance: Of the logarithms of these three, from materials that were drawn again; 3 x 3.
        lowest: The least distance that people were asked about, without one in a hundred.
        highest: The largest, in the same way.
        check: By part of the answers, how far, in the mean, shares are from what was foretold by the other half.

    Example:
        >>> metric = Discrimination(2.8, 1.2, 0.4, [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]], 0.05, 2.0)
        >>> metric.share(0.2).text
        '41 % (19 to 73)'

    Source: L. L. Thurstone, A law of comparative judgment, 1927, for the probit of differences; L. T. Maloney and
    J. N. Yang, Maximum likelihood difference scaling, 2003, doi:10.1167/3.8.5, for scales from comparisons of two
    differences.
    """

    slope: float
    scale: float
    spread: float
    covariance: list[list[float]]
    lowest: float
    highest: float
    check: dict[str, float] | None = None

    def __post_init__(self) -> None:
        positive = (self.slope, self.scale, self.highest)
        known = [len(row) for row in self.covariance] == [3, 3, 3]
        known = known and all(abs(x) <= LARGEST_VARIANCE for row in self.covariance for x in row)
        known = known and 0 < self.spread <= LARGEST_SPREAD and all(1 / LARGEST <= x <= LARGEST for x in positive)
        if not (known and 0 <= self.lowest < self.highest):
            raise DataError(
                f"discrimination: expected constants above 0, a 3 x 3 covariance and a range, found {shown(vars(self))}"
            )

    def perceived(self, distance: float) -> float:
        """psi(d): how far apart things look that are so far apart, in standard deviations of an observer."""
        return self.slope * self.scale * math.log1p(distance / self.scale)

    def share(self, distance: float) -> Share:
        """The share of observers who would be expected to tell two things apart that are so far apart.

        The interval is that for one pair: what the metric is wrong by, and how well the three constants are known.

        Raises:
            UsageError: The distance is below 0.
        """
        if distance < 0:
            raise UsageError(f"a distance: expected 0 or more, found {distance:g}")
        if not 0 < distance < math.inf:  # equal, not a number, or without end
            value = math.nan if math.isnan(distance) else min(distance, 1.0)
            return Share(value, value, value, asked=not distance)
        middle, sd = self.perceived(distance), self._log_deviation(distance)
        value = self._expected(distance)
        low, high = (_told_apart(middle * math.exp(sign * NORMAL_95 * sd)) for sign in (-1, 1))
        return Share(value, min(low, value), max(high, value), asked=self.lowest <= distance <= self.highest)

    def distance(self, share: float) -> float:
        """The distance at which such a share, above 0 and below 1, would be expected to tell two things apart.

        Raises:
            UsageError: The share is another.
        """
        _check_share(share)
        low, high = -60.0, 60.0
        for _ in range(80):
            middle = (low + high) / 2
            low, high = (middle, high) if self._expected(self.scale * math.exp(middle)) < share else (low, middle)
        return self.scale * math.exp(high)

    def prefer(self, first: float, second: float) -> float:
        """The share of observers who would find the first of two things nearer to one original."""
        total = sum(
            u * v * NORMAL.cdf(self._off(second, y) - self._off(first, x))
            for x, u in zip(NODES, NODE_WEIGHTS, strict=True)
            for y, v in zip(NODES, NODE_WEIGHTS, strict=True)
        )
        return float(LAPSE + (1 - 2 * LAPSE) * total / _MASS**2)

    def _off(self, distance: float, node: float) -> float:
        return self.perceived(distance * math.exp(self.spread * node))

    def _expected(self, distance: float) -> float:
        pairs = zip(NODES, NODE_WEIGHTS, strict=True)
        return float(sum(weight * _told_apart(self._off(distance, node)) for node, weight in pairs) / _MASS)

    def _log_deviation(self, distance: float) -> float:
        """Standard deviation of log psi."""
        ratio = distance / self.scale
        elasticity = ratio / ((1 + ratio) * math.log1p(ratio))
        slope = np.array([1.0, 1 - elasticity])
        known = slope @ np.array(self.covariance)[:2, :2] @ slope
        return math.sqrt(max(float(known), 0) + (elasticity * self.spread) ** 2)


class JustObjectionable:
    """Share of observers by just-objectionable differences: Phi(0.67 JOD) choose the original, by definition.

    Example:
        >>> JustObjectionable().share(1.0).text
        '50 %'
    """

    check = None
    lowest, highest = 0.0, math.inf

    def share(self, distance: float) -> Share:
        """The share of observers who would tell two things apart, of JOD lost; below 0 counts as 0."""
        value = distance if math.isnan(distance) else _told_apart(JOD * max(distance, 0))
        return Share(value, value, value)

    def distance(self, share: float) -> float:
        """How many JOD such a share, above 0 and below 1, would see.

        Raises:
            UsageError: The share is another.
        """
        _check_share(share)
        return NORMAL.inv_cdf((1 + share) / 2) / JOD


@dataclass(frozen=True)
class DiscriminationFile:
    """What a `discrimination.json` holds: how well people tell things apart under each metric, and whence that is."""

    metrics: dict[str, Discrimination]
    provenance: dict[str, Any]


def read_discrimination(path: Path | str | None = None) -> DiscriminationFile:
    """Read what distances mean.

    Args:
        path: A `discrimination.json` of the recipe `human_benchmark`; None: what comes with torchbrdf.

    Raises:
        DataError: The file cannot be read, or holds something else.
    """
    where = str(files("torchbrdf.assets") / BUNDLED if path is None else path)
    found: DiscriminationFile = read_json(where, DiscriminationFile, "what distances mean, from human_benchmark")
    for name in found.metrics:
        check_name(name, where)
    return found


@cache
def _bundled() -> Mapping[str, Discrimination]:
    return read_discrimination().metrics


def discrimination_of(metric: str) -> Discrimination | JustObjectionable | None:
    """How well people tell apart what is so far apart under a metric; None where that is not known.

    Args:
        metric: The name of a loss, or of an image difference.

    Example:
        >>> discrimination_of("psnr") is None
        True
    """
    if metric in DIFFERENCES and DIFFERENCES[metric].unit == "JOD":
        return JustObjectionable()
    if metric in DIFFERENCES:
        metric = f"rendered_{DIFFERENCES.canonical(metric)}"
    return _bundled().get(metric)


def told_apart(metric: str, distance: float) -> Share | None:
    """The share of observers who would be expected to tell two things apart; None where that is not known.

    Args:
        metric: The name of a loss, or of an image difference.
        distance: Under it.

    Example:
        >>> told_apart("psnr", 30.0) is None
        True
    """
    known = discrimination_of(metric)
    return None if known is None else known.share(distance)


def _check_share(share: float) -> None:
    if not 0 < share < 1:
        raise UsageError(f"a share of observers: expected a number above 0 and below 1, found {share:g}")


def _told_apart(perceived: float) -> float:
    return max(2 * NORMAL.cdf(perceived) - 1, 0.0)


def _percent(share: float) -> str:
    if 0 < share < 0.005:
        return "<1"
    return ">99" if 0.995 <= share < 1 else f"{100 * share:.0f}"
