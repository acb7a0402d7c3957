"""Which parameters a fit determines, and the precision that it takes for them not to depend on how work is cut.

Two batches add the same numbers in another order, and a search that compares hundreds of nearly equal errors makes of
the last digit another minimum. In double precision that digit does not count; fits of few pairs cost the same in it.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchbrdf.fitting.objective import FitObjective, GaussNewtonObjective
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.fitting.tabulated_problem import is_tabulated
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured
from torchbrdf.precision import HALVES

SMALL = 2048
"""Pairs up to which materials are fitted in float64, whatever their values are in."""
CHANGE, MOVE = 1e-5, 1e-2
"""A share of the error, and of a parameter: what moves by more while the error changes by less is not determined."""
# Linear parameters count as no smaller than this share of their range, as most may be 0.
_LEAST = 1e-2
# Of the largest eigenvalue, at a diagonal of 1: smaller ones are rounding.
_ROUNDING = {torch.float32: 1e-6, torch.float64: 1e-12}
# Of a bound: closer than this share of the range a parameter is at it. Of the value: what a minimum has left to gain.
_AT_BOUND, _LEFT = 1e-6, 1e-3


def working_dtype(measured: Measured, loss: Loss) -> torch.dtype:
    """What a fit works in: that of the values, float64 for few pairs, and float32 for half precision.

    Args:
        measured: materials.
        loss: of the fit; pictures have pairs of their own, which are many.
    """
    if len(measured.pairs) <= SMALL and loss.supports_subsampling and not loss.needs_rgb:
        return torch.float64
    return torch.float32 if measured.dtype in HALVES else measured.dtype


def undetermined(objective: FitObjective, values: ParameterDict, free: Parametrization) -> ParameterDict:
    """Of each number of each parameter, whether the error leaves it open; nothing where curvature is not known.

    With the value V of the objective and its Gauss-Newton matrix H, the others following, a parameter moves by
    sqrt(2 c V (H^-1)_ii) until V has changed by the share c. Open are those that move too far by that, all of a
    material that is at no minimum, and those of a lobe without any albedo, as H does not know them.

    Args:
        objective: what was minimised.
        values: what was found, for M materials.
        free: what was moved.

    Returns:
        Truths in the shapes of the parameters, of the free ones.
    """
    if not isinstance(objective, GaussNewtonObjective) or is_tabulated(free.model):
        return {}
    if objective.surrogate() is not objective:  # a picture's, that has gradients only
        return {}
    x = free.encode(values).to(objective.zero_prediction_error.device)
    rows = torch.arange(len(x), dtype=torch.int64, device=x.device)
    last = objective.loss.smoothing_widths[-1:]
    width = None if not last or last[0] is None else last[0] * objective.target_scale
    bound = objective.bind(free, values, width=width)
    value, gradient, matrix = (one.cpu().nan_to_num() for one in bound.quadratic_model(x, rows))
    x, (lower, upper) = x.cpu(), free.limits()
    close = _AT_BOUND * (upper - lower)
    held = ((x <= lower + close) & (gradient > 0)) | ((x >= upper - close) & (gradient < 0))
    diagonal = torch.diagonal(matrix, dim1=1, dim2=2)
    unseen = diagonal <= diagonal.amax(1, keepdim=True) * _ROUNDING[torch.float64]
    inside = ~held & ~unseen
    scale = diagonal.clamp_min(1e-300).rsqrt() * inside
    size, axes = torch.linalg.eigh(matrix * scale[:, :, None] * scale[:, None] + torch.diag_embed((~inside).to(matrix)))
    floor = _ROUNDING.get(objective.problem.target.dtype, 1e-6)
    inverse = (axes / size.clamp_min(floor)[:, None]) @ axes.mT * scale[:, :, None] * scale[:, None]
    left = 0.5 * (gradient[:, None] @ inverse @ gradient[..., None])[:, 0]
    near = left <= _LEFT * value[:, None] + objective.fmin
    moved = (2 * CHANGE * (value[:, None] + objective.fmin) * torch.diagonal(inverse, dim1=1, dim2=2)).sqrt()
    open_ = unseen | ~near | (moved > MOVE * _sizes(x, free))
    parts = zip(free.free, open_.split([one.width for one in free.free], 1), strict=True)
    return {name: one.shaped(part) for one, part in parts for name in one.names}


def _sizes(x: Tensor, free: Parametrization) -> Tensor:
    """What counts as all of a number, on the solver's scale, `(M, P)`: 1 of a logarithm."""
    lower, upper = free.limits()
    logs = [one.spec.log for one in free.free for _ in range(one.width)]
    is_log = torch.tensor(logs, dtype=torch.bool, device="cpu")
    return torch.where(is_log, 1.0, torch.maximum(x.abs(), _LEAST * (upper - lower)))


def joined_truths(batches: Sequence[tuple[ParameterDict, ParameterDict]]) -> ParameterDict:
    """What `undetermined` gave for several batches of materials as one; all of a batch that has nothing is open."""
    names = dict.fromkeys(name for _, own in batches for name in own)
    return {name: torch.cat([_truths(name, *one) for one in batches]) for name in names}


def _truths(name: str, values: ParameterDict, own: ParameterDict) -> Tensor:
    return own[name] if name in own else torch.ones_like(values[name], dtype=torch.bool, device="cpu")
