"""The map between the unit square and a tabulated density, by its marginal and conditional distributions."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchbrdf.measured.grid import neighbours, weighted_rows


class Warp:
    """T densities on the unit square, `(T, H, W)` at the nodes of a grid, bilinear between them, x along W.

    T may be several dimensions, of which each has its place in `invert`; `sample` and `cells` have them as one.

    `sample` sends uniform numbers to positions that have the density: the row from the marginal distribution of y, then
    x from the conditional one. `invert` is its inverse, and takes fractional slices: between two slices densities and
    their integrals are mixed linearly, each normalized by itself.

    Source: J. Dupuy, W. Jakob, An Adaptive Parameterization for Efficient Material Acquisition and Rendering, 2018,
    doi:10.1145/3272127.3275059, with the arrangement of the authors' reader (brdf-loader).
    """

    def __init__(self, density: Tensor) -> None:
        self.slices = tuple(density.shape[:-2])
        density = density.flatten(0, -3)
        along = _integral(density)
        marginal = _integral(along[..., -1])
        total = marginal[:, -1:]
        self.marginal = marginal / total
        self.density = density / total[..., None]
        self.conditional = along / total[..., None]

    def sample(self, x: Tensor, y: Tensor) -> Tensor:
        """Positions (x, y) in each of the slices for a grid of uniform numbers, `(A,)` and `(B,)` to `(T, B, A, 2)`."""
        slices, _, width = self.density.shape
        return torch.cat([self._sample(x, part) for part in y.split(max(1, (1 << 22) // (slices * width)))], 1)

    def _sample(self, u: Tensor, v: Tensor) -> Tensor:
        slices, height, width = self.density.shape
        each = torch.arange(slices, dtype=torch.int64, device=self.density.device)[:, None]
        v = v.expand(slices, -1).contiguous()
        row = (torch.searchsorted(self.marginal, v, right=True) - 1).clamp(0, height - 2)
        low, high = self.conditional[each, row], self.conditional[each, row + 1]
        y = _root(low[..., -1], high[..., -1], v - self.marginal[each, row])[..., None]
        conditional = low + y * (high - low)
        goal = u * conditional[..., -1:]
        column = (torch.searchsorted(conditional, goal, right=True) - 1).clamp(0, width - 2)
        density = self.density[each, row] * (1 - y) + self.density[each, row + 1] * y
        left, right = density.gather(-1, column), density.gather(-1, column + 1)
        x = _root(left, right, goal - conditional.gather(-1, column))
        position = torch.broadcast_tensors((column + x) / (width - 1), (row[..., None] + y) / (height - 1))
        return torch.stack(position, -1)

    def cells(self) -> Tensor:
        """What `invert` needs to know of each cell of the grid, `(T (H-1) (W-1), 9)`."""
        d, c = self.density, self.conditional
        low, high = slice(None, -1), slice(1, None)
        parts = [d[:, low, low], d[:, low, high], d[:, high, low], d[:, high, high], c[:, low, low], c[:, high, low]]
        parts += [
            side[:, :, None].expand_as(parts[0]) for side in (c[:, low, -1], c[:, high, -1], self.marginal[:, low])
        ]
        return torch.stack(parts, -1).flatten(0, 2)

    def invert(self, cells: Tensor, place: Sequence[Tensor], x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Uniform numbers (x, y) of positions in fractional slices, `(N,)` each, with `cells()` in their dtype."""
        _, height, width = self.density.shape
        x, y = x * (width - 1), y * (height - 1)
        column, row = (v.floor().clamp(0, size - 2) for v, size in ((x, width), (y, height)))
        x, y = (x - column).clamp(0, 1), (y - row).clamp(0, 1)
        index, weight = neighbours(place, self.slices)
        cell = (row * (width - 1) + column).to(torch.int32)
        index = index * ((height - 1) * (width - 1)) + cell[:, None]
        d00, d01, d10, d11, left0, left1, row0, row1, below = weighted_rows(cells, index, weight).unbind(-1)
        d0, d1 = d00 + y * (d10 - d00), d01 + y * (d11 - d01)
        inside = left0 + y * (left1 - left0) + x * (d0 + x / 2 * (d1 - d0))
        whole = row0 + y * (row1 - row0)
        return inside / torch.where(whole > 0, whole, 1), below + y * (row0 + y / 2 * (row1 - row0))


def _integral(value: Tensor) -> Tensor:
    """The integral from the first node up to each, of what is linear between nodes one apart, along the last axis."""
    return torch.nn.functional.pad((value[..., 1:] + value[..., :-1]).cumsum(-1) / 2, (1, 0))


def _root(start: Tensor, end: Tensor, goal: Tensor) -> Tensor:
    """The t in [0, 1] at which the integral of start + t (end - start) from 0 reaches the goal."""
    denominator = start + (start.square() + 2 * goal * (end - start)).clamp_min(0).sqrt()
    return (2 * goal / torch.where(denominator > 0, denominator, 1)).clamp(0, 1)
