"""What a model is made of where derivatives are taken without a graph.

Such a model is a sum of colours times scalar functions, f_c = sum_k color_kc s_k. All derivatives then follow from a
few responses a pair, the s_k and their derivatives by the lobes' scalars, which all channels share.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names, get_parameters
from torchbrdf.pairs import Pairs


def is_linear_in_albedos(model: Lobe) -> bool:
    """Whether every component is a colour times a scalar function."""
    return all(component.albedo_spec() is not None for component in model.components())


class Basis:
    """The responses of the components that are present, and how they make up predictions and derivatives.

    They come in the order: derivatives by scalars that are free, s of the components whose colour is free, s of the
    others. The last two make up a prediction, the first two, `used`, derivatives.
    """

    def __init__(self, parametrization: Parametrization) -> None:
        model, self.free = parametrization.model, parametrization.free
        free_names = {one.name for one in self.free}
        names = component_names(model)
        lobes = []
        for k in parametrization.components:
            lobe = model.components()[k]
            color = lobe.albedo_spec()
            if color is None:
                raise UsageError(f"{type(lobe).__name__}: is no colour times a scalar function")
            lobes.append((k, lobe, names[k][color.name], [names[k][spec.name] for spec in lobe.scalars()]))
        self.lobes = sorted(lobes, key=lambda lobe: lobe[2] not in free_names)
        self.free_names = free_names
        self.slopes = [name for _, _, _, scalars in self.lobes for name in scalars if name in free_names]
        self.used = self.slopes + [color for _, _, color, _ in self.lobes if color in free_names]

    def albedos(self, values: ParameterDict, dtype: torch.dtype) -> Tensor:
        """The colour of each component, `(R, 3, components)`."""
        return torch.stack([values[color].to(dtype).expand(-1, 3) for _, _, color, _ in self.lobes], 2)

    def responses(self, pairs: Pairs, values: ParameterDict, dtype: torch.dtype) -> list[Tensor]:
        """All responses on some pairs, `(R|1, N)` each."""
        shapes: list[Tensor] = []
        slopes: list[Tensor] = []
        for _, lobe, _, names in self.lobes:
            scalars = [values[name].to(dtype) for name in names]
            if not names or any(name in self.free_names for name in names):
                shape, *tangents = type(lobe).value_and_jacobian(pairs, *scalars)
                slopes += [slope for slope, name in zip(tangents, names, strict=True) if name in self.free_names]
            else:
                shape = type(lobe).unit_response(pairs, *scalars)
            shapes.append(shape)
        return slopes + shapes

    def stacked(self, pairs: Pairs, values: ParameterDict, dtype: torch.dtype, problems: int) -> Tensor:
        """The same as one tensor, `(R, Q, N)`."""
        return torch.stack([one.expand(problems, -1) for one in self.responses(pairs, values, dtype)], 1)

    def predict(self, albedos: Tensor, responses: Tensor) -> Tensor:
        """Values of all components, `(R, 3, N)`, from stacked responses."""
        return torch.bmm(albedos, responses[:, len(self.slopes) :])

    def jacobian(self, values: ParameterDict, albedos: Tensor) -> Tensor:
        """How the used responses make up the derivative of each channel by each of P free numbers, `(R, 3, Q, P)`."""
        row = {name: i for i, name in enumerate(self.used)}
        order = {k: i for i, (k, _, _, _) in enumerate(self.lobes)}
        found = albedos.new_zeros(len(albedos), 3, len(row), sum(one.width for one in self.free))
        p = 0
        for one in self.free:
            if one.spec.linear:
                for channel in range(3):
                    found[:, channel, row[one.name], p + (channel if one.width == 3 else 0)] = 1
            else:
                rate = values[one.name].double() if one.spec.log else 1
                found[:, :, row[one.name], p] = albedos[:, :, order[one.component]] * rate
            p += one.width
        return found


def predictor(model: Lobe) -> Callable[[Pairs], Tensor]:
    """A function that gives a model's values on pairs, `(M, 3, N)`: channel by channel where that is faster."""
    if not is_linear_in_albedos(model):
        return lambda pairs: model(pairs).mT
    basis, values = Basis(Parametrization(model, [])), get_parameters(model)
    dtype = next(iter(values.values())).dtype
    albedos = basis.albedos(values, dtype)
    return lambda pairs: basis.predict(albedos, basis.stacked(pairs, values, dtype, len(albedos)))
