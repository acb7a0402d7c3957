"""Scales of all materials of a study, with their intervals."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.progress import Progress, part_of, quiet
from torchbrdf.psychophysics.comparisons import Comparisons
from torchbrdf.psychophysics.intervals import NORMAL_95, Method, bootstrap, covariances, fitted, montag
from torchbrdf.psychophysics.likelihood_ratio import Goodness, goodness
from torchbrdf.psychophysics.thurstone import PRIOR

# Fits times the cube of their stimuli: an hour or so.
MOST_WORK = 3e11


@dataclass(frozen=True)
class Scales:
    """Scales of all materials of a study, in units of the standard deviation of a difference; higher is preferred.

    value, low, high: `(M, n)`, the scale, its mean 0, and its 95 % interval; nan beyond a material's stimuli.
    covariance, between: `(M, n, n)`, by the model and by how observers differ; the larger variance makes the interval.
    montag: `(M,)`, half width of the 95 % interval by Montag's formula, which is to be reported beside.
    observations: `(M,)`, mean number of answers a compared pair. goodness: whether a scale explains the answers.
    draws: `(B, M, n)`, scales of observers drawn with replacement, to derive other figures from.
    """

    materials: list[str]
    stimuli: list[list[str]]
    value: Tensor
    low: Tensor
    high: Tensor
    covariance: Tensor
    between: Tensor
    montag: Tensor
    observations: Tensor
    goodness: Goodness
    draws: Tensor
    method: Method

    def difference(self, material: int, i: int, j: int) -> tuple[float, float, float]:
        """Difference of stimuli i and j on a material's scale, with its 95 % interval: value, low, high."""
        value = float(self.value[material, i] - self.value[material, j])
        both = torch.stack([self.covariance[material], self.between[material]])
        variance = (both[:, i, i] + both[:, j, j] - 2 * both[:, i, j]).clamp(min=0).max()
        half = NORMAL_95 * float(variance.sqrt())
        return value, value - half, value + half

    def records(self) -> list[dict[str, Any]]:
        """A row for each stimulus of each material, for a table.

        bootstrap_low, bootstrap_high: the percentiles 2.5 and 97.5 of `draws`, which are too narrow, see `scale`; nan
        without draws.
        """
        ends = self.draws.new_tensor([0.025, 0.975])
        drawn = (
            self.draws.nanquantile(ends, 0)
            if len(self.draws)
            else torch.full((2, *self.value.shape), torch.nan, dtype=torch.float64, device="cpu")
        )
        return [
            {
                "material": material,
                "stimulus": stimulus,
                "scale": float(self.value[m, k]),
                "low": float(self.low[m, k]),
                "high": float(self.high[m, k]),
                "montag_low": float(self.value[m, k] - self.montag[m]),
                "montag_high": float(self.value[m, k] + self.montag[m]),
                "bootstrap_low": float(drawn[0, m, k]),
                "bootstrap_high": float(drawn[1, m, k]),
                "observations": float(self.observations[m]),
            }
            for m, material in enumerate(self.materials)
            for k, stimulus in enumerate(self.stimuli[m])
        ]


def scale(
    comparisons: Comparisons,
    method: Method = "likelihood",
    draws: int = 1000,
    seed: int = 0,
    prior: float = PRIOR,
    progress: Progress = quiet,
) -> Scales:
    """Thurstone scales of paired comparisons, with 95 % intervals.

    The intervals are value +- 1.96 sqrt(max(variance by the model, variance by how observers differ)).
    How often such intervals hold the true value, simulated, by method "likelihood", on average over the stimuli:
    - 94 to 97 % with 2 to 20 stimuli, 15 to 30 observers, and neighbours 0 to 1 apart (no stimulus under 93 % or over
      98 %); a difference of neighbours 1 apart, 95 to 98 %; with 8 or 10 observers, 96 to 97.3 %;
    - 93.5 to 97 % if observers have preferences of their own, a standard deviation of 0.5 for each stimulus; by the
      model's variance alone, as low as 80 %;
    - 90 to 98 % with neighbours 1.5 to 2 apart: the ends of a scale are then drawn inwards, see `map_estimate`.
    Percentiles of a bootstrap over 10 to 20 observers held it 93 % of the time at best, and 81 % at worst.
    By method "least_squares" they hold for scales that span 2 units at most; beyond, its bias makes them worthless.

    Args:
        comparisons: Of M materials with at most n stimuli.
        method: "likelihood", see `map_estimate`, or "least_squares".
        draws: Of the bootstrap over observers, and of the test of goodness.
        seed: Of both.
        prior: Of the likelihood, in units of the scale, see `map_estimate`.
        progress: Of the draws.

    Returns:
        Scales in units of the standard deviation of a difference.

    Raises:
        DataError: Comparisons do not link all stimuli of a material.
        UsageError: There is no such method, the prior is out of range, or it is the work of more than some hours.

    Example:
        >>> wins = torch.tensor([[[[0.0, 15.0], [5.0, 0.0]]]], dtype=torch.float64)
        >>> found = scale(Comparisons(["nickel"], [["ward", "cook"]], ["all"], wins), draws=0)
        >>> found.value[0].round(decimals=3).tolist()
        [0.312, -0.312]
    """
    check_work(comparisons, draws)
    comparisons.check_connected()
    value = fitted(comparisons.total, method, prior)
    by_model, between = covariances(comparisons, value, method, prior)
    variance = torch.maximum(by_model.diagonal(dim1=-2, dim2=-1), between.diagonal(dim1=-2, dim2=-1))
    half = NORMAL_95 * variance.clamp(min=0).sqrt()
    compared, present = comparisons.compared, comparisons.present
    observations = compared.sum((-2, -1)) / (compared > 0).sum((-2, -1)).clamp(min=1)
    return Scales(
        materials=comparisons.materials,
        stimuli=comparisons.stimuli,
        value=value,
        low=value - half,
        high=value + half,
        covariance=by_model,
        between=between,
        montag=NORMAL_95 * montag(present.sum(-1).to(torch.float64), observations),
        observations=observations,
        goodness=goodness(comparisons.total, value, draws, seed, method, prior, part_of(progress, 0, 2 * draws)),
        draws=bootstrap(comparisons, draws, seed, method, prior, part_of(progress, draws, 2 * draws)),
        method=method,
    )


def check_work(comparisons: Comparisons, draws: int) -> None:
    """Refuse what would take days: a UsageError."""
    observers, materials, n, _ = comparisons.wins.shape
    if draws < 0 or (draws + observers) * materials * n**3 > MOST_WORK:
        most = int((MOST_WORK / materials / max(draws + observers, 1)) ** (1 / 3))
        raise UsageError(
            f"scale: expected at most {most} stimuli with {materials} materials, {observers} observers and {draws} "
            f"draws of the bootstrap, found {n}"
        )
