"""What a loss is: one error for each material, from two sets of values on the same Pairs."""

import inspect
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from torchbrdf.errors import ShapeError
from torchbrdf.kinds import LOSSES as _LOSSES
from torchbrdf.losses import derivatives
from torchbrdf.losses.elementary import NEW, Out
from torchbrdf.losses.kept import Kept
from torchbrdf.losses.problem import MeasuredValues, Problem
from torchbrdf.pairs import Pairs
from torchbrdf.precision import widened
from torchbrdf.reduction import Reduction, check_reduction, reduced
from torchbrdf.registry import Registry
from torchbrdf.roots import safe_sqrt

LOSSES: Registry[type["Loss"]] = _LOSSES
# Names of before, which fits.json and commands may still have.
LOSSES.alias("cosine", "cosine_rms")
LOSSES.alias("cuberoot", "cube_root")
LOSSES.alias("solid_angle_cosine", "solid_angle_cosine_rms")


class Loss(nn.Module):
    """An error for each material: `loss(prediction, target, pairs, weight=None)`.

    The base class is the root of the weighted mean of penalties: the square of each error is the mean of
    `penalty(encode(prediction) - encode(target))` over every channel of every pair. A subclass registers itself, says
    in `needs` which quantities of Pairs it reads, and gives

    - `encode`, and `penalty` where it is not the square, each a function of one value at a time; or, where `encode` is
      a function of a value times what depends on the pair alone, `exposure` and `compress` in its place; or
    - `error`, for any other error of each material; or
    - `forward` alone, which `torchbrdf.fit` takes as it takes any function of (prediction, target).

    Fits use closed derivatives where a subclass gives `encode_with_derivative` and `penalty_with_derivatives`, and
    autograd where it does not.

    Args:
        reduction: "none" gives the error of each material, `(...)`; "mean" and "sum" a scalar.

    Raises:
        UsageError: for any other reduction.

    Example:
        >>> import torch
        >>> from torchbrdf.losses import Loss
        >>> class L1Loss(Loss):
        ...     smoothing_widths = (0.1, 0.01, 0.001)
        ...     def encode(self, values, pairs):
        ...         return values
        ...     def penalty(self, difference):
        ...         return difference.abs()
        >>> L1Loss()(torch.full((1, 5, 3), 3.0), torch.full((1, 5, 3), -1.0))
        tensor(2.)
    """

    needs: ClassVar[tuple[str, ...]] = ()
    """Which quantities of Pairs it reads."""
    objective: ClassVar[str] = "pointwise"
    """Which objective of `torchbrdf.fitting.objective` a fit makes of it: "pointwise", "binned", "image" or "autograd".
    A subclass that overrides how errors are computed has "autograd", unless it says otherwise."""
    supports_subsampling: ClassVar[bool] = True
    scene_summary: str = ""
    """What pictures it compares, in words, if it compares pictures; fits record it."""
    smoothing_widths: tuple[float | None, ...] = (None,)
    """Widths over which a cusp at equal values is rounded on the way to a minimum, in units of the mean of what is
    encoded, one after the other; None: there is no cusp."""
    default_diffuse: ClassVar[str] = "45:0"
    """How `torchbrdf.fit` treats the diffuse albedo unless told: "45:0", measured and held, or "fit". A loss has "fit"
    where fits under it were seen to look better so."""
    has_linear_encoding: ClassVar[bool] = False
    """Whether `encode` multiplies values by what depends on the pair alone; a subclass that gives `encode` says so."""
    has_exposure: ClassVar[bool] = False
    """Whether `encode` is `compress` of values times `exposure`: a class says so by giving `exposure`, and that it is
    not by giving an `encode` of its own."""
    needs_rgb: ClassVar[bool] = False
    """Whether it is of linear RGB only, as one of pictures is."""
    is_root: bool = True
    """Whether the error is the square root of what a fit minimises."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        own = vars(cls)
        if "objective" not in own and own.keys() & {"error", "forward", "pointwise"}:
            cls.objective = "autograd"
        # What is derived from a method that is overridden is not inherited from further up.
        if "encode" in own and "has_linear_encoding" not in own:
            cls.has_linear_encoding = False
        if own.keys() & {"exposure", "encode", "encode_with_derivative"}:
            cls.has_exposure = "exposure" in own
        for method, derived in (
            ("encode", "encode_with_derivative"),
            ("compress", "compress_with_derivative"),
            ("penalty", "penalty_with_derivatives"),
        ):
            if method in own and derived not in own:
                setattr(cls, derived, getattr(Loss, derived))

    def __init__(self, reduction: Reduction = "mean") -> None:
        super().__init__()
        check_reduction(self, reduction)
        self.reduction = reduction
        self._kept_target: Kept[Any] = Kept()  # what is compared of the last target

    @property
    def registered_name(self) -> str:
        """The name it is registered under; its class's, if it is not."""
        return LOSSES.name_of(type(self)) or type(self).__name__

    @property
    def has_closed_derivatives(self) -> bool:
        """Whether it gives the derivatives of `encode` and `penalty` itself."""
        kind = type(self)
        squares, plain = kind.penalty is Loss.penalty, kind.compress is Loss.compress
        closed_penalty = squares or kind.penalty_with_derivatives is not Loss.penalty_with_derivatives
        closed_compress = plain or kind.compress_with_derivative is not Loss.compress_with_derivative
        closed_encode = kind.encode_with_derivative is not Loss.encode_with_derivative
        return closed_penalty and (closed_encode or (kind.has_exposure and closed_compress))

    @property
    def is_quadratic(self) -> bool:
        """Whether it is the root of a mean of squares of differences of values on the measured pairs, with weights."""
        kind = type(self)
        own = kind.penalty is Loss.penalty and kind.problem is Loss.problem
        return own and self.objective == "pointwise" and self.has_linear_encoding

    def is_elementwise(self) -> bool:
        """Whether `encode` and `penalty` are functions of one value at a time.

        Taken on trust of closed derivatives, else tried on a few values. No property: `nn.Module` hides an
        AttributeError that is raised within one.
        """
        return self.has_closed_derivatives or derivatives.elementwise(self)

    def is_separable(self) -> bool:
        """Whether the error is a mean over pairs of penalties, so that parts of the pairs can be summed apart."""
        return self.objective == "pointwise" and self.is_elementwise()

    def exposure(self, pairs: Pairs | None) -> Tensor | None:
        """What `encode` multiplies values by before all else, `(..., N)`; None: `encode` says all there is."""
        return None

    def compress(self, x: Tensor) -> Tensor:
        """What is compared of values times `exposure`: these as they are."""
        return x

    def compress_with_derivative(self, x: Tensor, out: Out = NEW) -> tuple[Tensor, Tensor | None]:
        """`compress`, and its derivative; None: it is 1. By autograd, unless a loss knows a shorter way.

        out: two tensors like x, where both may be put.
        """
        if type(self).compress is Loss.compress:
            return x, None
        return derivatives.derivative_of(self.compress, x)

    def encode(self, values: Tensor, pairs: Pairs | None) -> Tensor:
        """What is compared of each value, `(..., N, C)`."""
        exposure = self.exposure(pairs)
        if exposure is None:
            raise NotImplementedError(
                f"{type(self).__name__}: expected a method encode, error or forward, found none of them"
            )
        return self.compress(values * exposure[..., None])

    def encode_with_derivative(self, values: Tensor, pairs: Pairs | None) -> tuple[Tensor, Tensor]:
        """`encode`, and its derivative by each value; by autograd, unless a loss knows a shorter way."""
        exposure = self.exposure(pairs) if self.has_exposure else None
        if exposure is None:
            return derivatives.derivative_of(lambda point: self.encode(point, pairs), values)
        column = exposure[..., None]
        encoded, rate = self.compress_with_derivative(values * column)
        return encoded, column if rate is None else rate * column

    def penalty(self, difference: Tensor) -> Tensor:
        """What each difference adds, at least 0: its square."""
        return difference.square()

    def penalty_with_derivatives(
        self, difference: Tensor, width: Tensor | None = None, out: Out = NEW
    ) -> tuple[Tensor, Tensor, Tensor]:
        """`penalty`, its derivative, and the curvature, at least 0, of a parabola that stands in for it nearby.

        width, which broadcasts: a penalty with a cusp at 0 is rounded there over differences of this size. The square
        is its own parabola; of other penalties by autograd, unless a loss knows a shorter way. out: three tensors like
        the difference, where these may be put.
        """
        if type(self).penalty is Loss.penalty:
            square = torch.mul(difference, difference, out=out[0])
            return square, torch.mul(difference, 2, out=out[1]), difference.new_full((1, 1), 2)
        return derivatives.penalty_with_derivatives(self, difference, width)

    def sample_weight(self, pairs: Pairs) -> Tensor | None:
        """How much each pair counts beside its weight, `(..., N)`, if not all the same."""
        return None

    def effective_weight(self, pairs: Pairs | None, weight: Tensor | None) -> Tensor | None:
        """The weight of each pair times `sample_weight`, `(..., N, 1|C)`; None if all count the same."""
        own = None if pairs is None else self.sample_weight(pairs)
        if own is None:
            return weight
        return own[..., None] if weight is None else weight * own[..., None]

    def pointwise(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> Tensor:
        """The penalty of every value, `(..., N, C)`."""
        return self.penalty(self.encode(prediction, pairs) - self.encode(target, pairs))

    def finalize(self, value: Tensor) -> Tensor:
        """The error of what a fit minimises."""
        return safe_sqrt(value) if self.is_root else value

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The error of each material, in the units of the compared values.

        Args:
            prediction: values in 1/sr without the cosine, `(..., N, C)`.
            target: the same, of what is to be met.
            pairs: of shape `(..., N)`; may be None where `needs` is empty.
            weight: how much each value counts, broadcasts to the values; pairs of weight 0 do not count at all, but
                their values must be finite.

        Returns:
            `(...)`, float64, as it was summed; nan without any weight above 0.

        Raises:
            ShapeError: for tensors that do not fit together.
        """
        self._check(prediction, target, pairs, weight)
        prediction, target, pairs = self._widened(prediction, target, pairs)
        penalties = self.pointwise(prediction, target, pairs)
        if penalties.shape[-2:] != np.broadcast_shapes(prediction.shape[-2:], target.shape[-2:]):
            expected = f"expected a value for each of values {(*prediction.shape,)} from encode and penalty"
            raise ShapeError(f"{type(self).__name__}: {expected}, found {(*penalties.shape,)}")
        found = weighted_mean(penalties, self.effective_weight(pairs, weight))
        return self.finalize(found)

    def forward(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """`error` after the reduction, in the inputs' dtype."""
        error = self.error(prediction, target, pairs, weight).to(torch.promote_types(prediction.dtype, target.dtype))
        return reduced(error, self.reduction)

    def problem(self, measured: MeasuredValues, subset: Tensor | None = None) -> Problem:
        """The measured pairs, or those of them that `subset` names by index, as a Problem."""
        part = measured if subset is None else measured.batch(samples=subset)
        return Problem(part.pairs, part.values, part.weight)

    def select(self, problem: Problem, samples: Tensor) -> Problem:
        """The part of a problem that has only some of the measured pairs, by index."""
        return problem.select(samples=samples)

    def with_luminance(self, shares: Sequence[float]) -> "Loss":
        """The loss of values whose channels count so much in luminance; itself, if luminance is nothing to it.

        Args:
            shares: of each channel.

        Example:
            >>> from torchbrdf.losses import LearnedLoss
            >>> LearnedLoss().with_luminance([0.1, 0.6, 0.3])
            LearnedLoss(luminance=(0.1, 0.6, 0.3))
        """
        return self

    def _widened(self, prediction: Tensor, target: Tensor, pairs: Pairs | None) -> tuple[Tensor, Tensor, Pairs | None]:
        """Values of half precision in float32."""
        return widened(prediction), widened(target), pairs.widened() if self.needs and pairs is not None else pairs

    def extra_repr(self) -> str:
        """The arguments of the constructor that are not the defaults."""
        parameters = inspect.signature(type(self).__init__).parameters.values()
        given = [(one.name, getattr(self, one.name)) for one in parameters if hasattr(self, one.name)]
        defaults = {one.name: one.default for one in parameters}
        return ", ".join(f"{name}={value!r}" for name, value in given if value != defaults[name])

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_kept_target": Kept()}  # copies and other processes have other targets

    def _check(self, prediction: Tensor, target: Tensor, pairs: Pairs | None, weight: Tensor | None) -> None:
        name = type(self).__name__
        for values in (prediction, target):
            if not values.is_floating_point():
                raise ShapeError(f"{name}: expected values of floats, found {values.dtype}")
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


def cosine(pairs: Pairs | None) -> Tensor:
    """cos_i as a column `(..., N, 1)`, zero below the horizon."""
    if pairs is None:
        raise ShapeError("pairs are needed for cos_i")
    return pairs.cos_i.clamp_min(0)[..., None]


def weighted_mean(values: Tensor, weight: Tensor | None) -> Tensor:
    """Mean over pairs and channels, `(..., N, C)` to `(...)`, summed and returned in float64."""
    if weight is None:
        return values.sum((-2, -1), dtype=torch.float64) / values.shape[-2:].numel()
    weight = weight.expand(np.broadcast_shapes(weight.shape, values.shape[-2:]))
    total = (values * weight).sum((-2, -1), dtype=torch.float64)
    return total / weight.sum((-2, -1), dtype=torch.float64)


def _shapes(prediction: Tensor, target: Tensor) -> str:
    return f"prediction {(*prediction.shape,)}, target {(*target.shape,)}"
