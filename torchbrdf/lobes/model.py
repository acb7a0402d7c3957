"""Models by name, and as plain numbers: what `fits.json` and the command line speak."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.lambert import Lambert
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.sum import Sum

DIFFUSE_KEY = "diffuse"
JOIN = "+"
# The bounds of all parameters are far below.
LARGEST_PARAMETER = 1e10


def component_kinds(name: str, lobes: int | None = None) -> list[type[Lobe]]:
    """The kinds of a model's components by its name, the diffuse term first.

    Args:
        name: a registered specular lobe, of which there are `lobes` beside Lambert; or all components, joined by +, of
            which one may be a diffuse term in Lambert's place.
        lobes: how many specular lobes; None: two of one kind, or those that are named.

    Returns:
        The kinds.

    Raises:
        UsageError: a name is unknown, there is no specular lobe or more than one diffuse term, or there are not so many
            lobes.

    Example:
        >>> [kind.__name__ for kind in component_kinds("ggx")]
        ['Lambert', 'GGX', 'GGX']
        >>> [kind.__name__ for kind in component_kinds("oren_nayar+ggx+ward")]
        ['OrenNayar', 'GGX', 'Ward']
    """
    kinds = [LOBES[part] for part in name.split(JOIN)]
    diffuse = [kind for kind in kinds if kind.is_diffuse] or [Lambert]
    specular = [kind for kind in kinds if not kind.is_diffuse]
    if not specular:
        raise UsageError(f"model: expected a specular lobe, found {name}, a diffuse term, which every model has")
    if len(diffuse) > 1:
        raise UsageError(f"model: expected one diffuse term, found {name}")
    if len(kinds) == 1:
        specular *= 2 if lobes is None else lobes
    if lobes is not None and (lobes < 1 or lobes != len(specular)):
        expected = "at least 1" if lobes < 1 else f"{len(specular)}, as {name} has"
        raise UsageError(f"lobes: expected {expected}, found {shown(lobes)}")
    return [*diffuse, *specular]


def make_model(name: str, lobes: int | None = None, dtype: torch.dtype | None = None) -> Sum:
    """Make a model to fit: a diffuse term plus lobes, each parameter at its start (the paper's eq. 11).

    Args:
        name: a registered lobe, our own or another package's, beside Lambert: "ggx"; or all components: "ggx+ward",
            "oren_nayar+ggx+ggx".
        lobes: how many specular lobes; None: two of one kind, or those that are named.
        dtype: of the parameters; torch's default if not given.

    Returns:
        The sum.

    Raises:
        UsageError: a name is unknown, or the components are none of a model, see `component_kinds`.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> make_model("ward", lobes=1).components()
        [Lambert(albedo=[0.5, 0.5, 0.5]), Ward(specular=[0.5, 0.5, 0.5], roughness=0.01)]
    """
    return Sum(*(kind(dtype=dtype) for kind in component_kinds(name, lobes)))


def model_name(model: Lobe) -> tuple[str, int]:
    """The name of a model and how many specular lobes it has: what `make_model` made it from.

    Args:
        model: a diffuse term plus registered lobes.

    Returns:
        The name and the count.

    Raises:
        UsageError: it is something else.

    Example:
        >>> from torchbrdf.lobes import make_model, model_name
        >>> model_name(make_model("ward", lobes=2)), model_name(make_model("ggx+ward"))
        (('ward', 2), ('ggx+ward', 2))
    """
    kinds = [type(component) for component in model.components()]
    first, *rest = kinds
    if not first.is_diffuse or not rest or any(kind.is_diffuse for kind in rest):
        found = " + ".join(kind.__name__ for kind in kinds)
        raise UsageError(f"model: expected a diffuse term plus lobes, found {found}")
    names = [LOBES.name_of(kind) for kind in kinds]
    for kind, name in zip(kinds, names, strict=True):
        if name is None:
            raise UsageError(f"model: expected lobes of a registered kind, found {kind.__name__}")
    named = names[1:] if first is Lambert else names
    same = first is Lambert and len({*rest}) == 1
    return (str(names[1]) if same else JOIN.join(map(str, named))), len(rest)


def parameters(model: Lobe, material: int = 0) -> dict[str, Any]:
    """One material's parameters as plain lists, as a `fits.json` has them.

    Args:
        model: a diffuse term plus lobes, batched or not.
        material: which of a batch.

    Returns:
        `diffuse`, the albedo of the diffuse term, and what else that has, as `diffuse_roughness`; for every other name
        a list with one value a lobe, None for a lobe of a kind that has no such parameter.

    Example:
        >>> from torchbrdf.lobes import Lambert, Sum, Ward, parameters
        >>> parameters(Sum(Lambert(albedo=0.25), Ward(specular=0.5, roughness=0.125)))
        {'diffuse': [0.25, 0.25, 0.25], 'specular': [[0.5, 0.5, 0.5]], 'roughness': [0.125]}
    """
    first, *rest = model.components()
    found: dict[str, Any] = {
        key: _plain(first, first.parameter_specs[name], material) for key, name in _diffuse_keys(type(first)).items()
    }
    for name in _names([type(component) for component in rest]):
        found[name] = [
            _plain(component, component.parameter_specs[name], material) if name in component.parameter_specs else None
            for component in rest
        ]
    return found


def from_parameters(name: str, values: Mapping[str, Any], dtype: torch.dtype | None = None) -> Sum:
    """Make the model that `parameters` describes. Values outside their bounds are kept as they are.

    Args:
        name: of the model, as `model_name` gives it.
        values: `diffuse` and, for each parameter of its lobes, a list with one value a lobe.
        dtype: of the parameters; torch's default if not given.

    Returns:
        The sum, not batched.

    Raises:
        DataError: the names, counts or shapes are not those of the model, or values are no finite numbers.

    Example:
        >>> from torchbrdf.lobes import from_parameters
        >>> values = {"diffuse": [0.3, 0.2, 0.1], "specular": [[0.5, 0.5, 0.5]], "roughness": [0.125]}
        >>> from_parameters("ward", values).components()[1]
        Ward(specular=[0.5, 0.5, 0.5], roughness=0.125)
    """
    diffuse, *kinds = component_kinds(name, None if JOIN in name else 1)
    where = f"parameters of {name}"
    keys, names = _diffuse_keys(diffuse), _names(kinds)
    wanted = {*keys, *names}
    optional = {name for kind in kinds for name, spec in kind.parameter_specs.items() if spec.optional}
    absent = optional - set(values)
    if set(values) != wanted - absent:
        raise DataError(f"{where}: expected {', '.join(sorted(wanted))}, found {', '.join(map(str, values)) or 'none'}")
    lists = {key: _one_a_lobe(values[key], f"{where}: {key}") for key in names if key not in absent}
    counts = {len(entries) for entries in lists.values()}
    kinds = kinds if JOIN in name else kinds * max(counts, default=0)
    if counts != {len(kinds)} or not kinds:
        expected = f"{len(kinds)} values" if JOIN in name else "one value a lobe for each"
        raise DataError(f"{where}: expected {expected}, found {sorted(counts)} values")
    for key in absent:
        specs = [kind.parameter_specs for kind in kinds]
        lists[key] = [own[key].start if key in own else None for own in specs]
    dtype = dtype or torch.get_default_dtype()
    base = {name: _numbers(values[key], diffuse.parameter_specs[name], f"{where}: {key}") for key, name in keys.items()}
    return Sum(
        diffuse(dtype=dtype, **base),
        *(
            kind(dtype=dtype, **_own_values(kind, {key: entries[k] for key, entries in lists.items()}, where))
            for k, kind in enumerate(kinds)
        ),
    )


def _diffuse_keys(kind: type[Lobe]) -> dict[str, str]:
    """The parameters of a diffuse term by their keys in a file."""
    return {DIFFUSE_KEY if name == "albedo" else f"{DIFFUSE_KEY}_{name}": name for name in kind.parameter_specs}


def _names(kinds: Sequence[type[Lobe]]) -> list[str]:
    """The parameters that any of these lobes has."""
    return list(dict.fromkeys(name for kind in kinds for name in kind.parameter_specs))


def _own_values(kind: type[Lobe], values: Mapping[str, Any], where: str) -> dict[str, Tensor]:
    """The parameters of a lobe among those of all, where the others are None."""
    for key, value in values.items():
        if value is not None and key not in kind.parameter_specs:
            raise DataError(f"{where}: {key}: expected null for {LOBES.name_of(kind)}, found {shown(value)}")
    return {name: _numbers(values[name], spec, f"{where}: {name}") for name, spec in kind.parameter_specs.items()}


def _one_a_lobe(values: Any, where: str) -> list[Any]:
    if not isinstance(values, list | tuple):
        raise DataError(f"{where}: expected a list with one value a lobe, found {shown(values)}")
    return list(values)


def _numbers(value: Any, spec: BoundedParameter, where: str) -> Tensor:
    """The numbers of a parameter, or one for all of them, as a tensor of its shape, float64."""
    shape = " x ".join(map(str, spec.shape))
    expected = f"{where}: expected {shape} numbers of at most {LARGEST_PARAMETER:g}, found {shown(value)}"
    if not _is_numbers(value, len(spec.shape)):
        raise DataError(expected)
    try:
        found = torch.tensor(value, dtype=torch.float64, device="cpu")
        if found.dim() > len(spec.shape):
            raise DataError(expected)
        found = found.expand(spec.shape)
    except (
        TypeError,
        ValueError,
        OverflowError,
        RuntimeError,
    ):  # ragged lists; whole numbers of many digits; another shape
        raise DataError(expected) from None
    if not bool((found.abs() <= LARGEST_PARAMETER).all()):
        raise DataError(expected)
    return found


def _is_numbers(value: Any, depth: int) -> bool:
    """Whether it is a number, or lists of nothing else, nested no deeper than that."""
    if isinstance(value, list | tuple):
        return depth > 0 and all(_is_numbers(one, depth - 1) for one in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _plain(component: Lobe, spec: BoundedParameter, material: int) -> Any:
    value: Tensor = getattr(component, spec.name).detach()
    if value.dim() > len(spec.shape):
        value = value[material]
    return value.item() if spec.size == 1 else value.tolist()
