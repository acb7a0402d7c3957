"""What a loss is: one error for each material, from two sets of values on the same Pairs."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

import torch
from torch import Tensor, nn

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.pairs import Pairs
from torchbrdf.registry import Registry

LOSSES: Registry[type["Loss"]] = Registry("loss", "torchbrdf.losses")

Reduction = Literal["none", "mean", "sum"]
HALVES = (torch.float16, torch.bfloat16)


@dataclass(frozen=True)
class Problem:
    """What a fit solves: find values on `pairs` that come close to `target`, `(M, N, 3)`, under `weight`."""

    pairs: Pairs
    target: Tensor
    weight: Tensor | None = None

    def select(self, materials: Tensor | None = None, samples: Tensor | None = None) -> "Problem":
        """Some materials and some of the pairs, by index, as `Pairs.select`."""
        target, weight = self.target, self.weight
        if materials is not None:
            target = target[materials]
            weight = weight[materials] if weight is not None and len(weight) > 1 else weight
        if samples is not None:
            target = target[:, samples]
            weight = weight[:, samples] if weight is not None and weight.shape[1] > 1 else weight
        return Problem(self.pairs.select(materials, samples), target, weight)


class Samples(Protocol):
    """What a loss asks of a measured BRDF."""

    @property
    def pairs(self) -> Pairs: ...
    @property
    def values(self) -> Tensor: ...
    @property
    def weight(self) -> Tensor: ...
    def batch(self, materials: list[int] | None = None, samples: Tensor | None = None) -> "Samples": ...


class Loss(nn.Module):
    """An error for each material: the root of the weighted mean of a pointwise difference.

    `loss(prediction, target, pairs, weight=None)` takes values `(..., N, C)` in 1/sr without the cosine, Pairs of
    shape `(..., N)` and weights that broadcast to the values; the mean counts every channel of every pair, and
    pairs of weight 0 do not count (their values must be finite). The error has the shape `(...)` with
    reduction="none", and is a scalar with "mean" or "sum". Without any weight above 0 there is no error: nan.

    A subclass registers itself, says in `needs` which quantities of Pairs it reads, and gives `encode` and `penalty`,
    each with its derivative beside it: the error's square is the mean of penalty(encode(prediction) - encode(target)).
    """

    needs: ClassVar[tuple[str, ...]] = ()
    subsets: ClassVar[bool] = True
    scene: str = ""
    """What pictures it compares, in words, if it compares pictures; fits record it."""
    rounding: ClassVar[tuple[float | None, ...]] = (None,)
    """Widths over which a cusp at equal values is rounded on the way to a minimum, in units of the mean of what is
    encoded, one after the other; None: there is no cusp."""

    _aimed: tuple[Tensor, int, Pairs | None, Tensor] | None = None

    def __init__(self, reduction: Reduction = "mean") -> None:
        super().__init__()
        if reduction not in ("none", "mean", "sum"):
            raise UsageError(f"{type(self).__name__}: expected reduction none, mean or sum, found {reduction!r}")
        self.reduction = reduction

    @property
    def registered_name(self) -> str:
        """The name it is registered under; its class's, if it is not."""
        return next((name for name, kind in LOSSES.items() if type(self) is kind), type(self).__name__)

    @property
    def analytic(self) -> bool:
        """Whether the error is a mean over pairs of penalties, so that parts of the pairs can be summed apart."""
        return type(self).error is Loss.error

    def encode(self, values: Tensor, pairs: Pairs | None) -> Tensor:
        """What is compared of each value, `(..., N, C)`."""
        raise NotImplementedError

    def encode_slope(self, values: Tensor, pairs: Pairs | None) -> tuple[Tensor, Tensor]:
        """`encode`, and its derivative by each value, at least 0."""
        raise NotImplementedError

    def penalty(self, difference: Tensor) -> Tensor:
        """What each difference adds, at least 0."""
        raise NotImplementedError

    def penalty_slope(self, difference: Tensor, width: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """`penalty`, its derivative, and the curvature, at least 0, of a parabola that stands in for it nearby.

        width, which broadcasts: a penalty with a cusp at 0 is rounded there over differences of this size.
        """
        raise NotImplementedError

    def density(self, pairs: Pairs) -> Tensor | None:
        """How much each pair counts beside its weight, `(..., N)`, if not all the same."""
        return None

    def counted(self, pairs: Pairs | None, weight: Tensor | None) -> Tensor | None:
        """The weight of each pair with its density, `(..., N, 1)`; None if all count the same."""
        density = None if pairs is None else self.density(pairs)
        if density is None:
            return weight
        return density[..., None] if weight is None else weight * density[..., None]

    def pointwise(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        """The penalty of every value, `(..., N, C)`."""
        return self.penalty(self.encode(prediction, pairs) - self.encode(target, pairs))

    def figure(self, value: Tensor) -> Tensor:
        """The error of what a fit minimises: here the root of a mean."""
        return safe_sqrt(value)

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The error of each material, `(...)`, in the units of the compared values and in float64, as it was summed."""
        self._check(prediction, target, pairs, weight)
        prediction, target, pairs = self._widened(prediction, target, pairs)
        return self.figure(weighted_mean(self.pointwise(prediction, target, pairs), self.counted(pairs, weight)))

    def forward(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The error after the reduction, in the inputs' dtype; see the class for the shapes."""
        error = self.error(prediction, target, pairs, weight).to(torch.promote_types(prediction.dtype, target.dtype))
        if self.reduction == "none":
            return error
        return error.mean() if self.reduction == "mean" else error.sum()

    def remembered(self, target: Tensor, pairs: Pairs | None, make: Callable[[], Tensor]) -> Tensor:
        """make(), what is compared of a target, kept for when the same tensor comes again, unchanged and on the same
        pairs, as it does in every step of a fit."""
        if torch.compiler.is_compiling() or target.requires_grad or target.is_inference():
            return make()
        kept = self._aimed
        if kept is None or kept[0] is not target or kept[1] != target._version or kept[2] is not pairs:
            kept = self._aimed = target, target._version, pairs, make()
        return kept[3]

    def problem(self, measured: Samples, subset: Tensor | None = None) -> Problem:
        """The measured pairs, or those of them that `subset` names by index, as a Problem."""
        part = measured if subset is None else measured.batch(samples=subset)
        return Problem(part.pairs, part.values, part.weight)

    def _widened(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> tuple[Tensor, Tensor, Pairs | None]:
        """Values of half precision in float32: they are stored so, but hold too little to be worked with."""
        if prediction.dtype in HALVES:
            prediction = prediction.float()
        if target.dtype in HALVES:
            target = target.float()
        if self.needs and pairs is not None and pairs.dtype in HALVES:
            pairs = pairs.to(dtype=torch.float32)
        return prediction, target, pairs

    def extra_repr(self) -> str:
        """The arguments of the constructor that are not the defaults."""
        parameters = inspect.signature(type(self).__init__).parameters.values()
        given = [(one.name, getattr(self, one.name)) for one in parameters if hasattr(self, one.name)]
        defaults = {one.name: one.default for one in parameters}
        return ", ".join(f"{name}={value!r}" for name, value in given if value != defaults[name])

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_aimed": None}  # copies and other processes have other targets

    def _check(self, prediction: Tensor, target: Tensor, pairs: Pairs | None, weight: Tensor | None) -> None:
        name = type(self).__name__
        if prediction.dim() < 2 or target.dim() < 2:
            raise ShapeError(f"{name}: expected values (..., N, C), found {_shapes(prediction, target)}")
        if prediction.shape[-2:] != target.shape[-2:]:
            raise ShapeError(
                f"{name}: prediction and target differ in pairs or channels: {_shapes(prediction, target)}"
            )
        if self.needs and pairs is None:
            raise ShapeError(f"{name}: needs pairs for {', '.join(self.needs)}; give a Pairs, or Pairs.from_cosines")
        if self.needs and pairs is not None and len(pairs) not in (1, target.shape[-2]):
            raise ShapeError(f"{name}: {len(pairs)} pairs for values {(*target.shape,)}")
        if weight is not None:
            samples, channels = (1, 1, *weight.shape)[-2:]
            if samples not in (1, target.shape[-2]) or channels not in (1, target.shape[-1]):
                raise ShapeError(f"{name}: weights {(*weight.shape,)} do not broadcast to values {(*target.shape,)}")


class LeastSquares(Loss):
    """A loss that is a root mean square of differences."""

    def penalty(self, difference: Tensor) -> Tensor:
        """The square."""
        return difference.square()

    def penalty_slope(self, difference: Tensor, width: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """The square is its own parabola."""
        return difference.square(), 2 * difference, difference.new_full((1, 1), 2)


def cosine(pairs: Pairs | None) -> Tensor:
    """cos_i as a column `(..., N, 1)`, zero below the horizon."""
    if pairs is None:
        raise ShapeError("pairs are needed for cos_i")
    return pairs.cos_i.clamp_min(0)[..., None]


def weighted_mean(values: Tensor, weight: Tensor | None) -> Tensor:
    """Mean over pairs and channels, `(..., N, C)` to `(...)`, summed and returned in float64."""
    if weight is None:
        return values.sum((-2, -1), dtype=torch.float64) / values.shape[-2:].numel()
    weight = weight.expand(torch.broadcast_shapes(weight.shape, values.shape[-2:]))
    total = (values * weight).sum((-2, -1), dtype=torch.float64)
    return total / weight.sum((-2, -1), dtype=torch.float64)


def version(x: Tensor) -> int:
    """Changes with the tensor's content; those of inference mode have none, and cannot change outside it."""
    return -1 if torch.compiler.is_compiling() or x.is_inference() else x._version


def safe_sqrt(x: Tensor) -> Tensor:
    """Square root with gradient 0 at 0, where the true one is infinite."""
    positive = x > 0
    return torch.where(positive, torch.where(positive, x, 1).sqrt(), torch.where(x < 0, torch.nan, x))


def safe_power(x: Tensor, exponent: float) -> Tensor:
    """x^exponent for x >= 0, with gradient 0 at 0, where that of an exponent below 1 is infinite."""
    positive = x > 0
    return torch.where(positive, torch.where(positive, x, 1).pow(exponent), 0)


def _shapes(prediction: Tensor, target: Tensor) -> str:
    return f"prediction {(*prediction.shape,)}, target {(*target.shape,)}"
