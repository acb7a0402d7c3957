"""How a lobe's function is called: half precision in float32, and with errors that say what does not fit."""

import inspect
from collections.abc import Callable, Sequence
from functools import reduce, wraps

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.pairs import Pairs
from torchbrdf.precision import HALVES, widened

Function = Callable[..., Tensor]


def half_in_float32(function: Function) -> Function:
    """A lobe's function, which works in float32 where pairs or parameters are in half precision.

    Its values then are in what the types of pairs and parameters promote to, as those of any other dtypes: half
    precision ends at 65504 (float16), beyond which values are infinite.

    Args:
        function: of pairs and parameters `(..., k)`, by position or name.

    Returns:
        A function of the same.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import ward
        >>> up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float16)
        >>> ward(Pairs.from_directions(up, up), torch.full((3,), 0.5).half(), torch.tensor([0.002]).half())
        tensor([[9936., 9936., 9936.]], dtype=torch.float16)
    """

    @wraps(function)
    def wide(pairs: Pairs, *parameters: Tensor, **named: Tensor) -> Tensor:
        dtypes = {pairs.dtype, *(value.dtype for value in parameters), *(value.dtype for value in named.values())}
        if not dtypes & {*HALVES}:
            return function(pairs, *parameters, **named)
        wider = {name: widened(value) for name, value in named.items()}
        found = function(pairs.widened(), *map(widened, parameters), **wider)
        return found.to(reduce(torch.promote_types, dtypes))

    return wide


def check_signature(lobe: str, function: Function, names: Sequence[str]) -> None:
    """Refuse a function whose parameters are not those that a lobe declares.

    Args:
        lobe: what errors call it.
        function: of pairs and the parameters.
        names: of the declared parameters.

    Raises:
        UsageError: names or their order differ.

    Example:
        >>> from torchbrdf.lobes import ward
        >>> check_signature("Ward", ward, ["specular", "roughness"])
    """
    try:
        found = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # written in C, which does not say
        return
    if any(one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD) for one in found):
        return
    own, rest = found[1 : 1 + len(names)], found[1 + len(names) :]
    if [one.name for one in own] != list(names) or any(one.default is one.empty for one in rest):
        expected, shown = ", ".join(["pairs", *names]), ", ".join(one.name for one in found)
        raise UsageError(f"{lobe}.function: expected ({expected}), as it is declared, found ({shown})")


def check_values(lobe: str, found: object, pairs: Pairs, channels: int) -> None:
    """Refuse what is not values `(..., N, C)`, or `(..., N, 1)` of parameters with one number for all C channels.

    Raises:
        ShapeError: it is of another shape, or no tensor.
    """
    is_values = isinstance(found, Tensor) and found.dim() > 1
    if is_values and found.shape[-2] == len(pairs) and found.shape[-1] in (1, channels):  # type: ignore[attr-defined]
        return
    shown = (*found.shape,) if isinstance(found, Tensor) else type(found).__name__
    raise ShapeError(f"{lobe}.function: expected values (..., {len(pairs)}, {channels}), found {shown}")


def check_leading(lobe: str, shapes: dict[str, tuple[int, ...]]) -> None:
    """Refuse leading dimensions, of parameters or pairs by name, that do not broadcast.

    Raises:
        ShapeError: they do not.
    """
    try:
        np.broadcast_shapes(*shapes.values())  # torch's own takes half a second to import what it needs
    except ValueError:
        shown = ", ".join(f"{name} {shape}" for name, shape in shapes.items() if shape)
        raise ShapeError(f"{lobe}: expected leading dimensions that broadcast, found {shown}") from None
