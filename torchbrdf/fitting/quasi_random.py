"""Starts all over the bounds of a model's parameters, for models of any lobes."""

import torch
from torch.quasirandom import SobolEngine

from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.lobes.parameter_dict import ParameterDict


def quasi_random_starts(free: Parametrization, values: ParameterDict, count: int) -> ParameterDict:
    """Starts spread evenly over the bounds, on the scale of the solver; the same in every run.

    All channels of a parameter start alike: they are of one material, and where channels have shapes of their own, one
    at random seldom suits all three.

    Args:
        free: what is moved.
        values: the parameters of each of M materials, of which those that are not moved are kept.
        count: starts of each material, all with the same points.

    Returns:
        Starts after starts, `(count * M, ...)`.

    Example:
        >>> from torchbrdf.fitting.parameters import free_parameters
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.lobes.parameter_dict import get_parameters
        >>> model = make_model("ward", 1).batched(2)
        >>> free = Parametrization(model, free_parameters(model, [0, 1]))
        >>> quasi_random_starts(free, get_parameters(model), 8)["lobes.1.roughness"].shape
        torch.Size([16, 1])
    """
    materials, like = len(next(iter(values.values()))), next(iter(values.values()))
    lower, upper = free.limits()
    engine = SobolEngine(len(free.free), scramble=True, seed=0)
    first = engine.quasi.to(torch.float32) / 2**engine.MAXBIT  # which the engine rounds to torch's default dtype
    unit = engine.draw(count, dtype=torch.float64)
    unit[:1] = first
    unit = torch.cat([unit[:, k : k + 1].expand(-1, one.width) for k, one in enumerate(free.free)], 1)
    points = (lower + unit * (upper - lower)).to(like.device).repeat_interleave(materials, 0)
    every = {name: value.repeat(count, *[1] * (value.dim() - 1)) for name, value in values.items()}
    return every | free.decode(points, like.dtype)
