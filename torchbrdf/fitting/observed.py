"""The value of a loss of observations for many fits at once, with its gradient and the matrix of its normal equations.

What is observed of f_c = sum_k color_kc s_k is the same sum of what is observed of the columns: one sparse product a
step, and then only small arrays, one number for each observation.
"""

import torch
from torch import Tensor

from torchbrdf.fitting.columns import ErrorOfFits
from torchbrdf.fitting.data import Chunks
from torchbrdf.fitting.variables import Values
from torchbrdf.losses import ObservedLoss, Problem


class Observations:
    """A problem under a loss of observations: what is observed of the targets, `(M, P, 3)`.

    black: the value of a prediction that is 0 everywhere, `(M,)`, 1 where that is 0; spread: the same, as a unit for
    the rounding of cusps.
    """

    def __init__(self, problem: Problem, loss: ObservedLoss) -> None:
        self.loss, self.pairs, self.chunks = loss, problem.pairs, Chunks(problem.pairs)
        with torch.no_grad():
            self.target = loss.observe(problem.target)
            black = loss.value(torch.zeros_like(self.target), self.target).double()
        self.black = torch.where(black > 0, black, 1)
        self.spread = self.black

    def __len__(self) -> int:
        return len(self.target)


class ObservedError(ErrorOfFits):
    """As `SquaredError`, for a loss of observations."""

    data: Observations

    def __call__(self, x: Tensor, rows: Tensor, curvature: bool = True) -> tuple[Tensor, Tensor, Tensor]:
        """Value `(m,)`, gradient `(m, P)` and Gauss-Newton matrix `(m, P, P)` of the problems `rows`, float64."""
        columns, loss, dtype = self.columns, self.data.loss, self.data.target.dtype
        here = columns.at(x, rows, dtype)
        colors = columns.colors(here, dtype)
        seen = self._observe(here, len(rows))
        observed = torch.einsum("rck,rkcp->rpc", colors, seen[:, len(columns.slopes) :])
        target = self.data.target[self.materials[rows]]
        if curvature:
            width = None if self.width is None else self.width[rows]
            value, slope, curve = loss.parabola(observed, target, width)
        else:
            value, slope = _by_graph(loss, observed, target)
        jacobian = columns.jacobian(here, colors.double()).to(dtype)
        moved = torch.einsum("rqcp,rcqt->rtpc", seen[:, : len(columns.used)], jacobian).flatten(2)
        scale = self.scale[rows]
        gradient = (moved @ slope.flatten(1)[..., None])[..., 0].double() / scale[:, None]
        if not curvature:
            return value / scale, gradient, gradient.new_empty(0)
        curved = torch.einsum("rpcd,rtpd->rtpc", curve, moved.unflatten(2, (-1, 3))).flatten(2)
        matrix = (moved @ curved.transpose(1, 2)).double()
        return value / scale, gradient, (matrix + matrix.transpose(1, 2)) / (2 * scale[:, None, None])

    def _observe(self, here: Values, problems: int) -> Tensor:
        """What each channel observes of the columns, `(m, K, 3, P)`."""
        pairs, dtype = self.data.pairs, self.data.target.dtype
        count = len(self.columns.slopes) + len(self.columns.lobes)
        shapes = torch.empty(problems, count, len(pairs), dtype=dtype, device=pairs.device)
        for part, own in self.data.chunks(problems):
            for k, column in enumerate(self.columns.evaluate(own, here, dtype)):
                shapes[:, k, part] = column
        return self.data.loss.columns(shapes.flatten(0, 1)).unflatten(0, (problems, count))


def _by_graph(loss: ObservedLoss, observed: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    with torch.enable_grad():
        point = observed.detach().requires_grad_()
        value = loss.value(point, target)
        (slope,) = torch.autograd.grad(value.sum(), point)
    return value.detach().double(), slope
