"""A problem laid out by half angles, for models whose lobes know their shape by the half angle alone.

On the pairs of one theta_h predictions are C B and all derivatives sums over the same few functions B of a pair
(`pair_factors`). A step evaluates lobes at probes only, and then works on single values: what is compared, penalty,
slope and curvature, and their sums with the B and with the B's products, group by group. All else is the chain rule
over 85 small matrices. Pairs lie in blocks of one group each, so that these sums are products of whole batches.
"""

import inspect
import math
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from torchbrdf.fitting import channels
from torchbrdf.fitting.basis import Basis
from torchbrdf.fitting.layout import Layout, spread_factors
from torchbrdf.fitting.pair_factors import Groups, coefficients, factors_of, kept, probes_of
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.losses import Loss, Problem

if TYPE_CHECKING:
    from torchbrdf.pairs import Pairs

# Pairs of a group, on average, from which on lobes are evaluated at probes.
LEAST_PAIRS = 8


class Sums(NamedTuple):
    """What a pass over the pairs adds up for m problems, float64.

    value: `(m,)`; slopes: by used responses, `(m, C, Q)`; grams: `(m, 1|C, Q, Q)`, None: not asked for; binned: of all
    responses, in what an objective gives as `columns`, `(m, 1|C, Q, B)`; None: it gives none.
    """

    value: Tensor
    slopes: Tensor
    grams: Tensor | None
    binned: Tensor | None = None

    def plus(self, other: "Sums") -> "Sums":
        """With those of other pairs."""
        grams, binned = (
            None if one is None or two is None else one + two
            for one, two in ((self.grams, other.grams), (self.binned, other.binned))
        )
        return Sums(self.value + other.value, self.slopes + other.slopes, grams, binned)

    def chained(self, jacobian: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix (empty, if there is no curvature); jacobian: `(m, C, Q, P)`."""
        gradient = (self.slopes.flatten(1)[:, None] @ jacobian.flatten(1, 2))[:, 0]
        if self.grams is None:
            return self.value, gradient, gradient.new_empty(0)
        curved = (self.grams @ jacobian).flatten(1, 2)
        return self.value, gradient, jacobian.flatten(1, 2).mT @ curved


class Factors:
    """The factors of some kinds of lobes on a layout, those first of which derivatives are wanted.

    Args:
        pairs: which.
        layout: of these.
        kinds: of lobes, the first `active` of which have derivatives.
        exposure: what values are multiplied by first, `(1, N)`; None: nothing.

    values: `(B, J, size)`; products: of those that are active by each other, each pair of factors once; index: where
    the product of any two of them is, `(a, a)`.
    """

    def __init__(
        self, pairs: "Pairs", layout: Layout, kinds: tuple[type[Lobe], ...], active: int, exposure: Tensor | None
    ) -> None:
        self.layout = layout
        self.probes = {kind: probes_of(kind, pairs, layout.groups) for kind in kinds}
        self.active = sum(self.probes[kind].inverse.shape[1] for kind in kinds[:active])
        # What fills up is 0: no value, no slope.
        self.values = torch.cat([spread_factors(kind, pairs, layout) for kind in kinds], 1)
        if exposure is not None:
            self.values *= layout.spread(exposure)
        self.index = torch.zeros(self.active, self.active, dtype=torch.int64, device=self.values.device)
        every = list(combinations_with_replacement(range(self.active), 2))
        self.products = self.values.new_empty(len(self.values), len(every), layout.size)
        for k, (i, j) in enumerate(every):
            torch.mul(self.values[:, i], self.values[:, j], out=self.products[:, k])
            self.index[i, j] = self.index[j, i] = k

    def on(self, pairs: "Pairs") -> Tensor:
        """The factors on some pairs, not exposed, `(J, n)`, float64."""
        wide = pairs.to(dtype=torch.float64)
        return torch.cat([factors_of(kind, wide) for kind in self.probes])


def _kept_factors(
    pairs: "Pairs", layout: Layout, kinds: tuple[type[Lobe], ...], active: int, exposure: Tensor | None
) -> Factors:
    """Those of the last exposure under which they were asked for, as several losses have the same."""
    own: dict[Any, tuple[Tensor | None, Factors]] = kept(pairs, Factors, dict)
    key = kinds, active
    former, found = own.get(key, (None, None))
    same = former is exposure or (former is not None and exposure is not None and torch.equal(former, exposure))
    if found is None or not same:
        own[key] = exposure, Factors(pairs, layout, kinds, active, exposure)
    return own[key][1]


class FactoredProblem:
    """A problem under a loss, laid out by half angles.

    Args:
        problem: whose pairs all materials share.
        loss: of single values.
        weight: of pairs, as `channels.effective_weight` gives it.
        code: what is compared of targets, `(M, C, N)`.
        groups: of the pairs.
    """

    def __init__(self, problem: Problem, loss: Loss, weight: Tensor | None, code: Tensor, groups: Groups) -> None:
        self.problem, self.loss = problem, loss
        methods = loss.compress_with_derivative, loss.penalty_with_derivatives
        self.works_in_place = all("out" in inspect.signature(method).parameters for method in methods)
        self.squares, self.one = type(loss).penalty is Loss.penalty, code.new_ones(())
        self._memory = code.new_empty(0)
        self.layout = kept(problem.pairs, Layout, lambda: Layout(problem.pairs, groups))
        self.exposure = loss.exposure(problem.pairs) if loss.has_exposure else None
        self.target, self.weight = self.layout.spread(code), None
        empty = self.layout.real == 0
        ends = empty.any(1).nonzero()[:, 0]
        nothing = torch.zeros_like(self.target[ends, :1])
        black, _ = self._compressed(nothing, ends, torch.empty_like(nothing).repeat(2, 1, 1, 1, 1))
        self.target[ends] = torch.where(empty[ends, None, None], black, self.target[ends])
        self.filled = int(empty.sum())
        if weight is not None:
            self.filled = 0
            self.weight = self.layout.spread(weight.expand(-1, -1, code.shape[2]))
        self._factors: dict[tuple[tuple[type[Lobe], ...], int], Factors] = {}

    def factors(self, basis: Basis) -> Factors:
        """Those of the lobes of a basis."""
        active = dict.fromkeys(part.kind for part in basis.parts if part.slopes or part.moves_coefficients)
        kinds = tuple(dict.fromkeys([*active, *(part.kind for part in basis.parts)]))
        key = kinds, len(active)
        if key not in self._factors:
            self._factors[key] = _kept_factors(self.problem.pairs, self.layout, kinds, len(active), self.exposure)
        return self._factors[key]

    def sums(
        self,
        basis: Basis,
        values: ParameterDict,
        albedos: Tensor,
        rows: Tensor | None,
        width: Tensor | None,
        curvature: bool,
    ) -> tuple[Sums, Tensor]:
        """What a pass adds up for m problems, and the responses as sums of the factors, `(m, Q, G J)`.

        albedos: `(m, C, terms)`, float64; rows: of which material each is, None: all; width: `(m, 1, 1)`.
        """
        problems, factors = len(albedos), self.factors(basis)
        responses = coefficients(basis, factors.probes, values, problems)
        groups, count = responses.shape[2:]
        color = albedos @ responses[:, len(basis.slopes) :].flatten(2)
        color = color.unflatten(2, (groups, count)).permute(2, 0, 1, 3).flatten(1, 2).to(self.target.dtype)
        value, slopes, products = self._pass(color, factors, rows, width, curvature)
        # Groups last, as they are many: (m, Q, a, G).
        used = responses[:, : basis.used, :, : factors.active].transpose(2, 3).contiguous()
        flat = used.flatten(2).mT
        slopes = slopes.permute(2, 1, 0).unflatten(0, (problems, -1)).flatten(2)
        grams = None
        if products is not None:
            products = products.permute(2, 1, 0).contiguous()[:, factors.index].unflatten(0, (problems, -1))
            half = products[:, :, None, 0] * used[:, None, :, :1]
            for j in range(1, factors.active):
                half.addcmul_(products[:, :, None, j], used[:, None, :, j : j + 1])
            grams = half.flatten(3) @ flat[:, None]
        return Sums(value, slopes @ flat, grams), responses.flatten(2)

    def _pass(
        self, color: Tensor, factors: Factors, rows: Tensor | None, width: Tensor | None, curvature: bool
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Values `(m,)`, and by group slopes `(G, a, C m)` and curvatures by products `(G, k, C m)`, float64.

        color: what factors are multiplied by, `(G, C m, J)`.
        """
        layout, channels, products = self.layout, self.problem.target.shape[2], factors.products.shape[1]
        problems = color.shape[1] // channels
        by_block, value = color[layout.group], color.new_zeros(problems, dtype=torch.float64)
        slopes = color.new_empty(len(by_block), factors.active, color.shape[1])
        grams = color.new_empty(len(by_block), products, color.shape[1] if curvature else 0)
        for part in layout.parts(color.shape[1]):
            work = self._work((part.stop - part.start, problems, channels, layout.size))
            x = torch.bmm(by_block[part], factors.values[part], out=work[0].flatten(1, 2)).view_as(work[0])
            code, rate = self._compressed(x, part, work[1:3])
            difference = code.sub_(self._own(self.target[part], rows))
            spare = (work[1] if code is x else x, *work[3:])
            penalty, slope, curve = self._penalized(difference, width, spare)
            if self.weight is not None:
                weight = self._own(self.weight[part], rows)
                penalty, slope, curve = (self._times(one, weight) for one in (penalty, slope, curve))
            value += penalty.sum((0, 2, 3))
            slope = slope if rate is None else self._times(slope, rate)
            torch.bmm(factors.values[part, : factors.active], slope.flatten(1, 2).mT, out=slopes[part])
            if curvature:
                if rate is not None:
                    square = rate.square_()
                    curve = square if curve is self.one else torch.mul(curve, square, out=square)
                torch.bmm(factors.products[part], curve.expand_as(x).flatten(1, 2).mT, out=grams[part])
        if self.filled:  # with nothing: predictions and targets of 0
            nothing = color.new_zeros(1 if width is None else problems, 1, 1)
            value -= channels * self.filled * self.loss.penalty_with_derivatives(nothing, width)[0].flatten()
        by_group = [
            color.new_zeros(len(color), *one.shape[1:], dtype=torch.float64).index_add_(0, layout.group, one.double())
            for one in (slopes, grams)
        ]
        slope, curve = (2 * one for one in by_group) if self.squares else by_group
        return value, slope, curve if curvature else None

    def _work(self, shape: tuple[int, ...]) -> Tensor:
        """Five arrays of this shape to work in, always the same ones: memory that is new costs more than arithmetic."""
        count = 5 * math.prod(shape)
        if self._memory.numel() < count:
            self._memory = self.target.new_empty(count)
        return self._memory[:count].view(5, *shape)

    def _penalized(
        self, difference: Tensor, width: Tensor | None, spare: tuple[Tensor, ...]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Penalties, slopes and curvatures; half of the last two of squares."""
        if self.squares:
            return torch.mul(difference, difference, out=spare[0]), difference, self.one
        if self.works_in_place:
            return self.loss.penalty_with_derivatives(difference, width, spare)
        return self.loss.penalty_with_derivatives(difference, width)

    def _times(self, one: Tensor, other: Tensor) -> Tensor:
        """Their product, in the place of the first if it is ours."""
        mine = self.works_in_place and one.shape[-1:] == (self.layout.size,)
        return one.mul_(other) if mine else one * other

    def _own(self, values: Tensor, rows: Tensor | None) -> Tensor:
        """What belongs to these materials, of `(b, M|1, ...)`."""
        return values if rows is None or values.shape[1] == 1 else values.index_select(1, rows)

    def _compressed(self, x: Tensor, part: slice | Tensor, spare: Tensor) -> tuple[Tensor, Tensor | None]:
        """What is compared of values `(b, m, C, size)`, exposed if the loss says how, and its derivative."""
        if self.exposure is not None and self.works_in_place:
            return self.loss.compress_with_derivative(x, (spare[0], spare[1]))
        if self.exposure is not None:
            return self.loss.compress_with_derivative(x)
        pairs = self.problem.pairs.select(samples=self.layout.sample[part].flatten())
        flat = x.permute(1, 2, 0, 3).flatten(2)
        found = channels.encode_with_derivative(self.loss, flat, pairs)
        code, rate = (one.expand_as(flat).unflatten(2, (len(x), -1)).permute(2, 0, 1, 3) for one in found)
        return code.contiguous(), rate.contiguous()
