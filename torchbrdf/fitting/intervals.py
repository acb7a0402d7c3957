"""How well a fit determines its parameters: intervals from the Gauss-Newton matrix, and from a bootstrap.

Both are of the misfit as a random thing. A model that cannot follow a measurement leaves a misfit that neighbouring
pairs share; the Gauss-Newton matrix takes every value for an observation of its own and gives short intervals then,
while the bootstrap draws whole stretches of neighbours.
"""

from collections.abc import Iterator, Sequence
from statistics import NormalDist
from typing import NamedTuple

import torch
from torch import Tensor

from torchbrdf import kinds
from torchbrdf.bootstrap import resample_counts
from torchbrdf.errors import UsageError
from torchbrdf.fitting.objective import FitObjective, GaussNewtonObjective
from torchbrdf.fitting.objective.pointwise import PointwiseObjective
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.fitting.task import levenberg_marquardt_fit
from torchbrdf.lobes.parameter_dict import ParameterDict, take_materials
from torchbrdf.losses import Problem

NONE, GAUSS_NEWTON, BOOTSTRAP = kinds.INTERVALS
METHODS = kinds.INTERVALS
LEVEL = 0.95
# Degrees of freedom for which the first terms of a series have all digits that an interval is told with.
MANY = 1000
# Stretches of neighbouring pairs that are drawn as one, draws, and draws that are refitted at a time.
BLOCKS, DRAWS, AT_A_TIME = 100, 100, 10
# A fit from which a step of all parameters would gain more than this share of the value is at no minimum.
NO_MINIMUM = 0.01
# Of a bound: closer than this share of the range a parameter is at it.
AT_BOUND = 1e-6


class Intervals(NamedTuple):
    """Both ends of M materials' parameters; nan where there is none: held, at a bound, or not at a minimum."""

    low: ParameterDict
    high: ParameterDict


def check_method(method: str) -> str:
    """One of METHODS.

    Raises:
        UsageError: it is none.
    """
    if method not in METHODS:
        raise UsageError(f"intervals: expected one of {', '.join(METHODS)}, found {method!r}")
    return method


def find_intervals(
    method: str, objective: FitObjective, values: ParameterDict, free: Parametrization, counts: Tensor, seed: int
) -> dict[str, Intervals]:
    """The intervals of fitted parameters by method; of none that a loss or a model has not.

    Args:
        method: one of METHODS; "bootstrap" gives those of the Gauss-Newton matrix, too.
        objective: what was minimised.
        values: what was found, for M materials.
        free: what was moved.
        counts: of each material the valid values, `(M,)`.
        seed: of the bootstrap.
    """
    if method == NONE or not isinstance(objective, GaussNewtonObjective):
        return {}
    found = {}
    if objective.loss.is_root and objective.loss.smoothing_widths == (None,):
        found[GAUSS_NEWTON] = gauss_newton_intervals(objective, values, free, counts)
    if method == BOOTSTRAP and isinstance(objective, PointwiseObjective):
        found[BOOTSTRAP] = bootstrap_intervals(objective, values, free, seed)
    return found


def joined_intervals(batches: Sequence[tuple[ParameterDict, dict[str, Intervals]]]) -> dict[str, Intervals]:
    """The intervals of several batches of materials, with their parameters, as one; nan of batches that have none."""
    found = {}
    for method in dict.fromkeys(method for _, own in batches for method in own):
        parts = [own.get(method) or Intervals(_nothing(values), _nothing(values)) for values, own in batches]
        low, high = ({name: torch.cat([part[end][name] for part in parts]) for name in parts[0].low} for end in (0, 1))
        found[method] = Intervals(low, high)
    return found


def gauss_newton_intervals(
    objective: GaussNewtonObjective, values: ParameterDict, free: Parametrization, counts: Tensor
) -> Intervals:
    """x -+ t s sqrt(diag (J' W J)^-1), with s^2 = sum of w r^2 / (n - p), on the scale on which the solver moves x.

    r are the n differences that a loss of squares compares, J their derivatives by the p parameters that are at no
    bound, t Student's 97.5 % point for n - p. As the value V is the mean of w r^2, and its Gauss-Newton matrix
    H = 2 J' W J over the sum of w, s^2 (J' W J)^-1 = 2 V H^-1 / (n - p).

    Source: G. Seber, C. Wild, Nonlinear Regression, 1989, section 5.1, doi:10.1002/0471725315.
    """
    x = free.encode(values).to(objective.zero_prediction_error.device)
    rows = torch.arange(len(x), dtype=torch.int64, device=x.device)
    value, gradient, matrix = (one.cpu() for one in objective.bind(free, values).quadratic_model(x, rows))
    x = x.cpu()
    lower, upper = free.limits()
    inside = ~_at_bound(x, lower, upper)
    # Scaled to a diagonal of 1; parameters that are not determined have no end of an interval but their bounds.
    scale = torch.diagonal(matrix, dim1=1, dim2=2).clamp_min(1e-300).rsqrt() * inside
    alone = torch.diag_embed((~inside).to(matrix))
    size, axes = torch.linalg.eigh((matrix * scale[:, :, None] * scale[:, None]).nan_to_num() + alone)
    inverse = (axes / size.clamp_min(1e-14)[:, None]) @ axes.mT
    covariance = inverse * scale[:, :, None] * scale[:, None]
    gain = 0.5 * (gradient[:, None] @ covariance @ gradient[..., None])[:, 0, 0]
    left = counts.cpu().double() - inside.sum(1)
    spread = (2 * value[:, None] * torch.diagonal(covariance, dim1=1, dim2=2) / left.clamp_min(1)[:, None]).sqrt()
    point = _student(left.clamp_min(1))
    known = inside & ((gain <= NO_MINIMUM * value + objective.fmin) & (left > 0))[:, None]
    half = point[:, None] * spread
    ends = [torch.where(known, (x + sign * half).clamp(lower, upper), torch.nan) for sign in (-1, 1)]
    return _intervals(ends[0], ends[1], values, free)


def bootstrap_intervals(
    objective: PointwiseObjective, values: ParameterDict, free: Parametrization, seed: int
) -> Intervals:
    """x -+ t s, with the standard deviation s of refits to stretches of pairs, drawn with replacement.

    The pairs that the solver saw are cut, in their order, in which those of a table are neighbours, into B stretches;
    as many are drawn, and all parameters are fitted to what was drawn from where the fit ended. t is Student's 97.5 %
    point for B - 1, on the scale on which the solver moves x.

    Source: B. Efron, R. Tibshirani, An Introduction to the Bootstrap, 1993, chapters 6 and 12; for stretches H. Künsch,
    The Jackknife and the Bootstrap for General Stationary Observations, 1989, doi:10.1214/aos/1176347265.
    """
    x, (lower, upper) = free.encode(values).cpu(), free.limits()
    inside = ~_at_bound(x, lower, upper)
    found = []
    for k in range(len(x)):
        own = take_materials(values, slice(k, k + 1))
        replicates = torch.cat([free.encode(drawn).cpu() for drawn in _refits(objective.select(k), own, free, seed)])
        found.append(replicates.std(0))
    blocks = min(BLOCKS, len(objective.problem.pairs))
    half = torch.stack(found) * _student(torch.tensor(max(blocks - 1.0, 1.0), dtype=torch.float64, device="cpu"))
    ends = [torch.where(inside, (x + sign * half).clamp(lower, upper), torch.nan) for sign in (-1, 1)]
    return _intervals(ends[0], ends[1], values, free)


def _student(degrees: Tensor) -> Tensor:
    """The upper end of Student's interval for so many degrees of freedom.

    Source: of that for many, M. Abramowitz, I. A. Stegun, Handbook of Mathematical Functions, 1964, 26.7.5.
    """
    if (degrees > MANY).all():
        z = NormalDist().inv_cdf((1 + LEVEL) / 2)
        first = (z**3 + z) / 4
        second = (5 * z**5 + 16 * z**3 + 3 * z) / 96
        third = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
        return z + first / degrees + second / degrees**2 + third / degrees**3
    from scipy.special import stdtrit  # late, as it takes longer to import than a small fit

    return torch.as_tensor(stdtrit(degrees.numpy(), (1 + LEVEL) / 2), dtype=torch.float64, device="cpu")


def _refits(
    objective: PointwiseObjective, values: ParameterDict, free: Parametrization, seed: int
) -> Iterator[ParameterDict]:
    """The parameters of refits of one material, some draws at a time."""
    problem, last = objective.problem, objective.loss.smoothing_widths[-1:]
    pairs, count = problem.pairs, len(problem.pairs)
    blocks = min(BLOCKS, count)
    block = torch.arange(count, dtype=torch.int64, device=problem.target.device) * blocks // count
    drawn = resample_counts(blocks, DRAWS, seed).to(problem.target)
    for counts in drawn.split(AT_A_TIME):
        weight = counts[:, block, None]
        if problem.weight is not None:
            weight = weight * problem.weight
        target = problem.target.expand(len(counts), -1, -1)
        again = type(objective)(Problem(pairs, target, weight), objective.loss)
        start = {name: value.expand(len(counts), *value.shape[1:]) for name, value in values.items()}
        yield levenberg_marquardt_fit(again, start, free, max_iterations=20, ftol=1e-6, widths=last)[0]


def _at_bound(x: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    close = AT_BOUND * (upper - lower)
    return (x <= lower + close) | (x >= upper - close)


def _intervals(low: Tensor, high: Tensor, values: ParameterDict, free: Parametrization) -> Intervals:
    """Ends `(M, P)` on the solver's scale as parameters, with nan for those that were held."""
    held = _nothing(values)
    dtype = next(iter(held.values())).dtype
    return Intervals(held | free.decode(low, dtype), held | free.decode(high, dtype))


def _nothing(values: ParameterDict) -> ParameterDict:
    """nan for every parameter."""
    return {name: torch.full_like(value, torch.nan, device="cpu") for name, value in values.items()}
