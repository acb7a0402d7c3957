"""Distances that a loss gives where people gave answers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import torch
from torch import Tensor, nn

from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.losses import ImageLoss, Loss
from torchbrdf.measured import Measured
from torchbrdf.measured.catalogue import is_merl
from torchbrdf.pairs import Pairs
from torchbrdf.perception.datasets.opinions import Opinions
from torchbrdf.perception.datasets.triplets import Triplets

# Bytes of values that a loss sees at once; it may make several times as many on its way.
_BATCH_BYTES = 2**23
# Materials whose values on the pairs of a scene are held at once.
_MATERIALS = 8

METHODS = {"WARD": "ngan_ward", "BLINN-PHONG": "ngan_blinnphong", "SGD": "bagher_sgd", "ABC": "low_lowmicrofacet_E2"}
"""Methods of the opinions whose parameters are published, and their sets in `perception.datasets.published`."""


class Approximation(Protocol):
    """Models of several materials."""

    @property
    def materials(self) -> list[str]:
        """Their names."""
        ...

    def of(self, materials: Sequence[str]) -> nn.Module:
        """A batched model of these materials, in this order, that gives values on pairs."""
        ...


@dataclass(frozen=True)
class BenchmarkData:
    """Data of the benchmark: what people were asked about, as BRDFs, and their answers.

    Args:
        measured: Has all materials of the triplets, by name.
        triplets: Questions about materials.
        all_opinions: Of approximations. Rows of methods without a model, or of materials that a method has no model
            of, are left out: `opinions` are those that remain.
        approximations: Models by method.

    Raises:
        DataError: A material is missing.
    """

    measured: Measured
    triplets: Triplets
    all_opinions: Opinions
    approximations: Mapping[str, Approximation]

    def __post_init__(self) -> None:
        wanted = self.names
        missing = sorted(set(wanted) - set(self.measured.names))
        if missing:
            shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
            raise DataError(
                f"materials: expected all {len(wanted)} that people were asked about, found {len(self.measured)} "
                f"without {len(missing)} of them: {shown}"
            )

    @cached_property
    def opinions(self) -> Opinions:
        """The opinions of approximations that have a model."""
        given = {method: set(models.materials) for method, models in self.approximations.items()}
        named = enumerate(zip(self.all_opinions.methods, self.all_opinions.materials, strict=True))
        return self.all_opinions.select([row for row, (method, name) in named if name in given.get(method, ())])

    @property
    def names(self) -> list[str]:
        """The materials of the triplets, and behind them those that only have approximations."""
        return list(dict.fromkeys([*self.triplets.materials, *self.opinions.materials]))

    @property
    def stand_in(self) -> bool:
        """Whether any table is not MERL's own, by its checksum."""
        return self.measured.stand_in or not all(is_merl(path) for path in self.measured.source.paths)

    @property
    def left_out(self) -> list[str]:
        """Methods that have opinions but no model."""
        return sorted(set(self.all_opinions.methods) - set(self.approximations))

    def references(self, pairs: Pairs, materials: Sequence[str]) -> Tensor:
        """Values of the materials, `(K, N, 3)`, in the dtype of the pairs."""
        place = {name: k for k, name in enumerate(self.measured.names)}
        return self.measured.batch([place[name] for name in materials]).at(pairs)

    def approximated(self, pairs: Pairs, rows: Sequence[int]) -> Tensor:
        """Values of some rows of the opinions, `(len(rows), N, 3)`, in the dtype of the pairs."""
        methods, materials = self.opinions.methods, self.opinions.materials
        values = pairs.cos_i.new_empty(len(rows), len(pairs), 3)
        with torch.no_grad():
            for method in dict.fromkeys(methods[row] for row in rows):
                own = [k for k, row in enumerate(rows) if methods[row] == method]
                model = self.approximations[method].of([materials[rows[k]] for k in own])
                values[own] = model.to(pairs.device, pairs.dtype)(pairs)
        return values


@dataclass(frozen=True)
class EvaluatedBrdfs:
    """Values of BRDFs that losses compare: materials, and approximations of them.

    Args:
        materials: `(K, n, 3)`, in the order of the triplets' names; n counts pairs, or pixels that a loss observes.
        approximations: `(R, n, 3)`, in the order of the opinions' rows.
        target: The place of each approximation's material, `(R,)`.
        pairs: Where the values are, or None for pixels.
    """

    materials: Tensor
    approximations: Tensor
    target: Tensor
    pairs: Pairs | None


def evaluate_brdfs(data: BenchmarkData, pairs: Pairs, through: ImageLoss | None = None) -> EvaluatedBrdfs:
    """Evaluate all BRDFs that people were asked about, once for all losses.

    Args:
        data: What people were asked about.
        pairs: `(N,)` or `(1, N)`.
        through: Keep not the values but what this loss observes of them; `pairs` are then those of its scene.

    Returns:
        Values in the dtype of the pairs.
    """
    names = data.names
    place = {name: k for k, name in enumerate(names)}
    step = len(names) if through is None else _MATERIALS
    rows = list(range(len(data.opinions)))
    observe = (lambda values: values) if through is None else through.observe
    return EvaluatedBrdfs(
        torch.cat([observe(data.references(pairs, names[k : k + step])) for k in range(0, len(names), step)]),
        torch.cat(
            [observe(data.approximated(pairs, rows[k : k + _MATERIALS])) for k in range(0, len(rows), _MATERIALS)]
            or [pairs.cos_i.new_empty(0, len(pairs), 3)]
        ),
        torch.tensor([place[name] for name in data.opinions.materials], dtype=torch.long, device="cpu"),
        pairs if through is None else None,
    )


def distances(
    loss: Loss, prediction: Tensor, target: Tensor, pairs: Pairs | None, first: Tensor, second: Tensor
) -> Tensor:
    """Distances that a loss gives: loss(prediction[first], target[second], pairs), in batches.

    Args:
        loss: With reduction "none".
        prediction: `(K, n, 3)`.
        target: `(K, n, 3)`.
        pairs: Those of the values, or None, where what is compared is what an ImageLoss observes.
        first: Places in `prediction`, `(P,)`.
        second: Places in `target`, `(P,)`.

    Returns:
        `(P,)`, float64.

    Raises:
        UsageError: The loss reduces, raises anything, or gives something else than a distance of each two; or it
            compares values on pairs and none are given.
        DataError: A distance is not finite.
    """
    name = loss.registered_name
    if loss.reduction != "none":
        raise UsageError(f"{type(loss).__name__}: expected reduction none, found {loss.reduction}")
    if pairs is None and not isinstance(loss, ImageLoss):
        raise UsageError(f"{type(loss).__name__}: compares values on pairs, but no pairs were given")
    found = torch.empty(len(first), dtype=torch.float64, device="cpu")
    step = max(_BATCH_BYTES // (prediction[0].numel() * prediction.element_size()), 1)
    with torch.no_grad():
        for k in range(0, len(first), step):
            one, other = prediction[first[k : k + step]], target[second[k : k + step]]
            found[k : k + step] = _called(loss, name, one, other, pairs)
    odd = ~found.isfinite()
    if odd.any():
        raise DataError(
            f"{name}: expected finite distances, found {int(odd.sum())} of {len(found)} that are not, first "
            f"{float(found[odd][0])}"
        )
    return found


def _called(loss: Loss, name: str, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
    """What a loss, which may be anybody's, says of each two; a UsageError for anything that is not distances."""
    try:
        if pairs is None and isinstance(loss, ImageLoss):
            found = loss.finalize(loss.compare(prediction, target))
        else:
            found = loss(prediction, target, pairs)
    except TorchbrdfError:
        raise
    except (Exception, SystemExit) as error:  # whatever other people's code raises
        raise UsageError(f"{name}: expected distances, but it raised {type(error).__name__}: {error}") from error
    if not isinstance(found, Tensor) or found.shape != prediction.shape[:1]:
        what = f"{(*found.shape,)}" if isinstance(found, Tensor) else type(found).__name__
        raise UsageError(f"{name}: expected distances {(*prediction.shape[:1],)}, found {what}")
    return found


def score_triplets(loss: Loss, brdfs: EvaluatedBrdfs, triplets: Triplets) -> Tensor:
    """Distances of triplets' candidates from their references by a loss.

    The candidate is the prediction, the reference the target.

    Returns:
        `(K, K)` float64 at [reference, candidate]; nan where no question asks for one.
    """
    count = len(triplets.materials)
    reference, a, b = triplets.questions.unbind(1)
    place = torch.cat([reference * count + a, reference * count + b]).unique()
    matrix = torch.full((count * count,), torch.nan, dtype=torch.float64, device="cpu")
    matrix[place] = distances(
        loss, brdfs.materials, brdfs.materials, brdfs.pairs, place % count, place.div(count, rounding_mode="floor")
    )
    return matrix.unflatten(0, (count, count))


def score_opinions(loss: Loss, brdfs: EvaluatedBrdfs) -> Tensor:
    """Distances of approximations from their materials by a loss, `(R,)` float64. The material is the target."""
    rows = torch.arange(len(brdfs.approximations), dtype=torch.int64, device="cpu")
    return distances(loss, brdfs.approximations, brdfs.materials, brdfs.pairs, rows, brdfs.target)
