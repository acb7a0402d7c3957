"""The problem of fitting tabulated lobes, as Levenberg-Marquardt sees it.

With F0 held every channel of every material is a problem of its own: its diffuse albedo and the logarithms of its
tables. Tables are linear between their nodes, so that a pair's value depends on few numbers, the same for all pairs of
a cell between two nodes of theta_h and two of theta_d. Pairs are sorted into cells once; gradients and matrices are
small products a block of pairs of one cell, which are then added up.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.fitting import channels
from torchbrdf.fitting.sampling import CHUNK
from torchbrdf.lobes import DistributionBased, Lambert, Lobe
from torchbrdf.lobes._microfacet import v_groove
from torchbrdf.lobes.distribution_based import FRESNEL_NODES, NODES, distribution_place, fresnel_place
from torchbrdf.lobes.fresnel import fresnel
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names
from torchbrdf.losses import Loss, Problem
from torchbrdf.pairs import Pairs

# Pairs of a block: of few pairs not too many to fill up with, of many not too many blocks.
SMALL_BLOCK, LARGE_BLOCK = 16, 64
MANY = 200_000
# Numbers of a lobe: both tables of a channel.
TABLES = NODES + FRESNEL_NODES
CELLS = (NODES - 1) * (FRESNEL_NODES - 1)
# Of the pairs, what lobes ask for.
QUANTITIES = ("cos_i", "cos_o", "cos_h", "cos_d", "theta_h", "theta_d", "tan2_h", "above_horizon")


def is_tabulated(model: Lobe) -> bool:
    """Whether every specular lobe is tabulated, beside Lambert's term or none."""
    diffuse = [type(part).in_rgb for part in model.components() if part.is_diffuse]
    specular = [type(part).in_rgb for part in model.components() if not part.is_diffuse]
    return bool(specular) and {*specular} == {DistributionBased} and diffuse in ([], [Lambert])


@dataclass(frozen=True)
class Blocks:
    """Pairs sorted into blocks of one cell each.

    block: pairs of one; pairs: `(p, B * block)`, filled up with others of no weight; sample: which of the pairs each
    is; real: whether it is not there to fill up; low_h, low_d: the nodes below, of each block `(p, B)`; share_h,
    share_d: of the nodes above, of each pair.
    """

    block: int
    pairs: Pairs
    sample: Tensor
    real: Tensor
    low_h: Tensor
    low_d: Tensor
    share_h: Tensor
    share_d: Tensor

    @classmethod
    def of(cls, pairs: Pairs, needs: Sequence[str]) -> "Blocks":
        """Sort pairs `(p, N)`, of which a loss needs what lobes do, and `needs`."""
        low_h, share_h = distribution_place(pairs, NODES)
        low_d, share_d = fresnel_place(pairs, FRESNEL_NODES)
        block = SMALL_BLOCK if len(pairs) < MANY else LARGE_BLOCK
        cell, order = (low_h * (FRESNEL_NODES - 1) + low_d).sort(dim=-1, stable=True)
        count = torch.zeros(len(cell), CELLS, dtype=torch.int64, device=cell.device)
        count.scatter_add_(1, cell, torch.ones_like(cell))
        blocks = (count + block - 1) // block
        rank = torch.arange(cell.shape[1], dtype=torch.int64, device=cell.device) - _before(count).gather(1, cell)
        place = _before(blocks).gather(1, cell) * block + rank
        size = int(blocks.sum(1).max())
        sample = torch.zeros(len(cell), size * block, dtype=torch.int64, device=cell.device).scatter_(1, place, order)
        real = torch.zeros_like(sample, dtype=torch.bool).scatter_(1, place, True)
        of_block = torch.zeros(len(cell), size, dtype=torch.int64, device=cell.device)
        of_block.scatter_(1, place // block, cell)
        names = dict.fromkeys((*QUANTITIES, *needs))
        picked = Pairs(**{name: getattr(pairs, name).gather(1, sample) for name in names})
        columns = FRESNEL_NODES - 1
        shares = (share.gather(1, sample) for share in (share_h, share_d))
        return cls(block, picked, sample, real, of_block // columns, of_block % columns, *shares)

    @property
    def nearest_h(self) -> Tensor:
        """The node of D nearest to each pair, `(p, B * block)`."""
        return self.low_h.repeat_interleave(self.block, 1) + (self.share_h > 0.5)

    def samples(self, part: slice) -> slice:
        """The pairs of some blocks."""
        return slice(part.start * self.block, part.stop * self.block)

    def spread(self, values: Tensor, channels: int) -> Tensor:
        """Values of each channel of the pairs, `(c, N)`, in the order of the blocks."""
        place = self.sample if len(self.sample) == 1 else self.sample.repeat_interleave(channels, 0)
        return values.gather(1, place.expand(len(values), -1)) if len(values) > 1 else values[0][place]


def _before(count: Tensor) -> Tensor:
    """How many come before each, `(p, n)`."""
    return count.cumsum(1) - count


class TabulatedProblem:
    """All channels of M materials under a loss of single values, C M problems for a solver, material after material.

    The variables, P: the diffuse albedo, if it is fitted; then for every lobe the logarithms of D and of the table of
    F. Values are in units of what a prediction of 0 has, the mean of a material's channels, and have the roughness of
    the tables added.

    Args:
        model: Lambert or none, and tabulated lobes.
        values: its parameters; F0, and an albedo that is not fitted, are held.
        problem: what is to be met.
        loss: of single values.
        fit_diffuse: whether the albedo is fitted.
        smooth: the weight of squared second differences of the tables' logarithms.
    """

    def __init__(
        self, model: Lobe, values: ParameterDict, problem: Problem, loss: Loss, *, fit_diffuse: bool, smooth: float
    ) -> None:
        self.loss, self.problem, self.values = loss, problem, values
        self.channels = problem.target.shape[2]
        names = component_names(model)
        diffuse = [own["albedo"] for own, part in zip(names, model.components(), strict=True) if part.is_diffuse]
        self.lobes = [own for own, part in zip(names, model.components(), strict=True) if not part.is_diffuse]
        self.albedo = diffuse[0] if diffuse else None
        self.base = int(fit_diffuse and bool(diffuse))
        self.size = self.base + len(self.lobes) * TABLES
        self.blocks = Blocks.of(problem.pairs, loss.needs)
        self.geometry = torch.where(self.blocks.pairs.above_horizon, v_groove(self.blocks.pairs) / 4, 0)
        self.target = self.blocks.spread(problem.target.mT.flatten(0, 1), self.channels)
        self.weight = self._weights()
        self.penalties = self._penalties(smooth).to(self.target.device)
        self._encode()
        self.width: Tensor | None = None
        """Over which a cusp of the loss is rounded, `(C M,)`."""

    def __len__(self) -> int:
        return len(self.target)

    def _weights(self) -> Tensor:
        """The weight of each pair, `(C M | C | 1, B * block)`, 0 of those that fill up."""
        weight = channels.effective_weight(self.loss, self.problem.pairs, self.problem.weight)
        if weight is None:
            found = torch.ones_like(self.target[:1])
        else:
            weight = weight.to(self.target).expand(len(weight), self.channels, self.problem.target.shape[1])
            weight = weight.expand(len(self.problem.target), -1, -1) if len(self.blocks.sample) > 1 else weight
            found = self.blocks.spread(weight.flatten(0, 1), self.channels)
            found = found.repeat(len(self.problem.target), 1) if len(found) == self.channels else found
        real = self.blocks.real
        return torch.where(real if len(real) == 1 else real.repeat_interleave(self.channels, 0), found, 0)

    def _encode(self) -> None:
        """What is made of targets once: their codes, sums of weights, penalties of 0, and mean magnitudes."""
        self.code = torch.empty_like(self.target)
        rows = torch.arange(len(self), dtype=torch.int64, device=self.target.device)
        sums = torch.zeros(3, len(self), dtype=torch.float64, device=self.target.device)
        for part in self._parts(len(self)):
            pairs, target = self._pairs(part, rows), self.target[:, self.blocks.samples(part)]
            code, zero = (self.loss.encode(x[..., None], pairs)[..., 0] for x in (target, torch.zeros_like(target)))
            self.code[:, self.blocks.samples(part)] = code
            weight = self.weight[:, self.blocks.samples(part)].expand_as(code)
            terms = weight, weight * self.loss.penalty(zero - code), weight * code.abs()
            sums += torch.stack([term.sum(1, dtype=torch.float64) for term in terms])
        total = torch.where(sums[0] > 0, sums[0], 1)
        zero = (sums[1] / total).unflatten(0, (-1, self.channels)).mean(1).repeat_interleave(self.channels)
        magnitude = sums[2] / total
        self.unit = torch.where(zero > 0, zero, 1)
        self.magnitude = torch.where(magnitude > 0, magnitude, 1)
        self.norm = total * self.unit

    def _parts(self, rows: int) -> Iterator[slice]:
        """Blocks in parts, so small that what is made of them stays in the cache."""
        count = self.blocks.low_h.shape[1]
        step = max(1, CHUNK.get(self.target.device.type, CHUNK["cpu"]) // (rows * self.blocks.block))
        for start in range(0, count, step):
            yield slice(start, start + step)

    def _pairs(self, part: slice, rows: Tensor) -> Pairs:
        """The pairs of some blocks, of each problem, `(1 | r, n)`."""
        pairs = self.blocks.pairs.select(samples=self.blocks.samples(part))
        return pairs if pairs.shape[0] == 1 else pairs.select(rows // self.channels)

    def _penalties(self, smooth: float) -> Tensor:
        """The matrix of squared second differences, and of what F is at normal incidence, as its scale is D's."""
        found = torch.zeros(self.size, self.size, dtype=torch.float64, device="cpu")
        for first in range(self.base, self.size, TABLES):
            for start, nodes in ((first, NODES), (first + NODES, FRESNEL_NODES)):
                second = torch.eye(nodes, dtype=torch.float64, device="cpu").diff(n=2, dim=0)
                found[start : start + nodes, start : start + nodes] = smooth * second.mT @ second
            found[first + NODES, first + NODES] += 1
        return found

    def quadratic_model(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, gradients and matrices of some problems, with cusps rounded over `width`."""
        state = _State(self, x, rows)
        value = torch.zeros(len(x), dtype=torch.float64, device=x.device)
        columns = state.columns
        slopes = value.new_zeros(len(x) * CELLS, columns)
        grams = value.new_zeros(len(x) * CELLS, columns * columns)
        of_row = torch.arange(len(x), dtype=torch.int64, device=x.device)[:, None] * CELLS
        for part in self._parts(len(x)):
            penalty, slope, curve, basis = state.terms(part)
            value += penalty.sum((1, 2), dtype=torch.float64)
            cell = (of_row + self._cell(part, rows)).flatten()
            slopes.index_add_(0, cell, (basis @ slope[..., None])[..., 0].flatten(0, 1).double())
            grams.index_add_(0, cell, ((basis * curve[:, :, None]) @ basis.mT).flatten(0, 1).flatten(1).double())
        norm = self.norm[rows, None]
        gradient = self._assembled(slopes.unflatten(0, (-1, CELLS)), state.variables, self.size) / norm
        pairs = state.variables[:, :, None] * self.size + state.variables[:, None, :]
        matrix = self._assembled(grams.unflatten(0, (-1, CELLS)), pairs.flatten(1), self.size**2) / norm
        pull = x @ self.penalties
        value = value / norm[:, 0] + (pull * x).sum(1)
        return value, gradient + 2 * pull, matrix.unflatten(1, (self.size, -1)) + 2 * self.penalties

    def error(self, x: Tensor) -> Tensor:
        """The loss of all materials, without what is added to it, `(M,)`."""
        rows = torch.arange(len(self), dtype=torch.int64, device=x.device)
        state, width = _State(self, x, rows), self.width
        self.width = None
        value = sum(state.terms(part)[0].sum((1, 2), dtype=torch.float64) for part in self._parts(len(x)))
        self.width = width
        total = (self.norm / self.unit).unflatten(0, (-1, self.channels)).sum(1)
        value = (value + torch.zeros_like(self.norm)).unflatten(0, (-1, self.channels)).sum(1)
        return self.loss.finalize(value / total)

    def _cell(self, part: slice, rows: Tensor) -> Tensor:
        """The cell of some blocks, of each problem, `(1 | r, b)`."""
        cell = self.blocks.low_h[:, part] * (FRESNEL_NODES - 1) + self.blocks.low_d[:, part]
        return cell if len(cell) == 1 else cell[rows // self.channels]

    @staticmethod
    def _assembled(values: Tensor, place: Tensor, size: int) -> Tensor:
        """Values of cells `(r, CELLS, n)` added up where they belong, `place` `(CELLS, n)`: `(r, size)`."""
        found = values.new_zeros(size, len(values))
        return found.index_add_(0, place.flatten(), values.flatten(1).mT).mT


class _State:
    """Some problems at a point: their tables, and what these make of pairs.

    variables: which those are that the pairs of a cell depend on, `(CELLS, columns)`.
    """

    def __init__(self, problem: TabulatedProblem, x: Tensor, rows: Tensor) -> None:
        self.problem, self.rows = problem, rows
        dtype = problem.target.dtype
        self.columns = problem.base + 4 * len(problem.lobes)
        material, channel = rows // problem.channels, rows % problem.channels
        if problem.base:
            self.albedo = x[:, 0].to(dtype)
        elif problem.albedo is not None:
            self.albedo = problem.values[problem.albedo][material, channel].to(dtype)
        else:
            self.albedo = torch.zeros(len(x), dtype=dtype, device=x.device)
        tables = x[:, problem.base :].unflatten(1, (len(problem.lobes), TABLES)).exp().to(dtype)
        self.distribution, self.factor = tables.split([NODES, FRESNEL_NODES], 2)
        self.f0 = [problem.values[own["f0"]][material].to(dtype) for own in problem.lobes]
        h = torch.arange(NODES - 1, dtype=torch.int64, device=x.device).repeat_interleave(FRESNEL_NODES - 1)
        d = torch.arange(FRESNEL_NODES - 1, dtype=torch.int64, device=x.device).repeat(NODES - 1)
        own = torch.stack([h, h + 1, NODES + d, NODES + d + 1], 1)
        firsts = [problem.base + k * TABLES for k in range(len(problem.lobes))]
        self.variables = torch.cat([torch.zeros_like(own[:, :1])] * problem.base + [own + one for one in firsts], 1)

    def terms(self, part: slice) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of the pairs of some blocks: penalties, and their derivatives.

        Penalties, slopes and curvatures by values, `(r, b, block)`, all weighted; the derivatives of values by a cell's
        variables, `(r, b, columns, block)`.
        """
        problem, rows = self.problem, self.rows
        samples, pairs = problem.blocks.samples(part), problem._pairs(part, rows)
        value, basis = self._value_and_basis(part, pairs)
        code, rate = (x[..., 0] for x in problem.loss.encode_with_derivative(value.flatten(1)[..., None], pairs))
        width = None if problem.width is None else problem.width[rows, None].to(code)
        weight = problem.weight[:, samples]
        weight = weight if len(weight) == 1 else weight[rows % len(weight)]
        difference = code - problem.code[rows, samples]
        penalty, slope, curve = problem.loss.penalty_with_derivatives(difference, width)
        penalty, slope, curve = penalty * weight, slope * rate * weight, curve * rate.square() * weight
        return *(x.unflatten(1, (-1, problem.blocks.block)) for x in (penalty, slope, curve)), basis

    def _value_and_basis(self, part: slice, pairs: Pairs) -> tuple[Tensor, Tensor]:
        """Values `(r, b, block)` and derivatives."""
        problem, blocks = self.problem, self.problem.blocks
        samples, block = blocks.samples(part), blocks.block

        def own(x: Tensor) -> Tensor:
            return x if len(x) == 1 else x[self.rows // self.problem.channels]

        low_h, low_d = own(blocks.low_h[:, part]), own(blocks.low_d[:, part])
        share_h, share_d, geometry = (
            own(x[:, samples]).unflatten(1, (-1, block)) for x in (blocks.share_h, blocks.share_d, problem.geometry)
        )
        above = pairs.above_horizon.unflatten(-1, (-1, block)).to(geometry.dtype) / math.pi
        above = above.expand(len(self.rows), -1, -1)
        value = above * self.albedo[:, None, None]
        basis = [above] * problem.base
        for k, f0 in enumerate(self.f0):
            shape = geometry * fresnel(f0, pairs).unflatten(-1, (-1, block))
            d = [_nodes(self.distribution[:, k], low_h + i) for i in (0, 1)]
            f = [_nodes(self.factor[:, k], low_d + i) for i in (0, 1)]
            d = [d[0] * (1 - share_h), d[1] * share_h]
            f = [f[0] * (1 - share_d), f[1] * share_d]
            of_d, of_f = (f[0] + f[1]) * shape, (d[0] + d[1]) * shape
            value = value + of_d * (d[0] + d[1])
            basis += [d[0] * of_d, d[1] * of_d, f[0] * of_f, f[1] * of_f]
        return value, torch.stack(basis, 2)


def _nodes(table: Tensor, index: Tensor) -> Tensor:
    """Entries of tables `(r, K)` at `(1 | r, b)`, `(r, b, 1)`."""
    return (table[:, index[0]] if len(index) == 1 else table.gather(1, index))[..., None]
