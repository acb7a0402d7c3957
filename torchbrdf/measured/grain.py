"""Whether scattered samples have a grain: whether it helps to know how the surface is turned about its normal."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch

from torchbrdf.measured.scattered import Angles, Places, Surface
from torchbrdf.pairs import Pairs

GRAINS = ("auto", "isotropic", "anisotropic")
"""What a reader may be told of samples: auto finds it out."""
SAID = "grain:"
"""Behind it a file with comments says which of the others it is."""
# Degrees between azimuths of the light that are two.
_STEP = 0.1
# The share of places that are left out, and how few of them say nothing.
_SHARE, _FEW = 0.1, 8
LEAST = 0.05
"""A rms of logarithms up to which an isotropic material predicts samples well enough."""
BETTER = 0.9
"""What an anisotropic one's has to be at most, as a share of it."""


class Grain(NamedTuple):
    """Whether samples are read as anisotropic, and what there is to say of it, by name."""

    is_there: bool
    facts: dict[str, object]


def azimuths(wi: np.ndarray) -> int:
    """How many azimuths the light has, but at the normal.

    Args:
        wi: Unit vectors to it, `(N, 3)`.
    """
    tilted = wi[:, 2] < np.cos(np.radians(_STEP))
    azimuth = np.round(np.degrees(np.arctan2(wi[tilted, 1], wi[tilted, 0])) / _STEP).astype(np.int64)
    return len(np.unique(azimuth % round(360 / _STEP)))


def said_grain(comments: Iterable[str]) -> str:
    """What comments in a file say of a grain, one of `GRAINS`.

    Example:
        >>> said_grain(["made up", "grain: anisotropic"]), said_grain([])
        ('anisotropic', 'auto')
    """
    said = (one.strip().lower().removeprefix(SAID).strip() for one in comments if one.strip().lower().startswith(SAID))
    return next((one for one in said if one in GRAINS), GRAINS[0])


def grain_of(wi: np.ndarray, wo: np.ndarray, values: np.ndarray, told: str = GRAINS[0]) -> Grain:
    """Whether samples have a grain: of those whose light has several azimuths by what they predict.

    Some are left out, and predicted as of an isotropic and as of an anisotropic material. Where azimuths only differ by
    noise the former is better, since it takes the mean over them.

    Args:
        wi: Unit vectors to the light, `(N, 3)`.
        wo: Unit vectors to the viewer, `(N, 3)`.
        values: `(N,)`.
        told: One of `GRAINS`.
    """
    count = azimuths(wi)
    name = "azimuths of the light"
    if told == "anisotropic":
        return Grain(True, {"anisotropic": f"{count} {name}; as was told"})
    if count < 2:
        return Grain(False, {})
    if told == "isotropic":
        return Grain(False, {name: f"{count}: read as isotropic, as was told"})
    flat, turned = _left_out(wi, wo, values)
    if flat is None or turned is None:
        return Grain(False, {name: f"{count}: too few samples to tell; read as isotropic, by the mean over them"})
    off = f"samples that are left out are predicted within {turned:.2g} (rms of logs) with them, {flat:.2g} without"
    if flat > LEAST and turned < BETTER * flat:
        return Grain(True, {"anisotropic": f"{count} {name}; {off}"})
    return Grain(False, {name: f"{count}: read as isotropic, by the mean over them; {off}"})


def _left_out(wi: np.ndarray, wo: np.ndarray, values: np.ndarray) -> tuple[float | None, float | None]:
    """How well samples that are left out are predicted without and with a grain; None where there are too few."""
    pairs = Pairs.from_directions(torch.from_numpy(wi)[None], torch.from_numpy(wo)[None])
    own = Places(Angles.of(pairs, 0, has_grain=True)).of_sample  # repetitions are left out together
    out = (np.random.default_rng(0).random(own.max() + 1) < _SHARE)[own]
    if out.sum() < _FEW:
        return None, None
    kept, asked = (pairs.select(samples=torch.from_numpy(np.flatnonzero(part))) for part in (~out, out))
    found = []
    for has_grain in (False, True):
        places = Places(Angles.of(kept, 0, has_grain))
        surface = Surface(places, values[~out, None])
        near = places.near(Angles.of(asked, 0, has_grain))
        off = surface.compressed(surface.at(near)[:, 0]) - surface.compressed(values[out])
        found.append(float(np.sqrt(np.mean(np.square(off)))))
    return found[0], found[1]
