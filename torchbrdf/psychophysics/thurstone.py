"""Scales from counts of paired comparisons: Thurstone's case V, by least squares and by most likely values.

The unit is the standard deviation of the difference of two internal values: P(i is preferred to j) = Phi(s_i - s_j).
The mean of each scale is 0. Wins are counts `(..., n, n)`, float64: wins[i, j], how often i was preferred to j. A
stimulus that was never compared has the value nan.

Source: L. L. Thurstone, A law of comparative judgment, Psychological Review 34, 1927, doi:10.1037/h0070288.
"""

import math

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.psychophysics.comparisons import connected

PRIOR = 1.5
# As good as none; beyond, unanimous answers leave a matrix that rounding makes singular.
LARGEST_PRIOR = 1e4
ITERATIONS = 100
# A Newton step so short, in standard deviations, that the maximum is reached.
NEGLIGIBLE = 1e-9
_LOG_ROOT = 0.5 * math.log(2 * math.pi)


def least_squares(wins: Tensor) -> Tensor:
    """Classical Thurstone scale `(..., n)` of wins `(..., n, n)`, by least squares of s_i - s_j - z_ij.

    z_ij = Phi^-1(p_ij) with p_ij the share of wins; 0 and 1 become 1/(2N) and 1 - 1/(2N), N comparisons of the pair.
    Where all pairs are compared, s_i is the mean of row i of z. Where the comparisons do not link all stimuli, nan.
    It has a bias: unanimous pairs draw stimuli together that are far apart.

    Source: F. Mosteller, Psychometrika 16(1), 1951, doi:10.1007/BF02313422; H. Gulliksen, for incomplete data,
    Psychometrika 21(2), 1956, doi:10.1007/BF02289093; N. Macmillan, H. Kaplan, for unanimous pairs, Psychological
    Bulletin 98(1), 1985, doi:10.1037/0033-2909.98.1.185.
    """
    compared = checked(wins)
    whole = connected(compared)
    z = torch.special.ndtri(win_rates(wins, compared)) * (compared > 0)
    matrix = laplacian((compared > 0).to(wins)) + null_space_projector(compared)
    # Parts that are not linked make it singular.
    matrix = torch.where(
        whole[..., None, None], matrix, torch.eye(wins.shape[-1], dtype=wins.dtype, device=wins.device)
    )
    scale = torch.linalg.solve(matrix, z.sum(-1))
    return scale.masked_fill(~(whole[..., None] & (compared > 0).any(-1)), torch.nan)


def map_estimate(wins: Tensor, prior: float = PRIOR) -> tuple[Tensor, Tensor]:
    """Thurstone scale `(..., n)` of the greatest posterior density, and its covariance `(..., n, n)`.

    wins: `(..., n, n)`.
    The maximum of sum_ij w_ij log Phi(s_i - s_j) - sum_i s_i^2 / (2 sigma^2), which is concave. Some pairs may be
    compared more often than others, or not at all. sigma^2 = prior^2 (n^2 - 1) / 12 is the variance of n values that
    are evenly spaced, `prior` units apart. The covariance is the inverse of the expected information, with the
    prior's, where the mean is 0.

    prior: without one, unanimous answers put a stimulus infinitely far away, and scales are too wide: 1.14 times for 4
    stimuli 1 unit apart and 20 observers, on average. 1.5 was chosen by simulation among 1, 1.5, 2, 2.5 and 3 (2 to 15
    stimuli, 15 to 60 observers): with neighbours 1 apart the width is right within 5 %, and the intervals of `scale`
    hold; 2 apart, it is 8 to 18 % too small with 20 observers. The prior counts as much as two observers for two
    stimuli, and less than one for four or more. 10000 is as good as none.

    Source: R. D. Bock, L. V. Jones, The Measurement and Prediction of Judgment and Choice, 1968, for the likelihood;
    M. Perez-Ortiz, R. K. Mantiuk, arXiv:1712.03686, 2017, for a prior against its bias.
    """
    scale = maximum(wins, prior)
    return scale, covariance(wins + wins.mT, scale, prior)


def maximum(wins: Tensor, prior: float = PRIOR) -> Tensor:
    """Maximum of the posterior density: the scale of `map_estimate` alone, by Newton's method from 0.

    Of some 360 000 problems made to be hard (unbalanced counts of up to a million, next to no prior), none needed
    shorter steps. One that did not end would be nan.
    """
    compared = checked(wins)
    n = wins.shape[-1]
    counts, pairs = wins.reshape(-1, n, n), compared.reshape(-1, n, n)
    precision, fixed = prior_precision(pairs, prior)[:, None], null_space_projector(pairs)
    scale = torch.zeros(len(counts), n, dtype=wins.dtype, device=wins.device)
    rows = torch.arange(len(counts), dtype=torch.int64, device="cpu")
    for _ in range(ITERATIONS):
        at, held = scale[rows], precision[rows]
        difference = at.unsqueeze(-1) - at.unsqueeze(-2)
        hazard = _hazard(difference)
        slope = counts[rows] * hazard
        curve = slope * (difference + hazard)
        gradient = slope.sum(-1) - slope.sum(-2) - held * at
        matrix = laplacian(curve + curve.mT) + fixed[rows]
        matrix.diagonal(dim1=-2, dim2=-1).add_(held)
        step = torch.cholesky_solve(gradient.unsqueeze(-1), torch.linalg.cholesky(matrix)).squeeze(-1)
        scale[rows] += step
        rows = rows[(gradient * step).sum(-1) > NEGLIGIBLE**2]
        if not len(rows):
            break
    scale[rows] = torch.nan
    return scale.reshape(wins.shape[:-1]).masked_fill(~(compared > 0).any(-1), torch.nan)


def covariance(compared: Tensor, scale: Tensor, prior: float = PRIOR) -> Tensor:
    """Covariance `(..., n, n)` of a most likely scale `(..., n)`, by symmetric counts `(..., n, n)`.

    The inverse of the Laplacian of N_ij phi(d)^2 / (Phi(d) Phi(-d)), d = s_i - s_j, plus the prior's precision, where
    the mean is 0; nan for stimuli that were not compared.
    """
    difference = (scale.unsqueeze(-1) - scale.unsqueeze(-2)).nan_to_num()
    matrix = laplacian(compared * information(difference)) + null_space_projector(compared)
    matrix.diagonal(dim1=-2, dim2=-1).add_(prior_precision(compared, prior)[..., None])
    return centred(torch.linalg.inv(matrix), compared)


def information(difference: Tensor) -> Tensor:
    """The expected information of one comparison about the difference d: phi(d)^2 / (Phi(d) Phi(-d))."""
    return torch.exp(
        -difference.square() - 2 * _LOG_ROOT - torch.special.log_ndtr(difference) - torch.special.log_ndtr(-difference)
    )


def score_function(wins: Tensor, scale: Tensor) -> Tensor:
    """Score function: the gradient `(..., n)` of the log-likelihood at a scale `(..., n)`, without the prior.

    wins: `(..., n, n)`.
    """
    difference = (scale.unsqueeze(-1) - scale.unsqueeze(-2)).nan_to_num()
    slope = wins * _hazard(difference)
    return slope.sum(-1) - slope.sum(-2)


def _hazard(difference: Tensor) -> Tensor:
    """phi(d) / Phi(d), the derivative of log Phi(d)."""
    return torch.exp(-0.5 * difference.square() - _LOG_ROOT - torch.special.log_ndtr(difference))


def win_rates(wins: Tensor, compared: Tensor) -> Tensor:
    """The share of wins of each pair, from 1/(2N) to 1 - 1/(2N); 1/2 where it was not compared."""
    count = compared.clamp(min=1)
    share = torch.where(compared > 0, wins / count, 0.5)
    return torch.minimum(torch.maximum(share, 0.5 / count), 1 - 0.5 / count)


def laplacian(weights: Tensor) -> Tensor:
    """The Laplacian `(..., n, n)` of symmetric weights of pairs: sum_ij w_ij (s_i - s_j)^2 / 2 = s^T L s."""
    weights = weights - torch.diag_embed(weights.diagonal(dim1=-2, dim2=-1))
    return torch.diag_embed(weights.sum(-1)) - weights


def null_space_projector(compared: Tensor) -> Tensor:
    """Projector onto the null space of Laplacians `(..., n, n)`; added, it makes them invertible.

    Solutions keep a mean of 0.

    1/n between stimuli that were compared with any other; 1 on the diagonal of the rest.
    """
    present = (compared > 0).any(-1).to(compared)
    between = present.unsqueeze(-1) * present.unsqueeze(-2) / present.sum(-1).clamp(min=1)[..., None, None]
    return between + torch.diag_embed(1 - present)


def centred(matrix: Tensor, compared: Tensor) -> Tensor:
    """Covariances `(..., n, n)` without the mean's part; nan for stimuli that were not compared."""
    keep = torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device) - null_space_projector(compared)
    absent = ~(compared > 0).any(-1)
    return (keep @ matrix @ keep).masked_fill(absent.unsqueeze(-1) | absent.unsqueeze(-2), torch.nan)


def prior_precision(compared: Tensor, prior: float) -> Tensor:
    """The prior's precision 1 / sigma^2 of each scale value, `(...)`; see `map_estimate`."""
    if not 0 < prior <= LARGEST_PRIOR:
        raise UsageError(f"prior: expected more than 0 and at most {LARGEST_PRIOR}, found {prior}")
    count = (compared > 0).any(-1).sum(-1).clamp(min=2)
    return 12 / (prior**2 * (count.to(torch.float64).square() - 1))


def checked(wins: Tensor) -> Tensor:
    """Check counts of wins, and count how often each pair was compared, `(..., n, n)`; else a ShapeError."""
    if wins.dim() < 2 or wins.shape[-1] != wins.shape[-2] or wins.dtype != torch.float64:
        raise ShapeError(f"wins: expected (..., n, n), float64, found {(*wins.shape,)}, {wins.dtype}")
    if not bool((wins >= 0).all()) or bool((wins.diagonal(dim1=-2, dim2=-1) != 0).any()):
        raise ShapeError("wins: expected counts, with zeros on the diagonal, found others")
    return wins + wins.mT
