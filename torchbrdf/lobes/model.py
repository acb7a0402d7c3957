"""Models by name, and as plain numbers: what `fits.json` and the command line speak."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.lambert import Lambert
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.sum import Sum

DIFFUSE_KEY = "diffuse"
# The bounds of all parameters are far below.
LARGEST_PARAMETER = 1e10


def make_model(name: str, lobes: int = 2, dtype: torch.dtype | None = None) -> Sum:
    """Make a model to fit: Lambert plus lobes of a registered kind, each parameter at its start (the paper's eq. 11).

    Args:
        name: a registered lobe, our own or another package's.
        lobes: how many of it.
        dtype: of the parameters; torch's default if not given.

    Returns:
        The sum.

    Raises:
        UsageError: the name is unknown or that of Lambert, or there are no lobes.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> make_model("ward", lobes=1).components()
        [Lambert(albedo=[0.5, 0.5, 0.5]), Ward(specular=[0.5, 0.5, 0.5], roughness=0.01)]
    """
    if lobes < 1:
        raise UsageError(f"lobes: expected at least 1, found {shown(lobes)}")
    kind = LOBES[name]
    if kind is Lambert:
        raise UsageError("model: expected a specular lobe, found lambert, which every model has")
    return Sum(Lambert(dtype=dtype), *(kind(dtype=dtype) for _ in range(lobes)))


def model_name(model: Lobe) -> tuple[str, int]:
    """The registered name of a model's specular lobes and how many it has: what `make_model` made it from.

    Args:
        model: Lambert plus lobes of one registered kind.

    Returns:
        The name and the count.

    Raises:
        UsageError: it is something else.

    Example:
        >>> from torchbrdf.lobes import make_model, model_name
        >>> model_name(make_model("ward", lobes=2))
        ('ward', 2)
    """
    first, *rest = model.components()
    kinds = {type(component) for component in rest}
    if not isinstance(first, Lambert) or len(kinds) != 1:
        shown = " + ".join(type(component).__name__ for component in model.components())
        raise UsageError(f"model: expected Lambert plus lobes of one kind, found {shown}")
    kind = kinds.pop()
    name = LOBES.name_of(kind)
    if name is None:
        raise UsageError(f"model: expected lobes of a registered kind, found {kind.__name__}")
    return name, len(rest)


def parameters(model: Lobe, material: int = 0) -> dict[str, Any]:
    """One material's parameters as plain lists, as a `fits.json` has them.

    Args:
        model: Lambert plus lobes of one kind, batched or not.
        material: which of a batch.

    Returns:
        `diffuse`, and for every other name a list with one value a lobe.

    Example:
        >>> from torchbrdf.lobes import Lambert, Sum, Ward, parameters
        >>> parameters(Sum(Lambert(albedo=0.25), Ward(specular=0.5, roughness=0.125)))
        {'diffuse': [0.25, 0.25, 0.25], 'specular': [[0.5, 0.5, 0.5]], 'roughness': [0.125]}
    """
    first, *rest = model.components()
    found: dict[str, Any] = {DIFFUSE_KEY: _plain(first, first.parameter_specs["albedo"], material)}
    for name, spec in type(rest[0]).parameter_specs.items():
        found[name] = [_plain(component, spec, material) for component in rest]
    return found


def from_parameters(name: str, values: Mapping[str, Any], dtype: torch.dtype | None = None) -> Sum:
    """Make the model that `parameters` describes. Values outside their bounds are kept as they are.

    Args:
        name: the registered kind of its specular lobes.
        values: `diffuse` and, for each parameter of that kind, a list with one value a lobe.
        dtype: of the parameters; torch's default if not given.

    Returns:
        The sum, not batched.

    Raises:
        DataError: the names, counts or shapes are not those of the kind, or values are no finite numbers.

    Example:
        >>> from torchbrdf.lobes import from_parameters
        >>> values = {"diffuse": [0.3, 0.2, 0.1], "specular": [[0.5, 0.5, 0.5]], "roughness": [0.125]}
        >>> from_parameters("ward", values).components()[1]
        Ward(specular=[0.5, 0.5, 0.5], roughness=0.125)
    """
    kind = LOBES[name]
    where = f"parameters of {name}"
    wanted = {DIFFUSE_KEY, *kind.parameter_specs}
    if set(values) != wanted:
        raise DataError(f"{where}: expected {', '.join(sorted(wanted))}, found {', '.join(map(str, values)) or 'none'}")
    diffuse = _numbers(values[DIFFUSE_KEY], Lambert.parameter_specs["albedo"], f"{where}: {DIFFUSE_KEY}")
    lists = {key: _one_a_lobe(values[key], spec, f"{where}: {key}") for key, spec in kind.parameter_specs.items()}
    counts = {len(entries) for entries in lists.values()}
    if len(counts) != 1 or counts == {0}:
        raise DataError(f"{where}: expected one value a lobe for each, found {sorted(counts)} values")
    dtype = dtype or torch.get_default_dtype()
    lobes = [
        kind(dtype=dtype, **dict(zip(lists, entries, strict=True))) for entries in zip(*lists.values(), strict=True)
    ]
    return Sum(Lambert(albedo=diffuse, dtype=dtype), *lobes)


def _one_a_lobe(values: Any, spec: BoundedParameter, where: str) -> list[Tensor]:
    if not isinstance(values, list | tuple):
        raise DataError(f"{where}: expected a list with one value a lobe, found {shown(values)}")
    return [_numbers(value, spec, where) for value in values]


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
