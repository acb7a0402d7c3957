"""What a model is made of where derivatives are taken without a graph.

Every lobe here is a colour times a scalar function, so that f_c = sum_k color_kc s_k. All derivatives then follow from
a few columns a pair, the s_k and their derivatives by the lobes' scalars, which all channels share.
"""

from typing import Any

import torch
from torch import Tensor

from torchbrdf.fitting.variables import Values, Variable, decode
from torchbrdf.lobes import Lobe
from torchbrdf.losses import GroupedLoss, Loss, ObservedLoss
from torchbrdf.pairs import Pairs


def applies(model: Lobe, loss: Loss) -> bool:
    """Whether the model and the loss have the form that is used here."""
    known = loss.analytic or isinstance(loss, GroupedLoss | ObservedLoss)
    return all(part.albedo_spec() is not None for part in model.components()) and known


class Columns:
    """The columns of some parts of a model, and how they make up the derivatives by `variables`; the rest is held."""

    def __init__(self, model: Lobe, values: Values, variables: list[Variable], parts: list[int]) -> None:
        self.values, self.variables = values, variables
        self.moved = {(variable.part, variable.bounded.name) for variable in variables}
        lobes = [(k, model.components()[k], _color(model.components()[k])) for k in parts]
        self.lobes = sorted(lobes, key=lambda lobe: (lobe[0], lobe[2]) not in self.moved)
        scalars = [(k, bounded.name) for k, lobe, _ in self.lobes for bounded in lobe.scalars()]
        # The columns: derivatives by scalars that move, s of lobes whose colour does, s of the others; these two are
        # what a prediction needs, the first two what derivatives do.
        self.slopes = [key for key in scalars if key in self.moved]
        self.used = self.slopes + [(k, color) for k, _, color in self.lobes if (k, color) in self.moved]

    def at(self, x: Tensor, rows: Tensor, dtype: torch.dtype) -> Values:
        """All parameters of the problems `rows` where the variables are at x."""
        return {key: value[rows] for key, value in self.values.items()} | decode(self.variables, x, dtype)

    def colors(self, here: Values, dtype: torch.dtype) -> Tensor:
        """The colour of each lobe, `(R, 3, lobes)`."""
        return torch.stack([here[k, color].to(dtype).expand(-1, 3) for k, _, color in self.lobes], 2)

    def evaluate(self, pairs: Pairs, here: Values, dtype: torch.dtype) -> list[Tensor]:
        """The columns: derivatives by scalars that move, then s of every lobe, `(R|1, N)` each."""
        shapes: list[Tensor] = []
        slopes: list[Tensor] = []
        for k, lobe, _ in self.lobes:
            names = [bounded.name for bounded in lobe.scalars()]
            scalars = [here[k, name].to(dtype) for name in names]
            if not names or any((k, name) in self.moved for name in names):
                shape, *tangents = type(lobe).value_and_jacobian(pairs, *scalars)
                slopes += [slope for slope, name in zip(tangents, names, strict=True) if (k, name) in self.moved]
            else:
                shape = type(lobe).unit_response(pairs, *scalars)
            shapes.append(shape)
        return slopes + shapes

    def jacobian(self, here: Values, colors: Tensor) -> Tensor:
        """How the used columns make up the derivative of each channel by each variable, `(R, 3, Q, P)`."""
        widths = [variable.width for variable in self.variables]
        row = {key: i for i, key in enumerate(self.used)}
        order = {k: i for i, (k, _, _) in enumerate(self.lobes)}
        found = colors.new_zeros(len(colors), 3, len(row), sum(widths))
        p = 0
        for variable, width in zip(self.variables, widths, strict=True):
            key = (variable.part, variable.bounded.name)
            if variable.bounded.linear:
                for channel in range(3):
                    found[:, channel, row[key], p + (channel if width == 3 else 0)] = 1
            else:
                rate = here[key].double() if variable.bounded.log else 1
                found[:, :, row[key], p] = colors[:, :, order[variable.part]] * rate
            p += width
        return found


class ErrorOfFits:
    """What the errors of R problems are made of: each a material of `data` with values of its own.

    materials: `(R,)`, which material each problem is of. values: the held parameters of each problem. parts: those of
    the model that are present. scale: `(R,)`, the squared error that counts as 1. width: `(R,)`, over which a cusp is
    rounded.
    """

    def __init__(
        self,
        model: Lobe,
        data: Any,
        materials: Tensor,
        values: Values,
        variables: list[Variable],
        parts: list[int],
        scale: Tensor,
        width: Tensor | None = None,
    ) -> None:
        self.data, self.materials, self.scale, self.width = data, materials, scale, width
        self.columns = Columns(model, values, variables, parts)


def _color(lobe: Lobe) -> str:
    color = lobe.albedo_spec()
    if color is None:
        raise ValueError(f"{type(lobe).__name__} is no colour times a scalar function")
    return color.name
