"""Derivatives of losses that give none themselves, by autograd; and whether a loss works on one value at a time."""

from collections.abc import Callable
from itertools import chain
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchbrdf.pairs import Pairs

if TYPE_CHECKING:
    from torchbrdf.losses.base import Loss


def derivative_of(function: Callable[[Tensor], Tensor], values: Tensor) -> tuple[Tensor, Tensor]:
    """A function of one value at a time, and its derivative by each of them."""
    with torch.enable_grad():
        point = values.detach().requires_grad_()
        encoded = function(point)
        (slope,) = torch.autograd.grad(encoded.sum(), point)
    return encoded.detach(), slope


def penalty_with_derivatives(loss: "Loss", difference: Tensor, width: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
    """`loss.penalty`, its derivative, and the curvature of a parabola near it.

    width: the penalty of sqrt(d^2 + width^2) in the place of that of d, smooth at 0. The curvature is that of the
    parabola with its least at 0 that touches the penalty, slope / d; it is nowhere below a penalty that grows less than
    the square does. Where a penalty grows more, its own second derivative is larger.
    """
    with torch.enable_grad():
        point = difference.detach().requires_grad_()
        penalty = loss.penalty(point if width is None else (point.square() + width.square()).sqrt())
        (slope,) = torch.autograd.grad(penalty.sum(), point, create_graph=True)
        second = torch.zeros_like(slope)
        if slope.requires_grad:
            (found,) = torch.autograd.grad(slope.sum(), point, allow_unused=True)
            second = second if found is None else found
    penalty, slope = penalty.detach(), slope.detach()
    tiny = torch.finfo(difference.dtype).tiny ** 0.5
    touching = slope / torch.where(difference.abs() < tiny, tiny, difference)
    return penalty, slope, torch.maximum(touching, second.detach().nan_to_num()).clamp_min(0)


def elementwise(loss: "Loss") -> bool:
    """Whether `encode` and `penalty` keep the shape, and change where one value does and nowhere else."""
    other = torch.zeros(1, dtype=torch.float32, device="cpu")
    like = next((x for x in chain(loss.parameters(), loss.buffers()) if x.is_floating_point()), other)
    wi = like.new_tensor([[0.6, 0.0, 0.8], [0.0, 0.28, 0.96], [-0.36, 0.48, 0.8]])
    pairs = Pairs.from_directions(wi, wi.flip(0))
    values = like.new_tensor([[0.1, 0.2, 0.3], [1.1, 1.2, 1.3], [2.1, 2.2, 2.3]])
    changed = values.clone()
    changed[1, 1] = 3.0
    others = values == changed
    with torch.no_grad():
        for one, other in (
            (loss.encode(values.clone(), pairs), loss.encode(changed.clone(), pairs)),
            (loss.penalty(values.clone()), loss.penalty(changed.clone())),
        ):
            if one.shape != values.shape or not torch.equal(one[others], other[others]):
                return False
    return True
