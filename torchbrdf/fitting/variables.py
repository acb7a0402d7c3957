"""Which parameters of a model a solver moves, and how their values are packed into a vector."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.lobes import BoundedParameter, Lobe
from torchbrdf.pairs import Pairs

# A parameter's values for M materials, by part and name: (M, *shape), or (M, 1) where one number serves all channels.
Values = dict[tuple[int, str], Tensor]


def values_of(model: Lobe) -> Values:
    """The parameters of a batched model, detached."""
    return {
        (k, name): getattr(part, name).detach()
        for k, part in enumerate(model.components())
        for name in part.parameter_specs
    }


def put_values(model: Lobe, values: Values) -> None:
    """Write values back into a batched model, spreading a single number over the channels."""
    for (k, name), value in values.items():
        parameter = getattr(model.components()[k], name)
        parameter.data = value.expand_as(parameter).to(parameter).clone()


def evaluate(model: Lobe, values: Values, pairs: Pairs, parts: list[int]) -> Tensor:
    """The sum of some of the model's parts with these values, `(M, N, 3)` (or 1 channel, if all have only one)."""
    total: Tensor | None = None
    for k in parts:
        part = model.components()[k]
        part_values = type(part).function(pairs, *(values[k, name] for name in part.parameter_specs))
        total = part_values if total is None else total + part_values
    if total is None:
        raise ValueError("evaluate: no parts")
    return total


@dataclass(frozen=True)
class Variable:
    """A parameter that the solver moves: of which part, and with how many numbers a material."""

    part: int
    bounded: BoundedParameter
    width: int

    def encode(self, values: Values) -> Tensor:
        """Its values as the solver sees them, `(M, width)`, float64."""
        value = values[self.part, self.bounded.name].to(torch.float64).flatten(1)
        if self.width == 1 and value.shape[1] > 1:
            value = value.mean(1, keepdim=True)
        return self._scale(value.expand(-1, self.width).clamp(self.bounded.lower, self.bounded.upper))

    def decode(self, x: Tensor, dtype: torch.dtype) -> Tensor:
        """From the solver's numbers to the parameter, `(M, *shape)` or `(M, 1)`."""
        value = (x.exp() if self.bounded.log else x).to(dtype)
        return value if self.width != self.bounded.size else value.reshape(-1, *self.bounded.shape)

    def limits(self) -> tuple[Tensor, Tensor]:
        """Lower and upper bounds as the solver sees them."""
        both = torch.tensor([[self.bounded.lower], [self.bounded.upper]], dtype=torch.float64).expand(-1, self.width)
        lower, upper = self._scale(both)
        return lower, upper

    def _scale(self, value: Tensor) -> Tensor:
        return value.log() if self.bounded.log else value


def encode(variables: list[Variable], values: Values) -> Tensor:
    """All variables beside each other, `(M, P)`, float64."""
    return torch.cat([variable.encode(values) for variable in variables], 1)


def decode(variables: list[Variable], x: Tensor, dtype: torch.dtype) -> Values:
    """The values of the variables in `x`, `(M, P)`."""
    widths = [variable.width for variable in variables]
    return {
        (variable.part, variable.bounded.name): variable.decode(part, dtype)
        for variable, part in zip(variables, x.split(widths, 1), strict=True)
    }


def limits(variables: list[Variable]) -> tuple[Tensor, Tensor]:
    """Lower and upper bounds of all variables, `(P,)` each."""
    both = [variable.limits() for variable in variables]
    return torch.cat([low for low, _ in both]), torch.cat([high for _, high in both])
