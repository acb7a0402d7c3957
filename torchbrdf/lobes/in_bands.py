"""Lobes whose colours have another number of channels than three: those of bands of wavelengths.

Such a kind of lobe is made of the one that is declared, and is a subclass of it: what has a number a channel has one a
band, and all else is the same.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from torch import nn

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.lobes.base import LOBES, RGB, Lobe
from torchbrdf.lobes.sum import Sum

MOST = 10_000
"""Channels; no instrument has more."""


def in_bands(kind: type[Lobe], channels: int) -> type[Lobe]:
    """A kind of lobe with so many channels.

    Args:
        kind: of lobe, of any number of channels.
        channels: C.

    Raises:
        UsageError: it is a whole material, which renderers have in linear RGB only, or there cannot be so many.

    Example:
        >>> from torchbrdf.lobes import Ward
        >>> from torchbrdf.lobes.in_bands import in_bands
        >>> in_bands(Ward, 31)(specular=0.1, roughness=0.2)
        Ward(specular=<31>, roughness=0.2)
    """
    own = kind.in_rgb
    if channels == RGB:
        return own
    check_bands([own], f"{channels} channels")
    if not 0 < channels <= MOST:
        raise UsageError(f"{own.__name__}: expected 1 to {MOST} channels, found {channels}")
    if (own, channels) not in _KNOWN:
        _KNOWN[own, channels] = _made(own, channels)
    return _KNOWN[own, channels]


def check_bands(kinds: Iterable[type[Lobe]], found: str) -> None:
    """Refuse whole materials of renderers, which are of linear RGB.

    Args:
        kinds: of lobes.
        found: what there is in the place of linear RGB, for the message.

    Raises:
        UsageError: one of them is a whole material.

    Example:
        >>> from torchbrdf.lobes import Ward
        >>> from torchbrdf.lobes.in_bands import check_bands
        >>> check_bands([Ward], "31 channels")
    """
    for kind in kinds:
        if kind.is_material:
            name = LOBES.name_of(kind.in_rgb) or kind.__name__
            raise UsageError(
                f"{name}: expected linear RGB, which a renderer's whole material is of, found {found}; "
                "read bands as RGB (--bands rgb), or fit lobes such as ward"
            )


_KNOWN: dict[tuple[type[Lobe], int], type[Lobe]] = {}


def _made(kind: type[Lobe], channels: int) -> type[Lobe]:
    specs = {
        name: replace(spec, shape=(*spec.shape[:-1], channels))
        for name, spec in kind.parameter_specs.items()
        if spec.per_channel
    }
    place: dict[str, Any] = {"__module__": kind.__module__, "__qualname__": kind.__qualname__, "__doc__": kind.__doc__}
    name = LOBES.name_of(kind)
    if name is not None and kind.__module__.startswith("torchbrdf."):  # where other processes find it, see __getattr__
        place |= {"__module__": __name__, "__qualname__": f"{name}_{channels}"}
    return type(kind.__name__, (kind,), {**place, **specs, "channels": channels, "in_rgb": kind})


def __getattr__(name: str) -> type[Lobe]:
    """The kinds that are made here, by name, as pickles have it: `ward_31`."""
    lobe, _, channels = name.rpartition("_")
    if channels.isascii() and channels.isdigit() and int(channels) <= MOST and lobe in LOBES:
        return in_bands(LOBES[lobe], int(channels))
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def channels_of(model: Lobe) -> int:
    """How many channels the values of a lobe, or of a sum of lobes, have.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.lobes.in_bands import channels_of
        >>> channels_of(make_model("ward", channels=31))
        31
    """
    return model.components()[0].channels


def with_channels(model: Lobe, channels: int) -> Lobe:
    """A model with so many channels, each with what all channels have before: itself, if it has as many.

    Args:
        model: a lobe, or a sum of lobes.
        channels: C.

    Raises:
        UsageError: a lobe is a whole material, of linear RGB.
        ShapeError: channels differ, so that nobody knows what other channels have.

    Example:
        >>> from torchbrdf.lobes import make_model
        >>> from torchbrdf.lobes.in_bands import with_channels
        >>> with_channels(make_model("ward", 1), 31).components()
        [Lambert(albedo=<31>), Ward(specular=<31>, roughness=0.01)]
    """
    if channels_of(model) == channels:
        return model
    made = [_widened(lobe, channels) for lobe in model.components()]
    return Sum(*made, shared=getattr(model, "shared", ()))


def _widened(lobe: Lobe, channels: int) -> Lobe:
    kind = in_bands(type(lobe), channels)
    made = kind()
    for name, spec in kind.parameter_specs.items():
        value = getattr(lobe, name).detach()
        if spec.per_channel:
            if not bool((value == value[..., :1]).all()):
                where = f"{type(lobe).__name__}.{name}"
                raise ShapeError(f"{where}: expected the same start for all {lobe.channels} channels, found others")
            value = value[..., :1].expand(*value.shape[:-1], channels)
        setattr(made, name, nn.Parameter(value.clone()))
    return made
