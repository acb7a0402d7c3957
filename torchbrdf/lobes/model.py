"""Models by name, and as plain numbers: what `fits.json` and the command line speak."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.kinds import JOIN as JOIN
from torchbrdf.kinds import SHARE as SHARE
from torchbrdf.lobes.base import LOBES, RGB, Lobe
from torchbrdf.lobes.in_bands import in_bands
from torchbrdf.lobes.lambert import Lambert
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.sum import Sum, check_shared

DIFFUSE_KEY = "diffuse"
# The bounds of all parameters are far below.
LARGEST_PARAMETER = 1e10


def component_kinds(name: str, lobes: int | None = None) -> list[type[Lobe]]:
    """The kinds of a model's components by its name, the diffuse term first.

    Args:
        name: a registered specular lobe, of which there are `lobes` beside Lambert; or all components, joined by +, of
            which one may be a diffuse term in Lambert's place; or a whole material, which stands alone. Behind a colon
            the parameters that lobes share, see `make_model`.
        lobes: how many specular lobes; None: two of one kind, or those that are named.

    Returns:
        The kinds.

    Raises:
        UsageError: a name is unknown, there is no specular lobe or more than one diffuse term, or there are not so many
            lobes; a whole material is not alone; lobes do not share what they are said to.

    Example:
        >>> [kind.__name__ for kind in component_kinds("ggx")]
        ['Lambert', 'GGX', 'GGX']
        >>> [kind.__name__ for kind in component_kinds("oren_nayar+ggx+ward")]
        ['OrenNayar', 'GGX', 'Ward']
    """
    joined, shared = split_shared(name)
    kinds = [LOBES[part] for part in joined.split(JOIN)]
    if any(kind.is_material for kind in kinds):
        found = _material(kinds, joined, lobes)
    else:
        found = _diffuse_and_lobes(kinds, joined, lobes)
    check_shared(found, shared)
    return found


def _material(kinds: list[type[Lobe]], name: str, lobes: int | None) -> list[type[Lobe]]:
    """A whole material, which is a model by itself."""
    if len(kinds) > 1:
        whole = next(LOBES.name_of(kind) for kind in kinds if kind.is_material)
        raise UsageError(f"model: expected {whole}, a whole material, alone, found {name}")
    if lobes not in (None, 1):
        raise UsageError(f"lobes: expected 1, as {name} is a whole material, found {shown(lobes)}")
    return kinds


def _diffuse_and_lobes(kinds: list[type[Lobe]], name: str, lobes: int | None) -> list[type[Lobe]]:
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


def lobe_count(name: str, wanted: int) -> int:
    """How many specular lobes a model has where so many are wanted of each that leaves it open.

    Args:
        name: of the model; a whole material counts as 1, and a name of several components says it itself.
        wanted: of a model that is named after one kind of lobe.

    Raises:
        UsageError: it is no model's name, or there cannot be so many.

    Example:
        >>> lobe_count("ward", 2), lobe_count("oren_nayar+ggx", 2)
        (2, 1)
    """
    first, *rest = component_kinds(name, None if JOIN in name or LOBES[split_shared(name)[0]].is_material else wanted)
    return 1 if first.is_material else len(rest)


def split_shared(name: str) -> tuple[str, tuple[str, ...]]:
    """A model's name without the parameters that its lobes share, and these.

    Raises:
        UsageError: there is nothing behind the colon, or a part of it is empty.

    Example:
        >>> split_shared("oren_nayar+ggx+ggx:f0"), split_shared("ward")
        (('oren_nayar+ggx+ggx', ('f0',)), ('ward', ()))
    """
    joined, colon, rest = name.partition(SHARE)
    shared = tuple(part.strip() for part in rest.split(",")) if colon else ()
    if not all(shared):
        raise UsageError(f"model: expected names of parameters behind the colon, as ggx:f0 has, found {shown(name)}")
    return joined, shared


def make_model(name: str, lobes: int | None = None, dtype: torch.dtype | None = None, channels: int = RGB) -> Sum:
    """Make a model to fit: a diffuse term plus lobes, each parameter at its start (the paper's eq. 11).

    Args:
        name: a registered lobe, our own or another package's, beside Lambert: "ggx"; or all components: "ggx+ward",
            "oren_nayar+ggx+ggx"; or a whole material, which has no other lobe beside it. Parameters that are one for
            all specular lobes that have them follow a colon: "ggx:f0", "ggx+beckmann:f0,specular".
        lobes: how many specular lobes; None: two of one kind, or those that are named.
        dtype: of the parameters; torch's default if not given.
        channels: of values: three of linear RGB, or as many as there are bands.

    Returns:
        The sum.

    Raises:
        UsageError: a name is unknown, or the components are none of a model, see `component_kinds`.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> make_model("ward", lobes=1).components()
        [Lambert(albedo=[0.5, 0.5, 0.5]), Ward(specular=[0.5, 0.5, 0.5], roughness=0.01)]
        >>> make_model("ggx:f0").shared
        ('f0',)
    """
    kinds = [in_bands(kind, channels) for kind in component_kinds(name, lobes)]
    return Sum(*(kind(dtype=dtype) for kind in kinds), shared=split_shared(name)[1])


def model_name(model: Lobe) -> tuple[str, int]:
    """The name of a model and how many specular lobes it has: what `make_model` made it from.

    Args:
        model: a diffuse term plus registered lobes, or a whole material.

    Returns:
        The name and the count.

    Raises:
        UsageError: it is something else.

    Example:
        >>> from torchbrdf.lobes import make_model, model_name
        >>> model_name(make_model("ward", lobes=2)), model_name(make_model("ggx+ward"))
        (('ward', 2), ('ggx+ward', 2))
    """
    kinds = [type(component).in_rgb for component in model.components()]
    first, *rest = kinds
    alone = first.is_material and not rest
    if not alone and (not first.is_diffuse or not rest or any(kind.is_diffuse or kind.is_material for kind in rest)):
        found = " + ".join(kind.__name__ for kind in kinds)
        raise UsageError(f"model: expected a diffuse term plus lobes, or a whole material, found {found}")
    names = [LOBES.name_of(kind) for kind in kinds]
    for kind, name in zip(kinds, names, strict=True):
        if name is None:
            raise UsageError(f"model: expected lobes of a registered kind, found {kind.__name__}")
    if alone:
        return str(names[0]), 1
    named = names[1:] if first is Lambert else names
    same = first is Lambert and len({*rest}) == 1
    shared = getattr(model, "shared", ())
    behind = SHARE + ",".join(shared) if shared else ""
    return (str(names[1]) if same else JOIN.join(map(str, named))) + behind, len(rest)


def parameters(model: Lobe, material: int = 0) -> dict[str, Any]:
    """One material's parameters as plain lists, as a `fits.json` has them.

    Args:
        model: a diffuse term plus lobes, or a whole material, batched or not.
        material: which of a batch.

    Returns:
        Each parameter of a whole material by its name; of lobes `diffuse`, the albedo of the diffuse term, what else
        that has, as `diffuse_roughness`; for every other name a list with one value a lobe, None for a lobe of a kind
        that has no such parameter.

    Example:
        >>> from torchbrdf.lobes import Lambert, Sum, Ward, parameters
        >>> parameters(Sum(Lambert(albedo=0.25), Ward(specular=0.5, roughness=0.125)))
        {'diffuse': [0.25, 0.25, 0.25], 'specular': [[0.5, 0.5, 0.5]], 'roughness': [0.125]}
    """
    first, *rest = model.components()
    if first.is_material:
        return {name: _plain(first, spec, material) for name, spec in first.parameter_specs.items()}
    found: dict[str, Any] = {
        key: _plain(first, first.parameter_specs[name], material) for key, name in _diffuse_keys(type(first)).items()
    }
    for name in _names([type(component) for component in rest]):
        found[name] = [
            _plain(component, component.parameter_specs[name], material) if name in component.parameter_specs else None
            for component in rest
        ]
    return found


def from_parameters(name: str, values: Mapping[str, Any], dtype: torch.dtype | None = None, channels: int = RGB) -> Sum:
    """Make the model that `parameters` describes. Values outside their bounds are kept as they are.

    Args:
        name: of the model, as `model_name` gives it.
        values: `diffuse` and, for each parameter of its lobes, a list with one value a lobe; of a whole material its
            parameters.
        dtype: of the parameters; torch's default if not given.
        channels: of values, as of `make_model`.

    Returns:
        The sum, not batched.

    Raises:
        DataError: the names, counts or shapes are not those of the model, values are no finite numbers, or lobes that
            share a parameter have different ones.

    Example:
        >>> from torchbrdf.lobes import from_parameters
        >>> values = {"diffuse": [0.3, 0.2, 0.1], "specular": [[0.5, 0.5, 0.5]], "roughness": [0.125]}
        >>> from_parameters("ward", values).components()[1]
        Ward(specular=[0.5, 0.5, 0.5], roughness=0.125)
    """
    joined, shared = split_shared(name)
    where = f"parameters of {name}"
    diffuse, *kinds = (in_bands(kind, channels) for kind in component_kinds(joined, None if JOIN in joined else 1))
    dtype = dtype or torch.get_default_dtype()
    if diffuse.is_material:
        _check_names(values, diffuse.parameter_specs, where)
        return Sum(diffuse(dtype=dtype, **_own_values(diffuse, values, where)))
    keys, names = _diffuse_keys(diffuse), _names(kinds)
    optional = {name for kind in kinds for name, spec in kind.parameter_specs.items() if spec.optional}
    absent = optional - set(values)
    names = [name for name in names if name not in absent]
    _check_names(values, [*keys, *names], where)
    lists = {key: _one_a_lobe(values[key], f"{where}: {key}") for key in names}
    counts = {len(entries) for entries in lists.values()}
    kinds = kinds if JOIN in joined else kinds * max(counts, default=0)
    if counts != {len(kinds)} or not kinds:
        expected = f"{len(kinds)} values" if JOIN in joined else "one value a lobe for each"
        raise DataError(f"{where}: expected {expected}, found {sorted(counts)} values")
    for key in absent:
        specs = [kind.parameter_specs for kind in kinds]
        lists[key] = [own[key].start if key in own else None for own in specs]
    for key in shared:
        if len({repr(value) for value in lists.get(key, ()) if value is not None}) > 1:
            raise DataError(f"{where}: {key}: expected one value for all lobes, found {shown(lists[key])}")
    base = {name: _numbers(values[key], diffuse.parameter_specs[name], f"{where}: {key}") for key, name in keys.items()}
    return Sum(
        diffuse(dtype=dtype, **base),
        *(
            kind(dtype=dtype, **_own_values(kind, {key: entries[k] for key, entries in lists.items()}, where))
            for k, kind in enumerate(kinds)
        ),
        shared=shared,
    )


def _check_names(values: Mapping[str, Any], wanted: Iterable[str], where: str) -> None:
    if set(values) != {*wanted}:
        raise DataError(f"{where}: expected {', '.join(sorted(wanted))}, found {', '.join(map(str, values)) or 'none'}")


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
            raise DataError(f"{where}: {key}: expected null for {LOBES.name_of(kind.in_rgb)}, found {shown(value)}")
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
    return value.item() if spec.is_scalar else value.tolist()
