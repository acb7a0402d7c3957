"""The squared error of many fits at once, with its gradient and the matrix of its normal equations.

Every analytic loss is a mean of penalty(encode(f) - encode(target)), and every lobe here is a colour times a scalar
function, so that f_c = sum_k color_kc s_k. All derivatives then follow from a few columns a pair, the s_k and their
derivatives by the lobes' scalars, which all channels share: no graph, a handful of passes over pairs that lie in the
processor's cache, and sums over pairs as matrix products.
"""

import torch
from torch import Tensor

from torchbrdf.fitting.data import Data
from torchbrdf.fitting.variables import Values, Variable, decode
from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss
from torchbrdf.pairs import Pairs


def applies(model: Lobe, loss: Loss) -> bool:
    """Whether the model and the loss have the form that is used here."""
    return all(part.color() is not None for part in model.parts()) and loss.analytic


class SquaredError:
    """The squared error of R problems, each a material of `data` with values of its own, as a function of `variables`.

    materials: `(R,)`, which material each problem is of. values: the held parameters of each problem. parts: those of
    the model that are present. scale: `(R,)`, the squared error that counts as 1. width: as `Loss.penalty_slope` takes
    it, `(R,)`.
    """

    def __init__(
        self,
        model: Lobe,
        data: Data,
        materials: Tensor,
        values: Values,
        variables: list[Variable],
        parts: list[int],
        scale: Tensor,
        width: Tensor | None = None,
    ) -> None:
        self.data, self.materials, self.values, self.variables = data, materials, values, variables
        self.scale, self.width = scale, width
        self.moved = {(variable.part, variable.bounded.name) for variable in variables}
        lobes = [(k, model.parts()[k], _color(model.parts()[k])) for k in parts]
        self.lobes = sorted(lobes, key=lambda lobe: (lobe[0], lobe[2]) not in self.moved)
        scalars = [(k, bounded.name) for k, lobe, _ in self.lobes for bounded in lobe.scalars()]
        # The columns: derivatives by scalars that move, s of lobes whose colour does, s of the others; these two are
        # what a prediction needs, the first two what derivatives do.
        self.slopes = [key for key in scalars if key in self.moved]
        self.used = self.slopes + [(k, color) for k, _, color in self.lobes if (k, color) in self.moved]

    def __call__(self, x: Tensor, rows: Tensor, curvature: bool = True) -> tuple[Tensor, Tensor, Tensor]:
        """Value `(m,)`, gradient `(m, P)` and Gauss-Newton matrix `(m, P, P)` of the problems `rows`, float64."""
        data, loss = self.data, self.data.loss
        dtype = data.target.dtype
        here = {key: value[rows] for key, value in self.values.items()} | decode(self.variables, x, dtype)
        materials = self.materials[rows]
        everyone = len(rows) == len(data) and torch.equal(materials, torch.arange(len(data), device=rows.device))
        colors = torch.stack([here[k, color].to(dtype).expand(-1, 3) for k, _, color in self.lobes], 2)
        width = None if self.width is None else self.width[rows, None, None].to(dtype)
        value = torch.zeros(len(rows), dtype=torch.float64, device=x.device)
        slopes = value.new_zeros(len(rows), 3, len(self.used))
        grams: Tensor | None = None
        for part, pairs in data.chunks(len(rows)):
            if pairs.shape[0] > 1 and not everyone:
                pairs = pairs.select(materials)
            basis = torch.stack([column.expand(len(rows), -1) for column in self._evaluate(pairs, here, dtype)], 1)
            prediction = torch.bmm(colors, basis[:, len(self.slopes) :])
            target, weight = data.part(part, None if everyone else materials)
            encoded, rate = loss.encode_slope(prediction.transpose(1, 2), pairs)
            rate = rate.transpose(-1, -2)
            penalty, slope, curve = loss.penalty_slope(encoded.transpose(1, 2) - target, width)
            if weight is not None:
                penalty, slope, curve = penalty * weight, slope * weight, curve * weight
            value += penalty.sum((1, 2)).double()
            basis = basis[:, : len(self.used)]
            slopes += torch.bmm(slope * rate, basis.transpose(1, 2)).double()
            if curvature:
                curve = (curve * rate.square()).expand(len(rows), -1, basis.shape[2])
                curved = (curve[:, :, None] * basis[:, None]).flatten(1, 2)
                gram = torch.bmm(curved, basis.transpose(1, 2)).double()
                grams = gram if grams is None else grams + gram
        norm = data.total.expand(len(data))[materials] * self.scale[rows]
        jacobian = self._jacobian(here, colors.double())
        gradient = torch.einsum("rcq,rcqp->rp", slopes, jacobian) / norm[:, None]
        if grams is None:
            return value / norm, gradient, gradient.new_empty(0)
        grams = grams.unflatten(1, (-1, grams.shape[2])).expand(-1, 3, -1, -1)
        matrix = torch.einsum("rcqp,rcqs->rps", jacobian, grams @ jacobian)
        return value / norm, gradient, matrix / norm[:, None, None]

    def _evaluate(self, pairs: Pairs, here: Values, dtype: torch.dtype) -> list[Tensor]:
        shapes: list[Tensor] = []
        slopes: list[Tensor] = []
        for k, lobe, _ in self.lobes:
            names = [bounded.name for bounded in lobe.scalars()]
            scalars = [here[k, name].to(dtype) for name in names]
            if not names or any((k, name) in self.moved for name in names):
                shape, *tangents = type(lobe).linearized(pairs, *scalars)
                slopes += [slope for slope, name in zip(tangents, names, strict=True) if (k, name) in self.moved]
            else:
                shape = type(lobe).white(pairs, *scalars)
            shapes.append(shape)
        return slopes + shapes

    def _jacobian(self, here: Values, colors: Tensor) -> Tensor:
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


def _color(lobe: Lobe) -> str:
    color = lobe.color()
    if color is None:
        raise ValueError(f"{type(lobe).__name__} is no colour times a scalar function")
    return color.name
