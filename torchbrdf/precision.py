"""Half precision and torch's modes: results do not depend on them, where work is done in float32 and without modes."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import torch
from torch import Tensor

HALVES = (torch.float16, torch.bfloat16)
"""Values are stored so, but such numbers hold too little to be worked with: squares overflow, sums stop growing."""


def widened(values: Tensor) -> Tensor:
    """Values of half precision in float32, others as they are.

    Example:
        >>> import torch
        >>> widened(torch.ones(2, dtype=torch.float16)).dtype, widened(torch.ones(2, dtype=torch.float64)).dtype
        (torch.float32, torch.float64)
    """
    return values.float() if values.dtype in HALVES else values


def without_autocast(device: str) -> AbstractContextManager[object]:
    """What turns autocast off on a kind of device, if it is on: matrix products would be in half precision.

    Example:
        >>> import torch
        >>> one = torch.ones(1, 1)
        >>> with torch.autocast("cpu"), without_autocast("cpu"):
        ...     (one @ one).dtype
        torch.float32
    """
    if device == "meta" or not torch.is_autocast_enabled(device):
        return nullcontext()
    return torch.autocast(device, enabled=False)


@contextmanager
def undisturbed() -> Iterator[None]:
    """A context, or a decorator of functions, without the caller's autocast and inference mode.

    For work that is the package's own, such as a fit, which differentiates for itself, and for tensors that are kept.

    Example:
        >>> import torch
        >>> with torch.inference_mode(), undisturbed():
        ...     torch.ones(1).is_inference()
        False
    """
    with torch.inference_mode(False), without_autocast("cpu"), without_autocast("cuda"):
        yield
