"""Whether scattered samples have a grain: whether values differ where the surface is turned about its normal."""

from typing import NamedTuple

import numpy as np

from torchbrdf.measured.scattered import tree_of

GRAINS = ("auto", "isotropic", "anisotropic")
"""What a reader may be told of samples: auto finds it out."""
_STEP = 0.1
# Degrees up to which samples are at the same angles, but for how the surface is turned.
_NEAR = 1.0
# So many samples are enough, and so few pairs of them say nothing. Among so many neighbours are all turns, or enough.
_MOST, _FEW, _MANY = 20_000, 20, 64
LEAST = 0.05
"""Samples of other azimuths that are less apart, as a relative root mean square, are one isotropic material's."""
TIMES = 1.5
"""And so many times as far as those that only noise makes different they have to be apart."""


# Noise, where nothing tells it.
_UNKNOWN = 0.1


class Grain(NamedTuple):
    """Whether samples are read as anisotropic, and what there is to say of it, by name."""

    is_there: bool
    facts: dict[str, object]


def grain_of(wi: np.ndarray, wo: np.ndarray, values: np.ndarray, told: str = GRAINS[0]) -> Grain:
    """Whether samples have a grain.

    Samples at the same angles of light and viewer, and of the azimuth between, are compared: those whose light is
    turned by a quarter turn, or nearly so, are farther apart than those that it is turned least between, or by half a
    turn, or those of one azimuth, mirrored at the plane of incidence. Noise would make all of them different alike.

    Args:
        wi: Unit vectors to the light, `(N, 3)`.
        wo: Unit vectors to the viewer, `(N, 3)`.
        values: `(N,)`.
        told: One of `GRAINS`.
    """
    tilted = wi[:, 2] < np.cos(np.radians(_STEP))
    azimuth = np.round(np.degrees(np.arctan2(wi[tilted, 1], wi[tilted, 0])) / _STEP).astype(np.int64) % round(
        360 / _STEP
    )
    count = len(np.unique(azimuth))
    if count < 2:
        if told == "anisotropic":
            return Grain(True, {"anisotropic": f"{max(count, 1)} azimuth of the light, as was told"})
        return Grain(False, {})
    name = f"{count} azimuths of the light"
    if told != "auto":
        there = told == "anisotropic"
        return Grain(there, {"anisotropic" if there else "azimuths of the light": f"{name}, {told} as was told"})
    some = np.flatnonzero(tilted)[:: max(1, int(tilted.sum()) // _MOST)]
    own = azimuth[:: max(1, len(azimuth) // _MOST)][: len(some)]
    apart, least = _apart(_places(wi[some], wo[some]), values[some], own * _STEP)
    if apart is None:
        said = "no two at the same angles otherwise: read as isotropic (--read grain=anisotropic)"
        return Grain(False, {"azimuths of the light": f"{count}: {said}"})
    far = f"up to {100 * apart:.2g} % apart (rms)" + (
        f", and {100 * least:.2g} % by noise" if least is not None else ""
    )
    if apart > LEAST and apart > TIMES * (_UNKNOWN if least is None else least):
        return Grain(True, {"anisotropic": f"{name}, whose samples are {far}"})
    said = "read as isotropic, by the mean over them"
    return Grain(False, {"azimuths of the light": f"{count}: samples are {far}; {said}"})


def _places(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Where samples are whatever the surface's turn, degrees, `(N, 4)`: the azimuth between as a unit vector."""
    theta_i, theta_o = (np.arctan2(np.hypot(one[:, 0], one[:, 1]), one[:, 2]) for one in (wi, wo))
    across, along = wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0], (wi[:, :2] * wo[:, :2]).sum(-1)
    length = np.maximum(np.hypot(across, along), 1e-12)
    arm = np.sin(np.minimum(theta_i, theta_o)) / length
    return np.degrees(np.stack([theta_i, theta_o, arm * along, arm * across], -1))


def _apart(places: np.ndarray, values: np.ndarray, azimuth: np.ndarray) -> tuple[float | None, float | None]:
    """How far samples are apart whose light is turned most, and the least that others are; None without any.

    Args:
        places: Where they are, whatever the surface's turn.
        values: `(N,)`.
        azimuth: Of the light, degrees.
    """
    distance, index = tree_of(places).query(places, min(_MANY, len(places)), distance_upper_bound=_NEAR)
    distance, index = distance.reshape(len(places), -1), index.reshape(len(places), -1)
    index = np.where(np.isfinite(distance), index, np.arange(len(places))[:, None])
    turn = np.abs((azimuth[index] - azimuth[:, None] + 180) % 360 - 180)
    quarters = np.minimum(turn, 180 - turn)
    most = _spread(values, index, np.where(quarters > _STEP / 2, quarters, -1))
    fewest = _spread(values, index, np.where(quarters > _STEP / 2, 100 - quarters, -1))
    half = _spread(values, index, np.where(turn > 180 - _STEP / 2, 1.0, -1.0))
    here = np.concatenate([places, azimuth[:, None] * (_NEAR / _STEP)], -1)  # each azimuth for itself
    distance, index = tree_of(here).query(here * [1, 1, 1, -1, 1], min(2, len(here)), distance_upper_bound=_NEAR)
    own = np.arange(len(here))[:, None]
    distance, index = distance.reshape(len(here), -1), index.reshape(len(here), -1)
    counts = np.isfinite(distance) & (index != own)  # not those that are their own mirror image
    mirrored = _spread(values, np.where(counts, index, own), np.where(counts, 1.0, -1.0))
    others = [one for one in (fewest, half, mirrored) if one is not None]
    return most, min(others, default=None)


def _spread(values: np.ndarray, index: np.ndarray, order: np.ndarray) -> float | None:
    """How far values are from those of the partner that an order, not below 0, has highest: a relative rms."""
    best = order.argmax(1)
    rows = np.flatnonzero(order[np.arange(len(order)), best] >= 0)
    if len(rows) < _FEW:
        return None
    one, other = values[rows], values[index[rows, best[rows]]]
    level = (np.abs(one) + np.abs(other)) / 2
    return float(np.sqrt(np.mean(np.square((one - other) / np.maximum(level, 1e-30)))))
