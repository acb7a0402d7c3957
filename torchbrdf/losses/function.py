"""Any function of a prediction and a target as a loss."""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.losses.base import LOSSES, Loss
from torchbrdf.pairs import Pairs
from torchbrdf.reduction import Reduction


class FunctionLoss(Loss):
    """A function or a module of (prediction, target), such as `torch.nn.MSELoss()`, as a loss.

    It is called for one material after the other, with values `(1, n, C)` on the pairs that count, those of weight
    above 0; and with keyword arguments `pairs`, `(1, n)`, and `weight`, `(1, n, 1|C)`, if it takes them. What it
    returns is the error: a scalar or `(1,)`; or it is of each pair, `(1, n)`, or value, `(1, n, C)`, and their weighted
    mean is the error. A fit minimises it as it is.

    Args:
        function: what is called.
        reduction: as of `Loss`.

    Raises:
        UsageError: for what cannot be called, or cannot be called with two arguments.

    Example:
        >>> import torch
        >>> loss = FunctionLoss(torch.nn.L1Loss(), reduction="none")
        >>> loss(torch.full((2, 5, 3), 3.0), torch.ones(2, 5, 3))
        tensor([2., 2.])
    """

    objective = "autograd"
    is_root = False

    def __init__(self, function: Callable[..., Tensor], reduction: Reduction = "mean") -> None:
        super().__init__(reduction)
        if isinstance(function, type):
            name = function.__name__
            raise UsageError(f"loss: expected an instance or a function, found the class {name}; write {name}()")
        if not callable(function):
            kind = type(function).__name__
            raise UsageError(f"loss: expected a Loss, a module or a function of (prediction, target), found {kind}")
        self.function = function
        self._options = _options(function)

    @property
    def registered_name(self) -> str:
        """That of a loss, else the function's or its class's."""
        inner = self.function
        return inner.registered_name if isinstance(inner, Loss) else getattr(inner, "__name__", type(inner).__name__)

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """What the function says of each material, `(...)`, float64."""
        self._check(prediction, target, pairs, weight)
        lead = np.broadcast_shapes(prediction.shape[:-2], target.shape[:-2])
        whole = (*lead, *target.shape[-2:])
        one, other = (values.expand(whole).reshape(-1, *whole[-2:]) for values in (prediction, target))
        if weight is not None:
            weight = weight.expand(*lead, whole[-2], weight.shape[-1]).reshape(-1, whole[-2], weight.shape[-1])
        found = [self._material(k, one, other, pairs, weight) for k in range(len(one))]
        return torch.stack(found).reshape(lead) if found else one.new_zeros(lead, dtype=torch.float64)

    def _material(
        self, k: int, prediction: Tensor, target: Tensor, pairs: Pairs | None, weight: Tensor | None
    ) -> Tensor:
        one, other, own = prediction[k : k + 1], target[k : k + 1], None if weight is None else weight[k : k + 1]
        here = None if pairs is None else pairs.select(materials=[k])
        if own is not None and bool((own <= 0).any()):
            counting = (own[0] > 0).any(-1).nonzero()[:, 0]
            if not len(counting):
                return one.new_full((), torch.nan, dtype=torch.float64)
            one, other, own = one[:, counting], other[:, counting], own[:, counting]
            here = None if here is None else here.select(samples=counting)
        options = {key: value for key, value in (("pairs", here), ("weight", own)) if key in self._options}
        found = self.function(one, other, **options)
        name = self.registered_name
        if not isinstance(found, Tensor):
            raise ShapeError(f"{name}: expected a tensor from (prediction, target), found {type(found).__name__}")
        equal = own is None or "weight" in options or bool((own == own.flatten()[0]).all())
        if found.numel() == 1 and found.dim() <= 1:
            if not equal:
                raise ShapeError(f"{name}: weights that differ need a value for each pair (1, N), found one number")
            return found.double().reshape(())
        shapes = {(1, one.shape[1]), (1, one.shape[1], 1), (*one.shape,)}
        if (*found.shape,) not in shapes:
            expected = f"a scalar, (1,), (1, N) or (1, N, C) of values {(*one.shape,)}"
            raise ShapeError(f"{name}: expected {expected}, found {(*found.shape,)}")
        values = found.double() if found.dim() == 3 else found.double()[..., None]
        if own is None or equal:
            return values.mean()
        counts = own.double().expand_as(values) if own.shape[-1] == 1 else own.double()
        return (values * counts).sum() / counts.expand(np.broadcast_shapes(counts.shape, values.shape)).sum()


def as_loss(loss: Any) -> Loss:
    """What `fit` takes as a Loss: any module or function, and a Loss that gives `forward` alone, as a `FunctionLoss`.

    Args:
        loss: a `Loss`, or a module or function of (prediction, target).

    Returns:
        The loss itself, or a `FunctionLoss` of it.

    Raises:
        UsageError: for what is neither.

    Example:
        >>> import torch
        >>> as_loss(torch.nn.MSELoss()).registered_name
        'MSELoss'
    """
    if isinstance(loss, Loss):
        kind = type(loss)
        return loss if kind.forward is Loss.forward or kind.error is not Loss.error else FunctionLoss(loss)
    return FunctionLoss(loss)


def make_loss(name: str, reduction: Reduction = "mean") -> Loss:
    """A registered loss by name, with its defaults: a class, an instance or a function of (prediction, target).

    Args:
        name: as in `LOSSES`.
        reduction: as of `Loss`.

    Returns:
        The loss, or a `FunctionLoss` of what is registered.

    Raises:
        UsageError: for an unknown name, or for what is registered but is no loss.

    Example:
        >>> make_loss("cosine_rms", "none")
        CosineRMSLoss(reduction='none')
    """
    found: Any = LOSSES[name]
    if isinstance(found, type) and issubclass(found, Loss):
        found = found() if reduction == "mean" else found(reduction=reduction)
    if isinstance(found, Loss):
        return found
    return FunctionLoss(found() if isinstance(found, type) else found, reduction)


def _options(function: Any) -> set[str]:
    """Which of pairs and weight a function takes; a UsageError if it does not take a prediction and a target."""
    inner = function.forward if isinstance(function, torch.nn.Module) else function
    try:
        signature = inspect.signature(inner)
    except (TypeError, ValueError):  # written in C, which does not say
        return set()
    known = {name for name in ("pairs", "weight") if name in signature.parameters}
    try:
        signature.bind(None, None, **dict.fromkeys(known))
    except TypeError as error:
        name = getattr(function, "__name__", type(function).__name__)
        raise UsageError(f"loss {name}: expected a function of (prediction, target): {error}") from None
    return known
