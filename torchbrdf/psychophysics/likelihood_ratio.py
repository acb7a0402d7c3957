"""Whether one scale can explain the answers at all."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.progress import Progress, quiet
from torchbrdf.psychophysics.intervals import CHUNK, Method, fitted
from torchbrdf.psychophysics.simulate import simulated_wins
from torchbrdf.psychophysics.thurstone import PRIOR


@dataclass(frozen=True)
class Goodness:
    """Test of goodness of fit for each material: the statistic G^2, its degrees of freedom, and p, `(M,)`.

    A small p says that no scale explains the answers: they are circular, or the unit is not the same everywhere. p is
    nan without degrees of freedom, as with two stimuli, and without draws.
    """

    statistic: Tensor
    dof: Tensor
    p: Tensor


def goodness(
    wins: Tensor,
    scale: Tensor,
    draws: int = 1000,
    seed: int = 0,
    method: Method = "likelihood",
    prior: float = PRIOR,
    progress: Progress = quiet,
) -> Goodness:
    """Likelihood-ratio test of goodness of fit: a scale `(M, n)` against a share for each pair; wins `(M, n, n)`.

    G^2 = 2 sum_ij w_ij log(p_ij / Phi(s_i - s_j)), p_ij the share of wins; degrees of freedom: the pairs compared,
    less n - 1. p is the share of G^2 that are as large among answers simulated with the scale and fitted again, because
    few or unanimous answers a pair are far from a chi-square distribution: (1 + larger) / (1 + draws). Simulated, it
    rejects 1 to 6 % of true scales at p < 0.05, with 6 to 30 answers a pair of 5 stimuli; by chi-square, 0 to 11 %. It
    takes answers for independent; observers who differ make it inexact.

    Source: as D. Collett, Modelling Binary Data, 2003, for G^2; A. C. Davison, D. V. Hinkley, Bootstrap Methods and
    their Application, 1997, for p.
    """
    compared = wins + wins.mT
    pairs, n = (compared > 0).sum((-2, -1)) // 2, wins.shape[-1]
    dof = pairs - ((compared > 0).any(-1).sum(-1) - 1).clamp(min=0)
    statistic = likelihood_ratio(wins, scale)
    generator = torch.Generator("cpu").manual_seed(seed)
    larger = torch.zeros(len(wins), dtype=torch.float64, device="cpu")
    chunk = max(1, CHUNK // (len(wins) * n * n))
    for first in range(0, draws, chunk):
        count = min(chunk, draws - first)
        drawn = simulated_wins(scale.expand(count, -1, -1), compared, generator)
        again = likelihood_ratio(drawn, fitted(drawn, method, prior))
        # Equal answers are equal, whatever the rounding of a sum.
        larger += (again >= statistic - 1e-9 * (1 + statistic)).sum(0)
        progress(first + count, draws)
    p = (1 + larger) / (1 + draws) if draws else torch.full_like(larger, torch.nan)
    return Goodness(statistic, dof, p.masked_fill(dof < 1, torch.nan))


def likelihood_ratio(wins: Tensor, scale: Tensor) -> Tensor:
    """Likelihood-ratio statistic G^2 `(...)` of wins `(..., n, n)` and a scale `(..., n)`; see `goodness`."""
    difference = (scale.unsqueeze(-1) - scale.unsqueeze(-2)).nan_to_num()
    share = wins / (wins + wins.mT).clamp(min=1)
    return 2 * (torch.special.xlogy(wins, share) - wins * torch.special.log_ndtr(difference)).sum((-2, -1))
