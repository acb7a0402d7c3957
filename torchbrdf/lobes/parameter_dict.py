"""The parameters of a model as a dictionary, by the names that the model's modules give them."""

import copy
from dataclasses import replace
from typing import TypeVar

from torch import Tensor

from torchbrdf.lobes.base import Lobe
from torchbrdf.lobes.parameter import BoundedParameter

AnyLobe = TypeVar("AnyLobe", bound=Lobe)

# Values for M materials, `(M, *shape)`, or `(M, 1)` where one number serves all channels, by the names that the model's
# `named_parameters` have, such as "lobes.1.roughness".
ParameterDict = dict[str, Tensor]


def component_names(model: Lobe) -> list[dict[str, str]]:
    """Of each component of a model the full names of its parameters, by their own."""
    prefixes = {id(module): name for name, module in model.named_modules()}
    found = []
    for component in model.components():
        prefix = prefixes[id(component)]
        found.append({name: f"{prefix}.{name}" if prefix else name for name in component.parameter_specs})
    return found


def named_specs(model: Lobe) -> dict[str, BoundedParameter]:
    """What a model declares of each parameter, by full name, component after component."""
    names = component_names(model)
    return {
        full: component.parameter_specs[name]
        for component, own in zip(model.components(), names, strict=True)
        for name, full in own.items()
    }


def shared_specs(model: Lobe) -> dict[str, tuple[BoundedParameter, tuple[str, ...]]]:
    """Of each shared parameter, by full name: what all that share it allow, and their full names.

    Its bounds are those that all have.
    """
    found: dict[str, tuple[BoundedParameter, tuple[str, ...]]] = {}
    names = component_names(model)
    for name in getattr(model, "shared", ()):
        own = [k for k, lobe in enumerate(model.components()) if not lobe.is_diffuse and name in names[k]]
        specs, same = [model.components()[k].parameter_specs[name] for k in own], tuple(names[k][name] for k in own)
        lower, upper = max(spec.lower for spec in specs), min(spec.upper for spec in specs)
        start = min(max(specs[0].start, lower), upper)
        spec = replace(specs[0], lower=lower, upper=upper, start=start)
        spec.name = name
        found |= dict.fromkeys(same, (spec, same))
    return found


def get_parameters(model: Lobe) -> ParameterDict:
    """The parameters of a model, detached."""
    own = dict(model.named_parameters())
    return {name: own[name].detach() for name in named_specs(model)}


def with_parameters(model: AnyLobe, values: ParameterDict) -> AnyLobe:
    """A copy of a model with these parameters, where a single number is spread over the channels."""
    made = copy.deepcopy(model)
    specs = named_specs(made)
    for name, parameter in made.named_parameters():
        value = values[name]
        parameter.data = value.expand(len(value), *specs[name].shape).to(parameter).clone()
    return made


def take_materials(values: ParameterDict, rows: Tensor | list[int] | slice) -> ParameterDict:
    """The parameters of some materials, by index."""
    return {name: value[rows] for name, value in values.items()}


def outside_bounds(model: Lobe) -> list[str]:
    """Which parameters are outside of their bounds by more than rounding, each in words."""
    found = []
    for component in model.components():
        for name, spec in component.parameter_specs.items():
            value = getattr(component, name).detach().flatten()
            slack = 1e-6 * max(abs(spec.lower), abs(spec.upper))
            low, high = spec.lower - min(slack, 1e-3 * abs(spec.lower)), spec.upper + slack
            outside = value[(value < low) | (value > high)].tolist()
            found += [f"{name} {outside[0]:g}, not {spec.lower:g} to {spec.upper:g}"] if outside else []
    return found


def canonical(model: Lobe, values: ParameterDict) -> ParameterDict:
    """The parameters of the same model that fits tell; those of lobes that share some of them stay as they are."""
    found, shared = dict(values), shared_specs(model)
    for component, names in zip(model.components(), component_names(model), strict=True):
        own = component.canonical({name: values[full] for name, full in names.items()})
        if not any(full in shared and own[name] is not values[full] for name, full in names.items()):
            found |= {full: own[name] for name, full in names.items()}
    return found
