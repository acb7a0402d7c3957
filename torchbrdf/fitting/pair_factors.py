"""Lobes as sums of functions of the half angle times functions of a pair that no parameter enters.

On the pairs of one theta_h every term of such lobes, and every derivative of one, is sum_j H_j(theta_h; scalars)
B_j(pair) (`Lobe.pair_factors`). The H_j follow from the term at as many probes, pairs of the group that tell the B_j
apart, so that lobes are evaluated as anywhere else, but at a few hundred pairs in the place of 900,000.
"""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.fitting.basis import Basis, responses_of
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.pairs import Pairs

# Pairs of a group of which its probes are chosen.
_CANDIDATES = 64
# Combinations of a group's factors that vary less than this, relative, are left out: they are not to be seen.
RANK = 1e-12


Made = TypeVar("Made")
_KEPT: WeakKeyDictionary[Pairs, dict[Hashable, Any]] = WeakKeyDictionary()


@dataclass(frozen=True)
class Groups:
    """Pairs by theta_h: an index that sorts them, None where they are sorted, and where each group begins and ends."""

    order: Tensor | None
    bounds: list[int]

    @classmethod
    def of(cls, pairs: Pairs, least: int) -> "Groups | None":
        """None where groups have less than so many pairs on average, or materials have pairs of their own."""
        if len(pairs.shape) != 2 or pairs.shape[0] != 1 or not len(pairs):
            return None
        angle, order = pairs.tan2_h[0], None
        counts = torch.unique_consecutive(angle, return_counts=True)[1]
        if len(counts) * least > len(pairs):
            order = angle.argsort(stable=True)
            counts = torch.unique_consecutive(angle[order], return_counts=True)[1]
        if len(counts) * least > len(pairs):
            return None
        return cls(order, [0, *counts.cumsum(0).tolist()])

    def __len__(self) -> int:
        return len(self.bounds) - 1

    def __iter__(self) -> Iterator[slice | Tensor]:
        for start, stop in zip(self.bounds, self.bounds[1:], strict=False):
            yield slice(start, stop) if self.order is None else self.order[start:stop]

    def places(self, sorted_places: Tensor) -> Tensor:
        """Which pairs those are that sorting puts at some places."""
        return sorted_places if self.order is None else self.order[sorted_places]


def kept(pairs: Pairs, key: Hashable, make: Callable[[], Made]) -> Made:
    """What fits make of pairs alone: made once, and kept for as long as these are."""
    own = _KEPT.setdefault(pairs, {})
    if key not in own:
        own[key] = make()
    found: Made = own[key]
    return found


def groups_of(pairs: Pairs, least: int) -> Groups | None:
    """`Groups.of`, kept."""
    return kept(pairs, least, lambda: Groups.of(pairs, least))


def probes_of(kind: type[Lobe], pairs: Pairs, groups: Groups) -> "Probes":
    """`Probes.of`, kept."""
    return kept(pairs, ("probes", kind), lambda: Probes.of(kind, pairs, groups))


def factor_kinds(model: Lobe) -> list[type[Lobe]]:
    """The kinds of a model's lobes; none, if one of them has no `pair_factors`."""
    kinds = list(dict.fromkeys(type(lobe) for lobe in model.components()))
    return kinds if all(kind.has_pair_factors() for kind in kinds) else []


def factors_of(kind: type[Lobe], pairs: Pairs) -> Tensor:
    """The B_j of a kind on pairs `(1, n)`, `(J, n)`.

    Raises:
        UsageError: one is not finite.
    """
    found = torch.cat([one.expand(1, len(pairs)) for one in kind.pair_factors(pairs)])
    if not found.isfinite().all():
        raise UsageError(f"{kind.__name__}.pair_factors: expected finite values, found some that are not")
    return found


@dataclass(frozen=True)
class Probes:
    """Where the lobes of a kind are evaluated, as many pairs as it has factors in each of G groups.

    pairs: `(1, G J)`, float64; inverse: what makes of values there the H_j, `(G, J, J)`.
    """

    pairs: Pairs
    inverse: Tensor
    _constant: list[Tensor] = field(default_factory=list, repr=False, compare=False)

    @classmethod
    def of(cls, kind: type[Lobe], pairs: Pairs, groups: Groups) -> "Probes":
        """Choose them among the pairs of each group."""
        own, there = chosen_probes([kind], pairs, groups)
        return cls(own, inverse_of(there))

    def coefficients(self, responses: Tensor) -> Tensor:
        """The H_j of terms or their derivatives, from their values at the probes `(m, K, G J)`, `(m, K, G, J)`."""
        if self.inverse.shape[1] == 1:
            return (responses * self.inverse.flatten())[..., None]
        return rows_times(responses.unflatten(2, (len(self.inverse), -1)), self.inverse)

    def constant(self, kind: type[Lobe]) -> Tensor:
        """The H_j of the terms of a kind that has no scalars, `(1, K, G, J)`."""
        if not self._constant:
            terms = [kind.unit_response(self.pairs)] if kind.albedo_spec() is not None else kind.terms(self.pairs)
            self._constant.append(self.coefficients(torch.stack([one.expand(1, -1) for one in terms], 1)))
        return self._constant[0]


def rows_times(rows: Tensor, matrix: Tensor) -> Tensor:
    """Rows `(..., J)` times a matrix of few columns each, `(..., J, K)`: products of numbers, as calls take longer."""
    found = rows[..., :1] * matrix[..., 0, :]
    for j in range(1, matrix.shape[-2]):
        found = found.addcmul_(rows[..., j : j + 1], matrix[..., j, :])
    return found


def coefficients(basis: Basis, probes: Mapping[type[Lobe], Probes], values: ParameterDict, problems: int) -> Tensor:
    """All responses of a basis as sums of the factors of some kinds, `(R, Q, G, J)`, float64."""
    sizes = {kind: own.inverse.shape[1] for kind, own in probes.items()}
    firsts = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))
    groups = len(next(iter(probes.values())).inverse)
    shape = (problems, len(basis.slopes) + basis.terms, groups, sum(sizes.values()))
    found = torch.zeros(shape, dtype=torch.float64, device=next(iter(values.values())).device)
    slope, term = 0, len(basis.slopes)
    for parts in basis.alike:
        kind, count = parts[0].kind, len(parts)
        own, columns = probes[kind], slice(firsts[kind], firsts[kind] + sizes[kind])
        if not parts[0].scalars:  # terms that are always the same
            found[:, term : term + count * parts[0].terms, :, columns] = own.constant(kind)
            term += count * parts[0].terms
            continue
        slopes, terms = responses_of(parts, own.pairs, values, torch.float64)
        there = own.coefficients(torch.stack([one.expand(count * problems, -1) for one in (*slopes, *terms)], 1))
        there = there.unflatten(0, (count, problems)).transpose(0, 1)
        for first, some in ((slope, there[:, :, : len(slopes)]), (term, there[:, :, len(slopes) :])):
            if some.shape[2]:
                rows = slice(first, first + count * some.shape[2])
                found[:, rows, :, columns] = some.flatten(1, 2)
        slope, term = slope + count * len(slopes), term + count * len(terms)
    return found


def chosen_probes(kinds: Sequence[type[Lobe]], pairs: Pairs, groups: Groups) -> tuple[Pairs, Tensor]:
    """Of each group the pairs that tell the factors of some kinds apart, `(1, G J)`, and these there, `(G, J, J)`."""
    some = _candidates(groups, pairs.device)
    wide = pairs.select(samples=some.flatten()).to(dtype=torch.float64)
    factors = torch.cat([factors_of(kind, wide) for kind in kinds]).unflatten(1, some.shape).transpose(0, 1)
    place = _pivots(factors)
    there = factors.gather(2, place[:, None].expand(-1, factors.shape[1], -1))
    first = torch.arange(len(some), dtype=torch.int64, device=some.device)[:, None] * some.shape[1]
    return wide.select(samples=(first + place).flatten()), there


def _candidates(groups: Groups, device: torch.device) -> Tensor:
    """Some of the pairs of each group, evenly, `(G, C)`."""
    bounds = torch.tensor(groups.bounds, dtype=torch.int64, device=device)
    place = torch.arange(_CANDIDATES, dtype=torch.int64, device=device)
    return groups.places(bounds[:-1, None] + place * (bounds.diff()[:, None] - 1) // (_CANDIDATES - 1))


def _pivots(factors: Tensor) -> Tensor:
    """Of the candidates of each group as many as there are factors `(G, J, C)`, which tell these apart, `(G, J)`.

    As pivoted QR has it: the longest column, then the longest of what is left of the others, and so on.
    """
    scale = factors.abs().amax(2, keepdim=True).clamp_min(torch.finfo(factors.dtype).tiny)
    left, chosen = factors / scale, []
    for _ in range(factors.shape[1]):
        square = left.square().sum(1)
        chosen.append(square.argmax(1))
        index = chosen[-1][:, None, None]
        axis = left.gather(2, index.expand(-1, left.shape[1], 1))
        axis = axis / square.gather(1, index[..., 0])[..., None].sqrt().clamp_min(torch.finfo(left.dtype).tiny)
        left = left - axis * (axis.mT @ left)
    return torch.stack(chosen, 1)


def inverse_of(at_probes: Tensor) -> Tensor:
    """What makes of values at probes the H_j, `(G, P, J)`, from the factors there, `(G, J, P)`."""
    # In units in which all factors are of a size, as some are 1e6 times others towards the horizon.
    size = at_probes.abs().amax(2, keepdim=True).clamp_min(torch.finfo(at_probes.dtype).tiny)
    return torch.linalg.pinv(at_probes / size, rtol=RANK) / size.mT
