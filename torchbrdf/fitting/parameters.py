"""The parameters of a model as the vector that a solver moves."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.func import functional_call

from torchbrdf.lobes import BoundedParameter, Lambert, Lobe, Sum
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names, shared_specs
from torchbrdf.pairs import Pairs


def diffuse_components(model: Lobe) -> list[int]:
    """Which components are diffuse."""
    return [k for k, lobe in enumerate(model.components()) if lobe.is_diffuse]


def specular_components(model: Lobe) -> list[int]:
    """Which are not."""
    return [k for k, lobe in enumerate(model.components()) if not lobe.is_diffuse]


def has_measurable_diffuse(model: Lobe) -> bool:
    """Whether the diffuse albedo can be measured and held: that of Lambert, in no whole material, or of none."""
    parts = model.components()
    return not any(part.is_material or (part.is_diffuse and not isinstance(part, Lambert)) for part in parts)


@dataclass(frozen=True)
class FreeParameter:
    """A parameter that a solver moves: its full name, its component, what it declares, and how many numbers it moves.

    A width of 1 moves a colour as one number. also: the full names of the others that always have the same value.
    """

    name: str
    component: int
    spec: BoundedParameter
    width: int
    also: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The full names of all that it moves."""
        return (self.name, *self.also)

    def encode(self, values: ParameterDict) -> Tensor:
        """Its values as the solver sees them, `(M, width)`, float64; the mean of those that are to be one."""
        value = values[self.name].to(torch.float64).flatten(1)
        if self.also:
            value = torch.stack([values[name].to(torch.float64).flatten(1) for name in self.names]).mean(0)
        if self.width == 1 and value.shape[1] > 1:
            value = value.mean(1, keepdim=True)
        return self._scaled(value.expand(-1, self.width).clamp(self.spec.lower, self.spec.upper))

    def shaped(self, value: Tensor) -> Tensor:
        """Numbers `(M, width)` as the parameter, `(M, *shape)` or `(M, 1)`."""
        return value if self.width != self.spec.size else value.reshape(-1, *self.spec.shape)

    def limits(self) -> tuple[Tensor, Tensor]:
        """Lower and upper bounds as the solver sees them, `(width,)`."""
        both = torch.tensor([[self.spec.lower], [self.spec.upper]], dtype=torch.float64, device="cpu")
        lower, upper = self._scaled(both.expand(-1, self.width))
        return lower, upper

    def _scaled(self, value: Tensor) -> Tensor:
        return value.log() if self.spec.log else value


def free_parameters(model: Lobe, components: Sequence[int], *, scalar_albedo: bool = False) -> list[FreeParameter]:
    """All parameters of some components, shared ones once; scalar_albedo: with one number for each colour's three."""
    lobes, names, shared, seen = model.components(), component_names(model), shared_specs(model), set[str]()
    found = []
    for k in components:
        colours = {spec.name for spec in colour_specs(type(lobes[k]))} if scalar_albedo else set()
        for name, full in names[k].items():
            spec, same = shared.get(full, (lobes[k].parameter_specs[name], (full,)))
            if full not in seen:
                also = tuple(other for other in same if other != full)
                found.append(FreeParameter(full, k, spec, 1 if name in colours else spec.size, also))
                seen |= {full, *also}
    return found


def colour_specs(kind: type[Lobe]) -> list[BoundedParameter]:
    """A lobe's colours: its albedos; of a lobe of several coloured terms, all parameters with a number a channel."""
    colours = [spec for spec in kind.parameter_specs.values() if spec.is_colour]
    return [spec for spec in colours if spec.linear or kind.has_terms()]


class Parametrization:
    """Which parameters of a model a solver moves, as a vector of P numbers; the others are held.

    Args:
        model: what they are of.
        free: what is moved, in the order of the vector.
        components: those of the model that are present; None: all.
    """

    def __init__(self, model: Lobe, free: Sequence[FreeParameter], components: Sequence[int] | None = None) -> None:
        self.model, self.free = model, list(free)
        self.components = list(range(len(model.components()))) if components is None else list(components)

    def encode(self, values: ParameterDict) -> Tensor:
        """The vector of each material, `(M, P)`, float64."""
        return torch.cat([one.encode(values) for one in self.free], 1)

    def decode(self, x: Tensor, dtype: torch.dtype) -> ParameterDict:
        """The free parameters of vectors `(M, P)`."""
        is_log = self._is_log.to(x.device)
        values = torch.where(is_log, torch.where(is_log, x, 0).exp(), x).to(dtype)
        found = zip(self.free, values.split([one.width for one in self.free], 1), strict=True)
        return {name: value for one, part in found for value in [one.shaped(part)] for name in one.names}

    @cached_property
    def _is_log(self) -> Tensor:
        """Whether a number is a logarithm, `(P,)`."""
        found = [one.spec.log for one in self.free for _ in range(one.width)]
        return torch.tensor(found, dtype=torch.bool, device="cpu")

    def limits(self) -> tuple[Tensor, Tensor]:
        """Lower and upper bounds of the vector, `(P,)` each."""
        both = [one.limits() for one in self.free]
        return torch.cat([low for low, _ in both]), torch.cat([high for _, high in both])

    def predict(self, values: ParameterDict, pairs: Pairs) -> Tensor:
        """What the present components add up to, `(M, N, C)`, or `(M, N, 1)` where all are one number for all."""
        own = {short: values[full] for short, full in self._own_names.items()}
        found: Tensor = functional_call(self._present, own, (pairs,))
        return found

    @cached_property
    def _present(self) -> Sum:
        lobes = self.model.components()
        return Sum(*(lobes[k] for k in self.components))

    @cached_property
    def _own_names(self) -> dict[str, str]:
        """Full names by those in the sum of the present components."""
        names = component_names(self.model)
        there = component_names(self._present)
        return {
            short: names[k][name] for k, own in zip(self.components, there, strict=True) for name, short in own.items()
        }
