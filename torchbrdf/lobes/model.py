"""Models by name, and as plain numbers: what `fits.json` and the command line speak."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError
from torchbrdf.lobes.base import LOBES, BoundedParameter, Lobe
from torchbrdf.lobes.lambert import Lambert
from torchbrdf.lobes.sum import Sum

DIFFUSE = "diffuse"


def make_model(name: str, lobes: int = 2, dtype: torch.dtype | None = None) -> Sum:
    """Lambert plus so many lobes of a registered kind, each parameter at its declared start (the paper's eq. 11)."""
    if lobes < 1:
        raise UsageError(f"lobes: expected at least 1, found {lobes}")
    kind = LOBES[name]
    if kind is Lambert:
        raise UsageError("model: expected a specular lobe, found lambert, which every model has")
    return Sum(Lambert(dtype=dtype), *(kind(dtype=dtype) for _ in range(lobes)))


def model_name(model: Lobe) -> tuple[str, int]:
    """The registered name of a model's specular lobes, and how many it has: what `make_model` made it from."""
    first, *rest = model.components()
    kinds = {type(part) for part in rest}
    if not isinstance(first, Lambert) or len(kinds) != 1:
        shown = " + ".join(type(part).__name__ for part in model.components())
        raise UsageError(f"model: expected Lambert plus lobes of one kind, found {shown}")
    kind = kinds.pop()
    return next(name for name, lobe in LOBES.items() if lobe is kind), len(rest)


def parameters(model: Lobe, material: int = 0) -> dict[str, Any]:
    """One material's parameters as plain lists: `diffuse`, and for every other name one value a lobe."""
    first, *rest = model.components()
    found: dict[str, Any] = {DIFFUSE: _plain(first, first.parameter_specs["albedo"], material)}
    for name, bounded in type(rest[0]).parameter_specs.items():
        found[name] = [_plain(part, bounded, material) for part in rest]
    return found


def from_parameters(name: str, values: Mapping[str, Any], dtype: torch.dtype | None = None) -> Sum:
    """The model that `parameters` describes, not batched. Values outside their bounds are kept as they are."""
    kind = LOBES[name]
    wanted = {DIFFUSE, *kind.parameter_specs}
    if set(values) != wanted:
        raise DataError(
            f"parameters of {name}: expected {', '.join(sorted(wanted))}, found {', '.join(sorted(values))}"
        )
    try:
        lists = {
            key: [torch.tensor(value, dtype=torch.float64) for value in values[key]] for key in kind.parameter_specs
        }
        diffuse = torch.tensor(values[DIFFUSE], dtype=torch.float64)
    except (TypeError, ValueError) as error:
        raise DataError(f"parameters of {name}: expected numbers, found something else ({error})") from None
    counts = {len(entries) for entries in lists.values()}
    if len(counts) != 1 or counts == {0}:
        raise DataError(f"parameters of {name}: expected one value a lobe for each, found {sorted(counts)} values")
    dtype = dtype or torch.get_default_dtype()
    lobes = [
        kind(dtype=dtype, **dict(zip(lists, entries, strict=True))) for entries in zip(*lists.values(), strict=True)
    ]
    return Sum(Lambert(albedo=diffuse, dtype=dtype), *lobes)


def _plain(part: Lobe, bounded: BoundedParameter, material: int) -> Any:
    value: Tensor = getattr(part, bounded.name).detach()
    if value.dim() > len(bounded.shape):
        value = value[material]
    return value.item() if bounded.size == 1 else value.tolist()
