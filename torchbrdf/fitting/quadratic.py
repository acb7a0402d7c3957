"""Small quadratic functions with bounds, many at once."""

import torch
from torch import Tensor


def minimize_quadratic(matrix: Tensor, slope: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """The points `(..., P)` within bounds where slope p + p matrix p / 2 is least.

    matrix: `(..., P, P)`, symmetric, positive definite; slope, lower, upper: `(..., P)`, lower <= 0 <= upper where the
    point 0 shall be allowed. Block principal pivoting: variables that leave their bounds are put on them, those that a
    bound no longer holds are released, all at once, until nothing changes (J. Portugal, J. Judice, L. Vicente, A
    Comparison of Block Pivoting and Interior-Point Algorithms for Linear Least Squares Problems with Nonnegative
    Variables, 1994, doi:10.1090/S0025-5718-1994-1250776-4). Where that cycles the last point, clamped, stands: it is
    within the bounds, but may be not quite the least.
    """
    size = matrix.shape[-1]
    shape = slope.shape
    matrix, slope = matrix.reshape(-1, size, size), slope.reshape(-1, size)
    lower, upper = lower.expand(shape).reshape(-1, size), upper.expand(shape).reshape(-1, size)
    point = torch.zeros_like(slope).clamp(lower, upper)
    side = torch.zeros_like(slope)  # -1 on the lower bound, 1 on the upper one, 0 free
    rows = torch.arange(len(slope), device=slope.device)
    identity = torch.eye(size, dtype=matrix.dtype, device=matrix.device)
    for k in range(3 * size + 3):
        a, b, low, high, where = matrix[rows], slope[rows], lower[rows], upper[rows], side[rows]
        free = (where == 0).to(a)
        fixed = torch.where(where < 0, low, torch.where(where > 0, high, 0))
        right = -(b + (a @ fixed[..., None])[..., 0]) * free
        kept = a * free[:, :, None] * free[:, None, :] + identity * (1 - free)[:, None, :]
        found, _ = torch.linalg.solve_ex(kept, right)
        found = torch.where(where == 0, found, fixed).nan_to_num(0)
        pull = (a @ found[..., None])[..., 0] + b
        scale = 1e-10 * (high - low)
        out = torch.where(found < low - scale, -1.0, torch.where(found > high + scale, 1.0, 0.0)) * free
        release = ((where < 0) & (pull < 0)) | ((where > 0) & (pull > 0))
        if k > size:  # one at a time, so that it does not go round in circles
            release &= out.abs().sum(-1, keepdim=True) == 0
        side[rows] = torch.where(release, 0, where + out)
        point[rows] = found.clamp(low, high)
        rows = rows[(release | (out != 0)).any(-1)]
        if not len(rows):
            break
    return point.reshape(shape)
