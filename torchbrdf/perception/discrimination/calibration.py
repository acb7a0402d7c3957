"""Calibrate what distances mean from answers, and check it on answers that it did not see."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.bootstrap import percentile_interval, resample_counts
from torchbrdf.errors import DataError, shown
from torchbrdf.perception.agreement.statistics import same_material
from torchbrdf.perception.agreement.table import ODD_METHOD, Distances
from torchbrdf.perception.datasets.opinions import VOTES, Opinions
from torchbrdf.perception.datasets.triplets import Triplets
from torchbrdf.perception.discrimination.psychometric import LAPSE, NODE_WEIGHTS, NODES, Discrimination
from torchbrdf.precision import undisturbed

# Logarithms of slope, scale and spread at the start, in units of the mean distance; and what it costs to leave them, in
# mean log-likelihood: constants stay finite where answers do not say what they are.
START, PRIOR = (0.5, 0.0, -0.7), 1e-4
# Shares of the distances that were asked about which are outside the range that is given.
OUTSIDE = 0.01
STEP = 1e-4  # of numerical derivatives by the logarithms of the constants


@dataclass(frozen=True)
class Choices:
    """Choices of observers between C pairs of distances from one original, each a place in a vector of distances.

    first, second: `(C,)` long; votes: how many found either smaller, `(C, 2)` float64; materials: the places of those
    it is about, `(C, k)` long.
    """

    first: Tensor
    second: Tensor
    votes: Tensor
    materials: Tensor

    def __len__(self) -> int:
        return len(self.first)

    def select(self, chosen: Tensor) -> "Choices":
        """Some of the choices, by index or by mask."""
        return Choices(self.first[chosen], self.second[chosen], self.votes[chosen], self.materials[chosen])


@dataclass(frozen=True)
class ReliabilityBin:
    """Choices for which a calibration foretold about the same share, and what share of observers it was.

    Args:
        part: Of the answers: triplets, or pairs of approximations.
        predicted: The mean share that was foretold, for whichever distance is smaller.
        observed: The share that was found.
        low: Of its 95 % interval over materials.
        high: The same.
        votes: How many.
    """

    part: str
    predicted: float
    observed: float
    low: float
    high: float
    votes: float


def choices(triplets: Triplets, opinions: Opinions, names: list[str]) -> dict[str, Choices]:
    """What observers chose, by part; distances are those of `flat`.

    Triplets are choices as they are. Two mean opinions about approximations of one material are taken for so many
    observers' single opinions, each with the spread that `Opinions.standard_error` assumes. As in training, those of
    `ODD_METHOD` do not count.

    Args:
        triplets: Of materials.
        opinions: Of approximations.
        names: Of the materials, those of the triplets first.
    """
    count = len(triplets.materials)
    reference, one, other = triplets.questions.unbind(1)
    found = {
        "triplets": Choices(
            reference * count + one, reference * count + other, triplets.votes.double(), triplets.questions
        )
    }
    rows = [row for row, method in enumerate(opinions.methods) if method != ODD_METHOD]
    kept = opinions.select(rows)
    if rows and len(pairs := same_material(kept)):
        first, second = pairs.nearer, pairs.farther
        deviation = kept.standard_error * VOTES**0.5
        apart = (kept.distance[second] - kept.distance[first]) / torch.hypot(deviation[first], deviation[second])
        share = torch.special.ndtr(apart)
        place = torch.tensor(rows, dtype=torch.int64, device="cpu") + count**2
        about = torch.tensor([names.index(name) for name in kept.materials], dtype=torch.int64, device="cpu")
        votes = VOTES * torch.stack([share, 1 - share], 1)
        found["pairs"] = Choices(place[first], place[second], votes, about[first][:, None])
    return found


def flat(distances: Distances) -> Tensor | None:
    """Distances of a metric in one vector, those of triplets first; None if it has only some of them."""
    if distances.triplets is None or distances.opinions is None:
        return None
    return torch.cat([distances.triplets.flatten(), distances.opinions])


def calibrate(
    distances: Tensor, parts: Mapping[str, Choices], materials: int, replicates: int = 1000, seed: int = 0
) -> Discrimination:
    """Calibrate how well people tell things apart by their distance under a metric: maximum likelihood of the votes.

    Every part counts by its mean log-likelihood, as in training. The metric's error is integrated over: what people
    agree on and the metric does not know widens its spread, instead of making them look unsure. Covariance: materials
    drawn again, a choice weighing the product of how often its materials came, in one Newton step from the maximum.

    Args:
        distances: `(E,)`, at least 0.
        parts: Choices between them, by name.
        materials: How many there are.
        replicates: Of the bootstrap.
        seed: Of the bootstrap.

    Raises:
        DataError: There are no choices; distances are negative or not finite, or all 0.

    Source: L. L. Thurstone, A law of comparative judgment, 1927.
    """
    used = _used(distances, parts)
    unit = used.mean()
    scaled = distances / unit
    logs = _maximum(scaled, parts)
    covariance = _covariance(scaled, parts, logs, materials, replicates, seed)
    slope, scale, spread = logs.exp().tolist()
    ends = torch.tensor([OUTSIDE, 1 - OUTSIDE], dtype=used.dtype, device="cpu")
    ranges = torch.stack([_used(distances, {part: own}).quantile(ends) for part, own in parts.items()])
    lowest, highest = float(ranges[:, 0].min()), float(ranges[:, 1].max())
    length = float(unit)
    rounded = [[float(f"{x:.3g}") for x in row] for row in covariance.tolist()]
    slope, scale, spread = (float(f"{x:.4g}") for x in (slope / length, scale * length, spread))
    return Discrimination(slope, scale, spread, rounded, float(f"{lowest:.3g}"), float(f"{highest:.3g}"))


def reliability(
    distances: Tensor,
    parts: Mapping[str, Choices],
    materials: int,
    replicates: int = 1000,
    seed: int = 0,
    bins: int = 8,
) -> list[ReliabilityBin]:
    """Check a calibration: calibrate on half of the materials, foretell the choices about the others, and turn round.

    Args:
        distances: `(E,)`, at least 0.
        parts: Choices between them, by name.
        materials: How many there are.
        replicates: Of the bootstrap.
        seed: Of the halves and of the bootstrap.
        bins: Of each part, with about as many votes each.

    Raises:
        DataError: As `calibrate`; or a half has no choices.
    """
    generator = torch.Generator("cpu").manual_seed(seed)
    chosen = torch.zeros(materials, dtype=torch.bool, device="cpu")
    chosen[torch.randperm(materials, generator=generator, device="cpu")[: materials // 2]] = True
    foretold: dict[str, list[tuple[Choices, Tensor]]] = {part: [] for part in parts}
    for half in (chosen, ~chosen):
        inside = {part: own.select(half[own.materials].all(1)) for part, own in parts.items()}
        unit = _used(distances, inside).mean()
        logs = _maximum(distances / unit, inside)
        for part, own in parts.items():
            other = own.select((~half)[own.materials].all(1))
            with torch.no_grad():
                foretold[part].append((other, _chances(logs, distances / unit, other) @ _weights()))
    found = []
    for part, pairs in foretold.items():
        own = Choices(*(torch.cat([getattr(one, name) for one, _ in pairs]) for name in Choices.__dataclass_fields__))
        shares = torch.cat([share for _, share in pairs])
        if len(own):
            found += _bins(part, distances, own, shares, resample_counts(materials, replicates, seed), bins)
    return found


def mean_error(found: list[ReliabilityBin]) -> dict[str, float]:
    """How far observed shares are from those foretold, by part: the mean over votes of the bins' differences."""
    parts = dict.fromkeys(one.part for one in found)
    return {part: round(_mean_error([one for one in found if one.part == part]), 4) for part in parts}


def _mean_error(found: list[ReliabilityBin]) -> float:
    return sum(one.votes * abs(one.predicted - one.observed) for one in found) / sum(one.votes for one in found)


def _used(distances: Tensor, parts: Mapping[str, Choices]) -> Tensor:
    """The distances that observers chose between."""
    places = [place for own in parts.values() for place in (own.first, own.second)]
    if not places or not len(places[0]):
        raise DataError("a calibration: expected choices, found none")
    used = distances[torch.cat(places).unique()]
    bad = used[~((used >= 0) & used.isfinite())]
    if len(bad) or not bool((used > 0).any()):
        found = shown(float(bad[0])) if len(bad) else "only 0"
        raise DataError(f"a calibration: expected finite distances of at least 0, found {found}")
    return used


def _chances(logs: Tensor, distances: Tensor, own: Choices) -> Tensor:
    """The chance that an observer finds the first distance smaller, by the metric's two errors, `(C, nodes^2)`."""
    slope, scale, spread = logs.exp()
    factor = (spread * torch.tensor(NODES, dtype=torch.float64, device="cpu")).exp()
    first, second = (
        slope * scale * torch.log1p(distances[place][:, None] * factor / scale) for place in (own.first, own.second)
    )
    apart = (second[:, None, :] - first[:, :, None]).flatten(1)
    return LAPSE + (1 - 2 * LAPSE) * torch.special.ndtr(apart)


def _weights() -> Tensor:
    """Those of two errors of the metric, `(nodes^2,)`; their sum is 1."""
    weight = torch.tensor(NODE_WEIGHTS, dtype=torch.float64, device="cpu")
    return (weight[:, None] * weight / weight.sum() ** 2).flatten()


def _log_likelihoods(logs: Tensor, distances: Tensor, own: Choices) -> Tensor:
    """Log-likelihood of the votes of each pair, `(C,)`: all who see it see it with the same error of the metric."""
    chance = _chances(logs, distances, own)
    first, second = own.votes.unsqueeze(-1).unbind(1)
    return torch.logsumexp(first * chance.log() + second * (1 - chance).log() + _weights().log(), -1)


def _start() -> Tensor:
    return torch.tensor(START, dtype=torch.float64, device="cpu")


def _objective(logs: Tensor, distances: Tensor, parts: Mapping[str, Choices]) -> Tensor:
    means = [_log_likelihoods(logs, distances, own).sum() / own.votes.sum() for own in parts.values() if len(own)]
    return PRIOR * (logs - _start()).square().sum() - torch.stack(means).sum()


@undisturbed()
def _maximum(distances: Tensor, parts: Mapping[str, Choices]) -> Tensor:
    """Logarithms of slope, scale and spread, `(3,)`; there is nothing random in it."""
    logs = _start().requires_grad_()
    optimizer = torch.optim.LBFGS([logs], max_iter=100, tolerance_change=1e-10, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimizer.zero_grad()
        value = _objective(logs, distances, parts)
        value.backward()
        return value

    with torch.enable_grad():
        optimizer.step(closure)
    found = logs.detach()
    if not bool(found.isfinite().all()):
        raise DataError("a calibration: expected answers that depend on the distances, found no maximum of likelihood")
    return found


def _covariance(
    distances: Tensor, parts: Mapping[str, Choices], logs: Tensor, materials: int, replicates: int, seed: int
) -> Tensor:
    """Covariance of the logarithms over drawn materials, `(3, 3)`."""
    steps = STEP * torch.eye(3, dtype=torch.float64, device="cpu")
    draws = resample_counts(materials, replicates, seed).double()
    pull = torch.zeros(replicates, 3, dtype=torch.float64, device="cpu")
    for own in parts.values():
        if not len(own):
            continue
        slopes = torch.stack(
            [
                (_log_likelihoods(logs + step, distances, own) - _log_likelihoods(logs - step, distances, own))
                / (2 * STEP)
                for step in steps
            ],
            1,
        )
        for k, part in enumerate(draws):
            weight = part[own.materials].prod(1)
            pull[k] += weight @ slopes / (weight @ own.votes.sum(1)).clamp_min(1)
    pull -= 2 * PRIOR * (logs - _start())
    hessian = torch.autograd.functional.hessian(lambda at: _objective(at, distances, parts), logs)
    return torch.cov(torch.linalg.solve(hessian, pull.T))


def _bins(
    part: str, distances: Tensor, own: Choices, shares: Tensor, draws: Tensor, count: int
) -> list[ReliabilityBin]:
    """Bins of the shares that were foretold for the smaller distance, from 0.5 up, with about as many votes each."""
    swap = distances[own.first] > distances[own.second]
    predicted = torch.where(swap, 1 - shares, shares)
    won = torch.where(swap, own.votes[:, 1], own.votes[:, 0])
    total = own.votes.sum(1)
    order = predicted.argsort()
    passed = total[order].cumsum(0)
    number = torch.empty_like(order)
    number[order] = ((passed - total[order] / 2) / passed[-1] * count).long()
    found = []
    for k in range(count):
        inside = number == k
        if not inside.any():
            continue
        won_here, all_here = won[inside], total[inside]
        weight = torch.stack([row[own.materials[inside]].prod(1) for row in draws.double()])
        low, high = percentile_interval(((weight @ won_here) / (weight @ all_here))[:, None])[0].tolist()
        votes = float(all_here.sum())
        found.append(
            ReliabilityBin(
                part,
                float(predicted[inside] @ all_here) / votes,
                float(won_here.sum()) / votes,
                low,
                high,
                votes,
            )
        )
    return found
