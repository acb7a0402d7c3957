"""Elementary functions of many values, by whichever library is quickest at them.

`out` is where results go, as in torch; None: into a new tensor, by torch. With a place for it numpy's functions do the
work, whose last digit may depend on where a value is: for steps of a fit, not where equal values must be exactly equal.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

_QUICK = (torch.float32, torch.float64)
Out = tuple[Tensor | None, ...]
NEW: Out = (None, None, None)
"""New tensors for all results."""


def _is_quick(x: Tensor, out: Tensor | None) -> bool:
    """Whether numpy can work on it: with a place for results, on the CPU, without a graph, a tensor as others are."""
    if out is None:
        return False
    plain = type(x) is Tensor and x.dtype in _QUICK and x.device.type == "cpu" and not x.requires_grad
    return plain and not torch.compiler.is_compiling() and not torch._C._functorch.is_functorch_wrapped_tensor(x)


def _by_numpy(function: Callable[..., object], out: Tensor | None, x: Tensor, *more: float) -> Tensor:
    assert out is not None
    function(x.numpy(), *more, out=out.numpy())
    return out


def log(x: Tensor, out: Tensor | None = None) -> Tensor:
    """Natural logarithms: numpy's take a third of torch's time."""
    return _by_numpy(np.log, out, x) if _is_quick(x, out) else torch.log(x, out=out)


def log1p(x: Tensor, out: Tensor | None = None) -> Tensor:
    """Logarithms of 1 + x, likewise."""
    return _by_numpy(np.log1p, out, x) if _is_quick(x, out) else torch.log1p(x, out=out)


def power(x: Tensor, exponent: float, out: Tensor | None = None) -> Tensor:
    """Powers of positive numbers: a cube root by numpy takes a ninth, others half of torch's time."""
    if not _is_quick(x, out):
        return torch.pow(x, exponent, out=out)
    if exponent == 1 / 3:
        return _by_numpy(np.cbrt, out, x)
    return torch.sqrt(x, out=out) if exponent == 0.5 else _by_numpy(np.power, out, x, exponent)


def where_positive(slope: Tensor, x: Tensor) -> Tensor:
    """slope, in its place, where x is above 0, else 0, in one pass."""
    found: Tensor = torch.ops.aten.threshold_backward.grad_input(slope, x, 0, grad_input=slope)
    return found
