"""Tabulated lobes under a metric and a picture together, as Gauss and Newton see them.

A picture is linear in a BRDF's values, and these are linear in each table: what a step changes in every pixel is a
small matrix, the product of the transport with the few entries of tables that each pair depends on.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from torchbrdf.fitting.tabulated_problem import TABLES, TabulatedProblem
from torchbrdf.lobes._microfacet import v_groove
from torchbrdf.lobes.distribution_based import FRESNEL_NODES, NODES, distribution_place, fresnel_place
from torchbrdf.lobes.fresnel import fresnel
from torchbrdf.losses import CombinedLoss, Loss, Problem

if TYPE_CHECKING:
    from scipy import sparse

# A value of the metric whose root has no slope that is worth following.
_LEAST = 1e-16


def sees_pictures(loss: Loss) -> bool:
    """Whether a loss is one of single values and of a picture that has a matrix and a parabola."""
    return (
        isinstance(loss, CombinedLoss)
        and loss.loss.is_separable()
        and loss.rendered.has_majorizer
        and loss.rendered.observation_matrices() is not None
    )


class PictureProblem:
    """M materials under a `CombinedLoss`: all channels' variables of a material one after the other, `(M, 3 P)`.

    Values are in units of those of a prediction of 0, and have the roughness of the tables added, as the metric's
    problem does.

    Args:
        metric: The problem of the metric alone.
        problem: What the picture compares.
        loss: Both.
    """

    def __init__(self, metric: TabulatedProblem, problem: Problem, loss: CombinedLoss) -> None:
        self.metric, self.loss = metric, loss
        self.device = problem.target.device
        matrices = loss.rendered.observation_matrices()
        self.matrices = list(matrices or [])
        self.target = loss.rendered.observe(problem.target).cpu()
        black = loss.rendered.compare(torch.zeros_like(self.target), self.target).double()
        self.black = torch.where(black > 0, black, 1)
        total = (metric.norm / metric.unit).unflatten(0, (-1, 3)).cpu()
        self.share = metric.norm.unflatten(0, (-1, 3)).cpu() / total.sum(1, keepdim=True)
        self.scale = self._metric_error(metric.unit.unflatten(0, (-1, 3))[:, 0].cpu()) + loss.factor * self.black
        self.cells = _Cells(metric, problem)
        self.width: Tensor | None = None
        """Over which the picture's cusp is rounded, `(M,)`."""

    def __len__(self) -> int:
        return len(self.target)

    def _metric_error(self, value: Tensor) -> Tensor:
        return value.clamp_min(_LEAST).sqrt() if self.loss.loss.is_root else value

    def quadratic_model(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, gradients and matrices of some materials, with the picture's cusp rounded over `width`."""
        parts = [self._one(own, material) for own, material in zip(x, rows.tolist(), strict=True)]
        value, gradient, matrix = (torch.stack(one).to(x.device) for one in zip(*parts, strict=True))
        return value, gradient, matrix

    def _one(self, x: Tensor, material: int) -> tuple[Tensor, Tensor, Tensor]:
        """Those of one material."""
        channels = x.unflatten(0, (3, -1))
        value, gradient, matrix = self._of_picture(channels.cpu().numpy(), material)
        rows = torch.arange(3 * material, 3 * material + 3, dtype=torch.int64, device=x.device)
        own, slope, curve = (one.cpu() for one in self.metric.quadratic_model(channels, rows))
        share = self.share[material]
        metric = (share * own).sum()
        error = self._metric_error(metric)
        # The parabola of a root lies nowhere below it, as a root's curvature is none above 0.
        rate = share * (0.5 / error if self.loss.loss.is_root else 1)
        scale = self.scale[material]
        value = (self.loss.factor * value + error) / scale
        gradient = (self.loss.factor * gradient + (rate[:, None] * slope).flatten()) / scale
        matrix *= self.loss.factor / scale
        for k, first in enumerate(range(0, len(matrix), self.metric.size)):
            some = slice(first, first + self.metric.size)
            matrix[some, some] += curve[k] * (rate[k] / scale)
        return value, gradient, matrix

    def _of_picture(self, x: np.ndarray, material: int) -> tuple[Tensor, Tensor, Tensor]:
        """What the picture has of it: value, gradient `(3 P,)` and matrix `(3 P, 3 P)`."""
        values, basis = zip(*(self.cells.values_and_basis(own, material, k) for k, own in enumerate(x)), strict=True)
        observed = [matrix @ own for matrix, own in zip(self.matrices, values, strict=True)]
        slopes = [(matrix @ own).toarray() for matrix, own in zip(self.matrices, basis, strict=True)]
        point = torch.from_numpy(np.stack(observed, -1)).to(self.target)[None]
        width = None if self.width is None else self.width[material : material + 1]
        target = self.target[material : material + 1]
        value, slope, curve = self.loss.rendered.quadratic_majorizer(point, target, width)
        size = self.metric.size
        jacobian = [torch.from_numpy(one).to(self.target) for one in slopes]
        gradient = torch.cat([own.mT @ slope[0, :, k] for k, own in enumerate(jacobian)]).double()
        matrix = torch.empty(3, size, 3, size, dtype=torch.float64, device="cpu")
        for k in range(3):
            for other in range(k, 3):
                product = ((jacobian[k] * curve[0, :, k, other, None]).mT @ jacobian[other]).double()
                matrix[k, :, other], matrix[other, :, k] = product, product.mT
        return value[0], gradient, matrix.flatten(2).flatten(0, 1)


class _Cells:
    """Which entries of the tables the pairs of a picture lie between, as arrays, and what multiplies those."""

    def __init__(self, metric: TabulatedProblem, problem: Problem) -> None:
        pairs, self.metric = problem.pairs, metric
        self.low_h, share_h = (one.cpu().numpy() for one in distribution_place(pairs, NODES))
        self.low_d, share_d = (one.cpu().numpy() for one in fresnel_place(pairs, FRESNEL_NODES))
        self.share_h, self.share_d = (np.stack([1 - one, one], -1) for one in (share_h, share_d))
        geometry = torch.where(pairs.above_horizon, v_groove(pairs) / 4, 0)
        self.factors = [(geometry * fresnel(metric.values[own["f0"]], pairs)).cpu().numpy() for own in metric.lobes]
        self.lambert = (pairs.above_horizon.to(geometry) / math.pi).cpu().numpy()

    def values_and_basis(self, x: np.ndarray, material: int, channel: int) -> "tuple[np.ndarray, sparse.csr_matrix]":
        """Values `(N,)` of one channel, and their derivatives by its variables `(N, P)`."""
        from scipy import sparse  # late, as it takes long to import

        row = 0 if len(self.low_h) == 1 else material
        low_h, low_d, share_h, share_d = (one[row] for one in (self.low_h, self.low_d, self.share_h, self.share_d))
        lambert = self.lambert[row]
        albedo = x[0] if self.metric.base else self._held(material, channel)
        value = lambert * lambert.dtype.type(albedo)
        entries = [lambert] * self.metric.base
        columns = [np.zeros_like(low_h)] * self.metric.base
        for k, factor in enumerate(self.factors):
            first = self.metric.base + k * TABLES
            tables = np.exp(x[first : first + TABLES]).astype(lambert.dtype)
            shape = factor[material if len(factor) > 1 else 0]
            d = [tables[low_h + i] * share_h[:, i] for i in (0, 1)]
            f = [tables[NODES + low_d + i] * share_d[:, i] for i in (0, 1)]
            of_d, of_f = (f[0] + f[1]) * shape, (d[0] + d[1]) * shape
            value = value + of_d * (d[0] + d[1])
            entries += [d[0] * of_d, d[1] * of_d, f[0] * of_f, f[1] * of_f]
            columns += [first + low_h, first + low_h + 1, first + NODES + low_d, first + NODES + low_d + 1]
        start = np.arange(len(value) + 1) * len(entries)
        shape_of_all = (len(value), self.metric.size)
        data, column = np.stack(entries, 1).ravel(), np.stack(columns, 1).ravel()
        return value, sparse.csr_matrix((data, column, start), shape_of_all)

    def _held(self, material: int, channel: int) -> float:
        name = self.metric.albedo
        return 0.0 if name is None else float(self.metric.values[name][material, channel])
