"""The squared error of many fits at once, with its gradient and the matrix of its normal equations.

Every analytic loss is a mean of penalty(encode(f) - encode(target)), so that all derivatives follow from the columns:
no graph, a handful of passes over pairs that lie in the processor's cache, and sums over pairs as matrix products. A
loss of groups adds squares of residuals that are linear in averages of those differences.
"""

import torch
from torch import Tensor

from torchbrdf.fitting.averages import Averages
from torchbrdf.fitting.columns import ErrorOfFits
from torchbrdf.fitting.data import Data


class SquaredError(ErrorOfFits):
    """The squared error under an analytic loss; width as `Loss.penalty_slope` takes it."""

    data: Data

    def __call__(self, x: Tensor, rows: Tensor, curvature: bool = True) -> tuple[Tensor, Tensor, Tensor]:
        """Value `(m,)`, gradient `(m, P)` and Gauss-Newton matrix `(m, P, P)` of the problems `rows`, float64."""
        data, loss = self.data, self.data.loss
        dtype = data.target.dtype
        columns, here = self.columns, self.columns.at(x, rows, dtype)
        materials = self.materials[rows]
        everyone = len(rows) == len(data) and torch.equal(materials, torch.arange(len(data), device=rows.device))
        colors = columns.colors(here, dtype)
        width = None if self.width is None else self.width[rows, None, None].to(dtype)
        value = torch.zeros(len(rows), dtype=torch.float64, device=x.device)
        slopes = value.new_zeros(len(rows), 3, len(columns.used))
        grams: Tensor | None = None
        averages = None if data.groups is None else Averages(data.groups, None if everyone else materials)
        for part, pairs in data.chunks(len(rows)):
            if pairs.shape[0] > 1 and not everyone:
                pairs = pairs.select(materials)
            basis = torch.stack([column.expand(len(rows), -1) for column in columns.evaluate(pairs, here, dtype)], 1)
            prediction = torch.bmm(colors, basis[:, len(columns.slopes) :])
            target, weight = data.part(part, None if everyone else materials)
            encoded, rate = loss.encode_slope(prediction.transpose(1, 2), pairs)
            rate = rate.transpose(-1, -2)
            difference = encoded.transpose(1, 2) - target
            penalty, slope, curve = loss.penalty_slope(difference, width)
            if weight is not None:
                penalty, slope, curve = penalty * weight, slope * weight, curve * weight
            value += penalty.sum((1, 2)).double()
            basis = basis[:, : len(columns.used)]
            if averages is not None:
                averages.add(part, difference, rate, basis)
            slopes += torch.bmm(slope * rate, basis.transpose(1, 2)).double()
            if curvature:
                curve = (curve * rate.square()).expand(len(rows), -1, basis.shape[2])
                curved = (curve[:, :, None] * basis[:, None]).flatten(1, 2)
                gram = torch.bmm(curved, basis.transpose(1, 2)).double()
                grams = gram if grams is None else grams + gram
        norm = data.total.expand(len(data))[materials] * self.scale[rows]
        jacobian = columns.jacobian(here, colors.double())
        gradient = torch.einsum("rcq,rcqp->rp", slopes, jacobian)
        if averages is not None:
            residual, moved = averages.residuals(jacobian)
            value += residual.square().sum(1)
            gradient += 2 * (moved @ residual[..., None])[..., 0]
        gradient /= norm[:, None]
        if grams is None:
            return value / norm, gradient, gradient.new_empty(0)
        grams = grams.unflatten(1, (-1, grams.shape[2])).expand(-1, 3, -1, -1)
        matrix = torch.einsum("rcqp,rcqs->rps", jacobian, grams @ jacobian)
        if averages is not None:
            matrix += 2 * moved @ moved.mT
        return value / norm, gradient, matrix / norm[:, None, None]
