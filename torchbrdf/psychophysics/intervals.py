"""How far scale values may be off: by the model, by how observers differ, by a formula, and by a bootstrap."""

from typing import Literal, get_args

import torch
from torch import Tensor

from torchbrdf.bootstrap import resample_counts
from torchbrdf.progress import Progress, quiet
from torchbrdf.psychophysics.comparisons import Comparisons, connected
from torchbrdf.psychophysics.thurstone import (
    PRIOR,
    centred,
    covariance,
    laplacian,
    least_squares,
    maximum,
    null_space_projector,
    score_function,
    win_rates,
)
from torchbrdf.registry import unknown

Method = Literal["likelihood", "least_squares"]
NORMAL_95 = 1.959963984540054
# Numbers in the largest tensor of one chunk of draws: 16 MiB, of which a fit needs some ten.
CHUNK = 2**21


def montag(stimuli: Tensor, observations: Tensor) -> Tensor:
    """Montag's formula for the standard deviation of a least-squares scale value.

    nan for 2.55 observations of a pair and fewer.
    sigma = 1.76 (n + 3.08)^-0.613 (N - 2.55)^-0.491 with n stimuli and N observations of every pair; 1.96 sigma is
    the half width of a 95 % interval. For n of 3 to 20 and N of 15 to 100 it is right within 4 % of the exact value
    where all stimuli are equal or span 0.5 units, and within 10 % where they span 1 unit. Where they span 2 it is up to
    36 % too small; with neighbours 1 apart, from 36 % too small to 2.4 times too large.

    Source: E. D. Montag, Empirical formula for creating error bars for the method of paired comparison, Journal of
    Electronic Imaging 15(1), 010502, 2006, doi:10.1117/1.2181547.
    """
    known = observations > 2.55
    sigma = 1.76 * (stimuli + 3.08) ** -0.613 * (torch.where(known, observations, 3.0) - 2.55) ** -0.491
    return torch.where(known, sigma, torch.nan)


def fitted(wins: Tensor, method: Method, prior: float = PRIOR) -> Tensor:
    """Scale `(..., n)` of wins `(..., n, n)` by a method's name."""
    if method not in get_args(Method):
        raise unknown("method of scaling", method, get_args(Method))
    return least_squares(wins) if method == "least_squares" else maximum(wins, prior)


def covariances(comparisons: Comparisons, scale: Tensor, method: Method, prior: float = PRIOR) -> tuple[Tensor, Tensor]:
    """Covariances `(M, n, n)` of a scale `(M, n)`: by the model, and by how observers differ.

    The first takes all answers for independent. The second, O / (O - 1) sum_o (A u_o) (A u_o)^T, allows for observers
    who have their own preferences: u_o is what the answers of observer o pull at the scale, and A how far it gives.
    It is 0 with one observer, and too small where answers are unanimous.

    Source: K.-Y. Liang, S. L. Zeger, Biometrika 73(1), 1986, doi:10.1093/biomet/73.1.13, for the second.
    """
    compared = comparisons.compared
    if method == "likelihood":
        by_model = gives = covariance(compared, scale, prior)
        pulls = score_function(comparisons.wins, scale)
    else:
        share = win_rates(comparisons.total, compared)
        z = torch.special.ndtri(share)
        density = torch.exp(-0.5 * z.square()) / (2 * torch.pi) ** 0.5
        per_answer = (compared > 0) / (compared.clamp(min=1) * density)
        gives = centred(
            torch.linalg.inv(laplacian((compared > 0).to(share)) + null_space_projector(compared)), compared
        )
        by_model = gives @ laplacian(compared * per_answer.square() * share * (1 - share)) @ gives
        compared = comparisons.wins + comparisons.wins.mT
        pulls = ((comparisons.wins - share * compared) * per_answer).sum(-1)
    displacement = torch.einsum("mij,omj->omi", gives.nan_to_num(), pulls)
    count = (comparisons.wins.sum((-2, -1)) > 0).sum(0).to(scale)
    by_observers = (
        torch.einsum("omi,omj->mij", displacement, displacement) * (count / (count - 1).clamp(min=1))[:, None, None]
    )
    # With one observer the sum is only how far the prior pulls.
    by_observers *= (count > 1)[:, None, None]
    return by_model, by_observers.masked_fill(gives.isnan(), torch.nan)


def bootstrap(
    comparisons: Comparisons,
    draws: int = 1000,
    seed: int = 0,
    method: Method = "likelihood",
    prior: float = PRIOR,
    progress: Progress = quiet,
) -> Tensor:
    """Bootstrap of scales over observers: scales `(B, M, n)` of observers drawn with replacement.

    Where the comparisons of a draw do not link all stimuli of a material, its values are nan.

    Source: B. Efron, R. Tibshirani, An Introduction to the Bootstrap, 1993.
    """
    observers, materials, n, _ = comparisons.wins.shape
    counts = resample_counts(observers, draws, seed).double()
    wins, present = comparisons.wins.reshape(observers, -1), comparisons.present
    scales = torch.empty(draws, materials, n, dtype=torch.float64, device="cpu")
    chunk = max(1, CHUNK // (materials * n * n))
    for first in range(0, draws, chunk):
        won = (counts[first : first + chunk] @ wins).reshape(-1, materials, n, n)
        compared = won + won.mT
        whole = connected(compared) & ((compared > 0).any(-1) == present).all(-1)
        scales[first : first + chunk] = fitted(won, method, prior).masked_fill(~whole[..., None], torch.nan)
        progress(min(first + chunk, draws), draws)
    return scales
