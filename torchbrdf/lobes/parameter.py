"""The parameters of lobes: declared once, with where a fit starts, bounds, and what they mean."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, overload

import torch
from torch import Tensor, nn

from torchbrdf.errors import ShapeError, UsageError

if TYPE_CHECKING:
    from torchbrdf.lobes.base import Lobe

Value = Tensor | float | list[float]
"""What a parameter can be set to: a tensor, a number for every entry, or a list."""


@dataclass
class BoundedParameter:
    """A parameter of a lobe, declared once as a class attribute: where a fit starts, its bounds, and what it means.

    On a lobe the attribute is the parameter itself, a tensor; on its class it is this declaration.

    Args:
        start: where a fit starts.
        lower: the least value of a fit.
        upper: the largest value of a fit.
        doc: what it means, in a few words.
        shape: `(1,)` for a scalar, `(3,)` for one value a channel, of which there are three as long as nobody asks for
            others.
        linear: the lobe's value is proportional to it, as to an albedo.
        affine: the lobe's value is a constant plus something proportional to it, as with Schlick's F0.
        log: solvers move it on a logarithmic scale, for a range of many decades.
        optional: files may lack it, as those of before it was there do; its start stands for it.
        per_channel: the last of the shape's numbers counts channels; so it is wherever that is 3.

    Raises:
        UsageError: lower <= start <= upper does not hold, or lower is not above 0 on a logarithmic scale.

    Example:
        >>> from torchbrdf.lobes import BoundedParameter, Ward
        >>> Ward.roughness.lower, Ward.roughness.upper
        (0.001, 0.5)
        >>> Ward(roughness=0.3).roughness
        Parameter containing:
        tensor([0.3000], requires_grad=True)
    """

    start: float
    lower: float
    upper: float
    doc: str
    shape: tuple[int, ...] = (1,)
    linear: bool = False
    affine: bool = False
    log: bool = False
    optional: bool = False
    per_channel: bool = False
    name: str = field(default="", init=False)

    def __post_init__(self) -> None:
        self.per_channel = self.per_channel or self.shape[-1:] == (3,)

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        if not self.lower <= self.start <= self.upper or (self.log and self.lower <= 0):
            found = f"lower {self.lower:g}, start {self.start:g}, upper {self.upper:g}"
            above = "0 < " if self.log else ""
            raise UsageError(f"{owner.__name__}.{name}: expected {above}lower <= start <= upper, found {found}")

    @overload
    def __get__(self, lobe: None, owner: type) -> "BoundedParameter": ...
    @overload
    def __get__(self, lobe: "Lobe", owner: type) -> Tensor: ...
    def __get__(self, lobe: "Lobe | None", owner: type) -> "BoundedParameter | Tensor":
        if lobe is None:
            return self
        try:
            return lobe._parameters[self.name]  # type: ignore[return-value]
        except KeyError:
            raise AttributeError(f"{owner.__name__} has no {self.name} yet") from None

    def __set__(self, lobe: "Lobe", value: Value) -> None:
        where, like = f"{type(lobe).__name__}.{self.name}", lobe._parameters.get(self.name)
        if isinstance(value, Tensor) and value.requires_grad:
            raise UsageError(f"{where}: expected a number or a tensor without a graph, found one that requires_grad")
        value = self.expand(value, where, like.dtype if like is not None else None)
        if like is not None:
            value = value.to(like.device).expand(like.shape if value.dim() < like.dim() else value.shape)
        setattr(lobe, self.name, nn.Parameter(value.clone()))

    def expand(self, value: Value, where: str, dtype: torch.dtype | None = None) -> Tensor:
        """A value as a tensor `(..., *shape)`.

        Args:
            value: a number for every entry, or what broadcasts to `shape` behind leading dimensions.
            where: whose it is, for messages.
            dtype: of the result; None: the value's own, or torch's default if it has none.

        Returns:
            The tensor, a view where possible.

        Raises:
            ShapeError: it does not broadcast, or is not finite.
            UsageError: it is no number, tensor or list of real numbers, or the dtype is none of floats.
        """
        if dtype is not None and not (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
            raise UsageError(f"{where}: expected a dtype of floats, found {dtype!r}")
        tensor = _as_tensor(value, where)
        own = hasattr(value, "dtype") and tensor.is_floating_point()
        tensor = tensor.to(dtype or (tensor.dtype if own else torch.get_default_dtype()))
        # A parameter of infinity is 0 times infinity somewhere. Tensors without values, of the meta device, have none.
        if not tensor.is_meta and not bool(tensor.isfinite().all()):
            raise ShapeError(f"{where}: expected finite values in {tensor.dtype}, found {_not_finite(tensor)}")
        try:
            lead = tensor.shape[: max(tensor.dim() - len(self.shape), 0)]
            return tensor.expand(*lead, *self.shape)
        except RuntimeError:
            expected = ", ".join(map(str, self.shape))
            raise ShapeError(f"{where}: expected (..., {expected}), found {(*tensor.shape,)}") from None

    @property
    def is_colour(self) -> bool:
        """Whether it is one value a channel."""
        return self.per_channel and len(self.shape) == 1

    @property
    def is_scalar(self) -> bool:
        """Whether it is one number for all channels."""
        return self.size == 1 and not self.per_channel

    @property
    def size(self) -> int:
        """How many numbers a material has."""
        return math.prod(self.shape)


def albedo(shape: tuple[int, ...] = (3,), *, start: float, upper: float = 1.0, doc: str) -> BoundedParameter:
    """Declare an albedo: a `BoundedParameter` that is linear, from 0 on, one value a channel.

    Args:
        shape: of one material's values.
        start: where a fit starts.
        upper: the largest value of a fit.
        doc: what it means, in a few words.

    Returns:
        The declaration, a `BoundedParameter`.

    Example:
        >>> from torchbrdf.lobes import Ward
        >>> Ward.specular.linear, Ward.specular.shape
        (True, (3,))
    """
    return BoundedParameter(start=start, lower=0.0, upper=upper, doc=doc, shape=shape, linear=True)


def share(start: float, doc: str) -> BoundedParameter:
    """Declare a number from 0 to 1.

    Args:
        start: where a fit starts.
        doc: what it means, in a few words.

    Returns:
        The declaration, a `BoundedParameter`.

    Example:
        >>> from torchbrdf.lobes import Principled
        >>> Principled.metallic.lower, Principled.metallic.upper
        (0.0, 1.0)
    """
    return BoundedParameter(start=start, lower=0.0, upper=1.0, doc=doc)


def _as_tensor(value: Value, where: str) -> Tensor:
    """A value as a tensor of real numbers; without a device of its own on the CPU, whatever torch's default is."""
    if isinstance(value, Tensor):
        tensor = value
    else:
        try:
            # Numbers in float64, lest torch's default dtype round them.
            tensor = torch.as_tensor(value, dtype=None if hasattr(value, "dtype") else torch.float64, device="cpu")
        except (TypeError, ValueError, RuntimeError, OverflowError):
            raise UsageError(f"{where}: expected a number, a tensor or a list, found {type(value).__name__}") from None
    if tensor.is_complex():
        raise UsageError(f"{where}: expected real numbers, found {tensor.dtype}")
    return tensor


def _not_finite(value: Tensor) -> float:
    """The first value that is not finite."""
    return float(value.flatten()[int((~value.isfinite()).flatten().to(torch.int8).argmax())])
