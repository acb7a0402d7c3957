"""Values between scattered samples of isotropic materials, and how far the nearest sample is.

Light and viewer can change places, and what is mirrored at the plane of incidence is the same: so a pair of directions
is a place in three coordinates, of the half and difference angles. Values are compressed (log for large ones, linear
about 0, for those slightly below), taken apart into a curve over theta_h, the lobe, and the rest, and the rest is
interpolated by inverse distances (D. Shepard, A Two-dimensional Interpolation Function for Irregularly-spaced Data,
1968, doi:10.1145/800186.810616, with the weights of R. Franke and G. Nielson, Smooth Interpolation of Large Sets of
Scattered Data, 1980, doi:10.1002/nme.1620151110). It was chosen by what it predicts of samples that are left out:
benchmarks/scattered.py.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional

from torchbrdf.pairs import Pairs

NEIGHBOURS = 12
"""Places that a value is made of."""
_BINS = 40
# How much of the lobe's coordinate counts beside the difference angle's: lobes are narrow, and change little with it.
_HALF = 2.0
# Values times (cos_i cos_o)^_FALL vary less towards the horizon; cosines below _LEAST count as it.
_FALL, _LEAST = 0.25, 0.02
# Samples nearer than so much, in the coordinates, are repetitions, and their mean counts.
_SAME = 1e-4
_TINY = 1e-9


class Angles(NamedTuple):
    """Half and difference angles of n pairs, radians, `(n,)` each, and the product of the cosines.

    phi_d is folded to [0, pi/2], by reciprocity and by the mirror.
    """

    theta_h: np.ndarray
    theta_d: np.ndarray
    phi_d: np.ndarray
    cosines: np.ndarray

    @classmethod
    def of(cls, pairs: Pairs, row: int) -> "Angles":
        """Of one material's pairs; every material's, where they share them."""
        own = pairs.select([row])
        theta_h, theta_d, cos_i, cos_o = (
            part[0].double().cpu().numpy() for part in (own.theta_h, own.theta_d, own.cos_i, own.cos_o)
        )
        # |cos_i - cos_o| = 2 sin theta_h sin theta_d |cos phi_d|: where that is 0, phi_d does not matter.
        sines = 2 * np.sin(theta_h) * np.sin(theta_d)
        along = np.abs(cos_i - cos_o) / np.where(sines > _TINY, sines, 1)
        cosines = np.maximum(cos_i, _LEAST) * np.maximum(cos_o, _LEAST)
        return cls(theta_h, theta_d, np.arccos(np.clip(along, 0, 1)), cosines)

    def _arm(self) -> np.ndarray:
        """How far directions turn as phi_d does: about the half vector or about the normal, which is less."""
        half, difference = np.sin(self.theta_h), np.sin(self.theta_d)
        found: np.ndarray = half * difference / np.sqrt(half**2 + difference**2 + _TINY**2)
        return found

    def places(self) -> np.ndarray:
        """Where samples are interpolated, `(n, 3)`: fine about the lobe, and even where values are."""
        around = self._arm() * np.cos(2 * self.phi_d) / 2
        return np.stack([_HALF * np.sqrt(self.theta_h), self.theta_d, around], -1)

    def turned(self) -> np.ndarray:
        """Where distances are those by which both directions turn, `(n, 3)`, degrees."""
        found: np.ndarray = np.stack([self.theta_h, self.theta_d, self._arm() * self.phi_d], -1) * (180 / math.pi)
        return found


class Near(NamedTuple):
    """What values are made of at n pairs: places with their weights, `(n, k)`, and the pairs' angles."""

    index: Tensor
    weight: Tensor
    angles: Angles


class Places:
    """Where samples are, repetitions once: what all materials share that were measured at the same pairs.

    Args:
        angles: Of the samples, N of them.
    """

    def __init__(self, angles: Angles) -> None:
        found = angles.places()
        steps = np.round(found / _SAME).astype(np.int64)
        steps -= steps.min(0)
        key = np.ravel_multi_index(tuple(steps.T), tuple(steps.max(0) + 1))
        _, self.of_sample = np.unique(key, return_inverse=True)
        self.count = np.bincount(self.of_sample)
        self.theta_h = self.mean(angles.theta_h)
        self.cosines = self.mean(angles.cosines)
        self._tree = KDTree(np.stack([self.mean(axis) for axis in found.T], -1))

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Of values `(N,)` of samples, those of places."""
        found: np.ndarray = np.bincount(self.of_sample, values) / self.count
        return found

    def near(self, angles: Angles, neighbours: int = NEIGHBOURS) -> Near:
        """The places about some pairs."""
        count = min(neighbours, len(self.count))
        distance, index = self._tree.query(angles.places(), count, workers=torch.get_num_threads())
        distance, index = distance.reshape(-1, count), index.reshape(-1, count)
        distance = np.maximum(distance, _TINY)
        reach = distance[:, -1:] * 1.05
        weight = np.square(1 / distance - 1 / reach)
        weight /= weight.sum(1, keepdims=True)
        return Near(torch.from_numpy(index), torch.from_numpy(weight), angles)


class Surface:
    """Values of one material at places, and between them.

    Beyond all samples the curve over theta_h goes on, times the mean of the nearest places' rest, and rises towards the
    horizon with (cos_i cos_o)^(-1/4).

    Args:
        places: Where the samples are.
        values: Of the samples, `(N, C)`, in 1/sr.
    """

    def __init__(self, places: Places, values: np.ndarray) -> None:
        rising = places.cosines[:, None] ** _FALL
        mean = np.stack([places.mean(channel) for channel in values.T], -1) * rising
        size = np.abs(mean)
        self.scale = max(float(np.quantile(size, 0.02)), 1e-3 * float(size.mean()), 1e-30)
        compressed = np.arcsinh(mean / (2 * self.scale))
        self._knots, self._lobe = _curve(np.sqrt(places.theta_h), compressed)
        self.rest = torch.from_numpy(compressed - self._along(places.theta_h))

    def _along(self, theta_h: np.ndarray) -> np.ndarray:
        place = np.sqrt(theta_h)
        return np.stack([np.interp(place, self._knots, channel) for channel in self._lobe.T], -1)

    def at(self, near: Near) -> np.ndarray:
        """Values at pairs whose near places are known, `(n, C)`, in 1/sr."""
        rest = functional.embedding_bag(near.index, self.rest, per_sample_weights=near.weight, mode="sum")
        compressed = self._along(near.angles.theta_h) + rest.numpy()
        found: np.ndarray = 2 * self.scale * np.sinh(compressed) / near.angles.cosines[:, None] ** _FALL
        return found


def _curve(place: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Knots of a curve through values `(n, C)`: means over bins of as many each."""
    edges = np.unique(np.quantile(place, np.linspace(0, 1, _BINS + 1)))
    own = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, max(len(edges) - 2, 0))
    count = np.bincount(own)
    full = count > 0
    sums = [np.bincount(own, column)[full] / count[full] for column in (place, *values.T)]
    return sums[0], np.stack(sums[1:], -1)
