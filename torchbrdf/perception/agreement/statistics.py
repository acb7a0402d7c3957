"""How often distances agree with people, how sure that is, and how often people agree with each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.perception.datasets.opinions import Opinions
from torchbrdf.perception.datasets.triplets import Triplets

# Of the logarithm of what single answers are spread by, in `majority_of_people`.
_SPREADS = (-4.0, 6.0)
# Bytes of the weights of bootstrap replicates that are held at once.
_HELD = 2**26


class Rated(Protocol):
    """Approximations of materials, a row for each method and material, and how far people find each from its own."""

    @property
    def methods(self) -> list[str]:
        """Of each of R rows, a name."""
        ...

    @property
    def materials(self) -> list[str]:
        """Of each row, a name."""
        ...

    @property
    def distance(self) -> Tensor:
        """By people, `(R,)`."""
        ...


@dataclass(frozen=True)
class DistanceComparisons:
    """C comparisons of two distances, of which people found one to be smaller.

    nearer, farther: of each comparison, the places of the smaller and of the larger distance in a vector of distances,
    `(C,)` long. materials: the different materials that a comparison is about, `(C, k)` long, -1 where it is about
    fewer. weight: how much it counts, `(C,)` float64. group: which average it enters, `(C,)` long from 0: shares are
    taken in each group, and then their mean over the groups.
    """

    nearer: Tensor
    farther: Tensor
    materials: Tensor
    weight: Tensor
    group: Tensor

    def __len__(self) -> int:
        return len(self.nearer)

    def apart(self, distance: Tensor, least: float) -> "DistanceComparisons":
        """Those whose two distances by people, of a vector `(n,)`, differ by more than this."""
        keep = distance[self.farther] - distance[self.nearer] > least
        return DistanceComparisons(*(own[keep] for own in vars(self).values()))

    def concordant(self, distances: Tensor) -> Tensor:
        """Which comparisons each of L sets of distances `(L, n)` orders right, `(L, C)` float64.

        1, 0, or 0.5 for equal distances. A distance that is not a number is always wrong.
        """
        near, far = distances[:, self.nearer], distances[:, self.farther]
        return (near < far).double() + 0.5 * (near == far).double()

    def agreement_rate(self, concordant: Tensor, resamples: Tensor | None = None) -> Tensor:
        """The weighted share of comparisons that are right, `(L,)` of `(L, C)`; of each of B resamples, `(B, L)`.

        resamples: how often each material was drawn, `(B, K)`. A comparison counts once for every way to choose its
        materials from those drawn, which is the product of their multiplicities.
        """
        groups = int(self.group.max()) + 1 if len(self) else 0
        if not groups:
            raise UsageError("no comparisons to take a share of")
        if resamples is None:
            return self._agreement_rate(concordant, self.weight[None], groups)[0]
        # One more, undrawn material, of multiplicity 1, stands where there is none.
        times = torch.cat([resamples.double(), torch.ones(len(resamples), 1, dtype=torch.float64, device="cpu")], 1)
        parts = []
        for part in times.split(max(_HELD // (8 * len(self) * 2), 1)):
            weight = self.weight.expand(len(part), -1).clone()
            for column in self.materials.unbind(1):
                weight *= part[:, column]
            parts.append(self._agreement_rate(concordant, weight, groups))
        return torch.cat(parts)

    def _agreement_rate(self, concordant: Tensor, weight: Tensor, groups: int) -> Tensor:
        shares = []
        for group in range(groups):
            inside = (self.group == group).nonzero()[:, 0]
            own = weight if groups == 1 else weight[:, inside]
            shares.append(own @ (concordant if groups == 1 else concordant[:, inside]).T / own.sum(1, keepdim=True))
        return torch.stack(shares).nanmean(0)  # a resample may lack a group


def majorities(triplets: Triplets) -> DistanceComparisons:
    """One comparison a question that is no tie: its larger vote is for the nearer candidate.

    Distances are those of a matrix `(K, K)`, flattened: reference times K plus candidate.
    """
    chosen = triplets.select(triplets.decided)
    swap = chosen.votes[:, 1] > chosen.votes[:, 0]
    return _triples(chosen, swap, torch.ones(len(chosen), dtype=torch.float64, device="cpu"))


def single_votes(triplets: Triplets) -> DistanceComparisons:
    """One comparison for every vote of every question, ties too; distances as for `majorities`."""
    first, second = (
        _triples(
            triplets,
            torch.full((len(triplets),), bool(k), dtype=torch.bool, device="cpu"),
            triplets.votes[:, k].double(),
        )
        for k in (0, 1)
    )
    return DistanceComparisons(
        *(torch.cat(pair) for pair in zip(vars(first).values(), vars(second).values(), strict=True)),
    )


def same_material(rated: Rated, *, well_separated: bool = False) -> DistanceComparisons:
    """Pairs of methods that approximate one material and whose distances differ; distances are one a row.

    well_separated: only those that differ by more than two standard errors of the difference, sqrt(se1^2 + se2^2).
    """
    material = _label_indices(rated.materials)
    first, second = _pairs(material)
    if well_separated:
        if not isinstance(rated, Opinions):
            raise UsageError(f"{type(rated).__name__}: expected standard errors to tell pairs apart by, found none")
        difference = rated.distance[first] - rated.distance[second]
        keep = difference.abs() > 2 * _standard_error_of_difference(rated, first, second)
        first, second = first[keep], second[keep]
    return _rows(rated, first, second, material)


def across_materials(rated: Rated) -> DistanceComparisons:
    """Pairs of materials under one method whose distances differ: a group for each method."""
    method, material = _label_indices(rated.methods), _label_indices(rated.materials)
    first, second = _pairs(method)
    return _rows(rated, first, second, material, method)


def any_two(rated: Rated) -> DistanceComparisons:
    """Pairs of any two approximations whose distances differ, of any materials by any methods."""
    material = _label_indices(rated.materials)
    first, second = _pairs(torch.zeros_like(material))
    return _rows(rated, first, second, material)


def majority_of_people(triplets: Triplets) -> Tensor:
    """What a predictor that knows what most people would say would get of `majorities`, `(1, C)`.

    A question's few votes may have gone against what most people would say. With shares of people drawn from a
    symmetric beta distribution, whose one parameter makes the votes of all questions likeliest, it is right about a
    question with the probability that, after its votes, the larger vote is the larger share.
    """
    from scipy.optimize import minimize_scalar  # late, as it takes long to import
    from scipy.special import betainc, betaln

    a, b = triplets.votes.double().numpy().T

    def cost(logarithm: float) -> float:
        spread = np.exp(logarithm)
        return float((betaln(spread, spread) - betaln(a + spread, b + spread)).sum())

    spread = np.exp(minimize_scalar(cost, bounds=_SPREADS, method="bounded").x)
    decided = a != b
    more, less = (np.where(a > b, *part)[decided] for part in ((a, b), (b, a)))
    return torch.from_numpy(betainc(less + spread, more + spread, 0.5))[None]


def majority_of_votes(triplets: Triplets) -> Tensor:
    """What a predictor that always knows the majority would get of `single_votes`, `(1, C)`.

    It is wrong about the votes of the minority, and halfway right about ties.
    """
    a, b = triplets.votes.double().unbind(1)
    known = (a > b).double() + 0.5 * (a == b).double()
    return torch.cat([known, 1 - known])[None]


def expected_order(comparisons: DistanceComparisons, opinions: Opinions) -> Tensor:
    """How often noisy mean opinions would be in the order of the true ones, for each comparison, `(1, C)`.

    With the differences D of the opinions taken as true and standard errors s1, s2 it is Phi(D / sqrt(s1^2 + s2^2)).
    As observed differences are somewhat larger than true ones, it is a ceiling rather on the high side.
    """
    nearer, farther = comparisons.nearer, comparisons.farther
    difference = opinions.distance[farther] - opinions.distance[nearer]
    return torch.special.ndtr(difference / _standard_error_of_difference(opinions, nearer, farther))[None]


def _triples(triplets: Triplets, swap: Tensor, weight: Tensor) -> DistanceComparisons:
    reference, a, b = triplets.questions.unbind(1)
    count = len(triplets.materials)
    return DistanceComparisons(
        nearer=reference * count + torch.where(swap, b, a),
        farther=reference * count + torch.where(swap, a, b),
        materials=triplets.questions,
        weight=weight,
        group=torch.zeros_like(reference),
    )


def _rows(
    rated: Rated, first: Tensor, second: Tensor, material: Tensor, group: Tensor | None = None
) -> DistanceComparisons:
    """Comparisons of the pairs of rows whose distances by people are not the same."""
    distance = rated.distance
    keep = distance[first] != distance[second]
    first, second = first[keep], second[keep]
    swap = distance[first] > distance[second]
    one, other = material[first], material[second]
    return DistanceComparisons(
        nearer=torch.where(swap, second, first),
        farther=torch.where(swap, first, second),
        materials=torch.stack([one, torch.where(one == other, -1, other)], 1),
        weight=torch.ones(len(first), dtype=torch.float64, device="cpu"),
        group=torch.zeros_like(first) if group is None else group[first].unique(return_inverse=True)[1],
    )


def _label_indices(names: Sequence[str]) -> Tensor:
    """The place of each name among the sorted different ones."""
    place = {name: k for k, name in enumerate(sorted(set(names)))}
    return torch.tensor([place[name] for name in names], dtype=torch.long, device="cpu")


def _pairs(label: Tensor) -> tuple[Tensor, Tensor]:
    """Places of two different rows with the same label, each two once."""
    if label.dim() != 1:
        raise ShapeError(f"expected labels (R,), found {(*label.shape,)}")
    first, second = torch.triu_indices(len(label), len(label), 1, device="cpu")
    same = label[first] == label[second]
    return first[same], second[same]


def _standard_error_of_difference(opinions: Opinions, first: Tensor, second: Tensor) -> Tensor:
    error = opinions.standard_error
    return (error[first].square() + error[second].square()).sqrt()
