"""Derivatives of lobes that are coefficients times terms, f_c = sum_j A_cj s_j, by forward differentiation."""

import math
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torchbrdf.pairs import Pairs

if TYPE_CHECKING:
    from torchbrdf.lobes.base import Lobe
    from torchbrdf.lobes.parameter import BoundedParameter

# torch's forward differentiation has one level for all threads.
_FORWARD = threading.Lock()

Slopes = list[list[Tensor | None]]
"""For each scalar the derivatives of all terms; None for a term that does not know the scalar."""


def tangents(function: Callable[..., Sequence[Tensor]], scalars: Sequence[Tensor]) -> tuple[list[Tensor], Slopes]:
    """Values of a function of scalars, and their derivatives by each.

    Args:
        function: of the scalars; gives one or more tensors.
        scalars: `(..., 1)` each.

    Returns:
        The values; and for each scalar the derivative of each value, None of one that does not depend on it.

    Example:
        >>> import torch
        >>> tangents(lambda a, b: [a * b, b], [torch.tensor([2.0]), torch.tensor([3.0])])
        ([tensor([6.]), tensor([3.])], [[tensor([3.]), None], [tensor([2.]), tensor([1.])]])
    """
    values: list[Tensor] = []
    slopes: Slopes = []
    for k, scalar in enumerate(scalars):
        with _FORWARD, forward_ad.dual_level():
            dual = forward_ad.make_dual(scalar.contiguous(), torch.ones_like(scalar.contiguous()))
            found = [
                forward_ad.unpack_dual(one)
                for one in function(*(dual if i == k else other for i, other in enumerate(scalars)))
            ]
            values = values or [one.primal for one in found]
            slopes.append([one.tangent for one in found])
    return values or list(function()), slopes


def coefficient_slopes(kind: "type[Lobe]", parameters: dict[str, Tensor]) -> dict[str, Tensor]:
    """How a lobe's coefficients change with its parameters.

    Args:
        kind: of lobe.
        parameters: all of them by name, `(R, size)` each.

    Returns:
        By name the derivatives `(R, C, J, size)`; none for a parameter that the coefficients do not know.

    Example:
        >>> import torch
        >>> from torchbrdf.lobes import Ward
        >>> values = {"specular": torch.rand(4, 3), "roughness": torch.rand(4, 1)}
        >>> {name: slope.shape for name, slope in coefficient_slopes(Ward, values).items()}
        {'specular': torch.Size([4, 3, 1, 3])}
    """
    # One pass back for all: a copy of the parameters for each coefficient, which takes its derivatives.
    shape = (kind.channels, pattern(kind).terms)
    rows, copies = len(next(iter(parameters.values()))), math.prod(shape)
    with torch.inference_mode(False), torch.enable_grad():
        own = {
            name: value.detach().clone().expand(copies, -1, -1).clone().requires_grad_()
            for name, value in parameters.items()
        }
        every = kind.coefficients(**own).expand(copies, rows, *shape).flatten(2)
        wanted = [own[name] for name in pattern(kind).parameters]
        found = torch.autograd.grad(every.diagonal(dim1=0, dim2=2).sum(), wanted, materialize_grads=True)
    slopes = (one.reshape(*shape, rows, -1).movedim(2, 0) for one in found)
    return dict(zip(pattern(kind).parameters, slopes, strict=True))


def columns(*coefficients: Tensor) -> Tensor:
    """Coefficients of terms side by side.

    Args:
        coefficients: of each of J terms, `(..., C)`, or `(..., 1)` where all channels have the same; leading
            dimensions broadcast.

    Returns:
        `(..., C, J)`.

    Example:
        >>> import torch
        >>> columns(torch.rand(4, 3), torch.rand(4, 1)).shape
        torch.Size([4, 3, 2])
    """
    return torch.stack(torch.broadcast_tensors(*coefficients), -1)


class Pattern(NamedTuple):
    """What depends on what in a kind of lobe.

    terms: how many; slopes: for each scalar of the terms which of them know it; parameters: that coefficients know.
    """

    terms: int
    slopes: tuple[tuple[int, ...], ...]
    parameters: tuple[str, ...]


_PATTERNS: WeakKeyDictionary["type[Lobe]", Pattern] = WeakKeyDictionary()


def pattern(kind: "type[Lobe]") -> Pattern:
    """What depends on what, as one evaluation at the start of a fit shows."""
    if kind not in _PATTERNS:
        angle = torch.full((1, 1), 0.3, dtype=torch.float64, device="cpu")
        starts = {name: _start(spec) for name, spec in kind.parameter_specs.items()}
        scalars = [starts[spec.name] for spec in kind.term_scalars()]
        values, slopes = kind.terms_and_jacobian(Pairs.from_half_diff(angle, angle, angle, angle), *scalars)
        known = tuple(tuple(j for j, one in enumerate(own) if one is not None) for own in slopes)
        with torch.inference_mode(False), torch.enable_grad():
            own = [start.clone().requires_grad_() for start in starts.values()]
            total = kind.coefficients(**dict(zip(starts, own, strict=True))).sum()
            changes = torch.autograd.grad(total, own, allow_unused=True)
        parameters = tuple(name for name, one in zip(starts, changes, strict=True) if one is not None)
        _PATTERNS[kind] = Pattern(len(values), known, parameters)
    return _PATTERNS[kind]


def _start(spec: "BoundedParameter") -> Tensor:
    return torch.full((1, *spec.shape), spec.start, dtype=torch.float64, device="cpu")


def value_of(kind: "type[Lobe]") -> Callable[..., Tensor]:
    """The function of pairs and parameters that a lobe's terms and coefficients make up, `(..., N, C)`."""

    def function(pairs: Pairs, *parameters: Tensor) -> Tensor:
        named = dict(zip(kind.parameter_specs, parameters, strict=True))
        terms = kind.terms(pairs, *(named[spec.name] for spec in kind.term_scalars()))
        coefficients = kind.coefficients(**named)[..., None, :, :]
        found: Tensor | float = 0.0
        for j, term in enumerate(terms):
            found = found + coefficients[..., j] * term[..., None]
        return torch.where(pairs.above_horizon[..., None], found, 0)

    return function
