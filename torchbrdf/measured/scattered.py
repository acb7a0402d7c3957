"""Values between scattered samples, and how far the nearest sample is.

Light and viewer can change places, and what is mirrored at the plane of incidence is the same: so a pair of directions
is a place in three coordinates, of the half and difference angles. A sum of lobes is fitted to the samples, of given
widths and with heights that are not negative. How far values are from it, compressed (log for large values, linear
about 0, for those slightly below), is a curve over theta_h and a rest, and the rest is interpolated by inverse
distances (R. Franke and G. Nielson, Smooth Interpolation of Large Sets of Scattered Data, 1980,
doi:10.1002/nme.1620151110). It was chosen by what it predicts of samples that are left out: benchmarks/scattered.py.

Of anisotropic materials nothing is mirrored, and there are two azimuths more, of the half vector and of the difference
of both directions: where light and viewer change places, half a turn of the latter. Lobes have two widths, along and
across a grain, whose direction is that in which samples are bright farthest from the mirror direction.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from torchbrdf.pairs import Pairs

if TYPE_CHECKING:
    from scipy.spatial import KDTree

NEIGHBOURS = 12
"""Places that a value is made of."""
_BINS = 40
# How much of the lobe's coordinate counts beside the difference angle's: lobes are narrow, and change little with it.
_HALF = 2.0
# Of GGX lobes, alpha; cosines below _LEAST count as it. So many samples are enough to find their heights.
_WIDTHS, _LEAST, _FITTED = np.geomspace(0.02, 0.7, 9), 0.02, 20_000
# With a grain: along and across it; fewer, as they come in pairs.
_TWO, _FITTED_GRAIN = np.array([(a, b) for a in _WIDTHS[::2] for b in _WIDTHS[::2]]), 5_000
# Slopes of half vectors up to which lobes show where the grain lies.
_STEEP = 1.0
# Samples nearer than so much, in the coordinates, are repetitions, and their mean counts.
_SAME = 1e-4
_TINY = 1e-9
# Points that a tree does not divide further.
_LEAF = 24


def tree_of(points: np.ndarray) -> "KDTree":
    """What finds the nearest of points `(N, d)`."""
    from scipy.spatial import KDTree  # late, as it takes long to import, and tables have no need of it

    return KDTree(points, leafsize=_LEAF)


class Angles(NamedTuple):
    """Half and difference angles of n pairs, radians, and the product cos_i cos_o, `(n,)` each.

    phi_d is folded to [0, pi/2], by reciprocity and by the mirror. `grain`, `(n, 4)`, has the unit vectors of the
    azimuths of anisotropic materials: of the half vector, and of twice that of the difference.
    """

    theta_h: np.ndarray
    theta_d: np.ndarray
    phi_d: np.ndarray
    cosines: np.ndarray
    grain: np.ndarray | None = None

    @classmethod
    def of(cls, pairs: Pairs, row: int, has_grain: bool = False) -> "Angles":
        """Of one material's pairs; every material's, where they share them."""
        own = pairs.select([row])
        theta_h, theta_d, cos_i, cos_o = (
            part[0].double().cpu().numpy() for part in (own.theta_h, own.theta_d, own.cos_i, own.cos_o)
        )
        grain = _azimuths(*(part[0].double().cpu().numpy() for part in (own.wi, own.wo))) if has_grain else None
        return cls.at(theta_h, theta_d, cos_i, cos_o, grain)

    @classmethod
    def at(
        cls, theta_h: np.ndarray, theta_d: np.ndarray, cos_i: np.ndarray, cos_o: np.ndarray, grain: np.ndarray | None
    ) -> "Angles":
        """With what follows of the cosines."""
        # |cos_i - cos_o| = 2 sin theta_h sin theta_d |cos phi_d|: where that is 0, phi_d does not matter.
        sines = 2 * np.sin(theta_h) * np.sin(theta_d)
        along = np.abs(cos_i - cos_o) / np.where(sines > _TINY, sines, 1)
        cosines = np.maximum(cos_i, _LEAST) * np.maximum(cos_o, _LEAST)
        return cls(theta_h, theta_d, np.arccos(np.clip(along, 0, 1)), cosines, grain)

    def select(self, index: np.ndarray) -> "Angles":
        """Of some of the pairs, in another order."""
        grain = None if self.grain is None else self.grain[index]
        return Angles(self.theta_h[index], self.theta_d[index], self.phi_d[index], self.cosines[index], grain)

    def _arm(self) -> np.ndarray:
        """How far directions turn as phi_d does: about the half vector or about the normal, which is less."""
        half, difference = np.sin(self.theta_h), np.sin(self.theta_d)
        found: np.ndarray = half * difference / np.sqrt(half**2 + difference**2 + _TINY**2)
        return found

    def places(self) -> np.ndarray:
        """Where samples are interpolated, `(n, 3 or 5)`: fine about the lobe, and even where values are."""
        if self.grain is not None:
            return _with_azimuths(_HALF * np.sqrt(self.theta_h), self.theta_d, self.grain)
        around = self._arm() * np.cos(2 * self.phi_d) / 2
        return np.stack([_HALF * np.sqrt(self.theta_h), self.theta_d, around], -1)

    def lobes(self, turn: float | None = None, widths: np.ndarray | slice = slice(None)) -> np.ndarray:
        """A constant, and GGX lobes of given widths without and with Schlick's rise of Fresnel's, `(n, L)`, in 1/sr.

        With a turn, the azimuth of a grain in radians, they have widths along and across it. `widths` are those that
        are wanted, by their places.

        Source: B. Walter et al., Microfacet Models for Refraction through Rough Surfaces, 2007,
        doi:10.2312/EGWR/EGSR07/195-206; the shadowing is E. Hammon's approximation, PBR Diffuse Lighting for GGX+Smith
        Microsurfaces, 2017.
        """
        cos_h = np.maximum(np.cos(self.theta_h), _LEAST)[:, None]
        cos4 = np.square(cos_h**2)  # powers other than squares take long
        tan2 = 1 / cos_h**2 - 1
        if turn is None or self.grain is None:
            alpha = _WIDTHS[widths]
            distribution = alpha**2 / (math.pi * cos4 * (alpha**2 + tan2) ** 2)
        else:
            along, across = _TWO[widths].T
            alpha = np.sqrt(along * across)
            share = (self.grain[:, :1] * math.cos(turn) + self.grain[:, 1:2] * math.sin(turn)) ** 2
            slope = tan2 * (share / along**2 + (1 - share) / across**2)
            distribution = 1 / (math.pi * alpha**2 * cos4 * (1 + slope) ** 2)
        both = 2 * (cos_h * np.cos(self.theta_d)[:, None])  # cos_i + cos_o
        product = self.cosines[:, None]
        visible = distribution / (2 * ((1 - alpha) * 2 * product + alpha * np.maximum(both, _LEAST)))
        low = 1 - np.cos(self.theta_d)[:, None]
        rise = np.square(low**2) * low
        return np.concatenate([np.ones_like(cos_h), visible, visible * rise], -1)

    def turned(self) -> np.ndarray:
        """Where distances are those by which both directions turn, `(n, 3 or 5)`, degrees."""
        if self.grain is not None:
            return _with_azimuths(self.theta_h, self.theta_d, self.grain) * (180 / math.pi)
        found: np.ndarray = np.stack([self.theta_h, self.theta_d, self._arm() * self.phi_d], -1) * (180 / math.pi)
        return found


def _azimuths(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Unit vectors of the azimuth of the half vector and of twice that of the difference, `(n, 4)`; 0 where none is."""
    parts = []
    for flat in (wi[:, :2] + wo[:, :2], wi[:, :2] - wo[:, :2]):
        length = np.hypot(flat[:, 0], flat[:, 1])
        parts.append(flat / np.where(length > _TINY, length, 1)[:, None])
    half, (cosine, sine) = parts[0], parts[1].T
    return np.concatenate([half, np.stack([cosine**2 - sine**2, 2 * cosine * sine], -1)], -1)


def _with_azimuths(half: np.ndarray, difference: np.ndarray, grain: np.ndarray) -> np.ndarray:
    """Polar coordinates as places `(n, 5)`: steps along and across the difference have the lengths that they have."""
    twice = (difference / 2)[:, None] * grain[:, 2:]
    return np.concatenate([half[:, None] * grain[:, :2], (difference * (math.sqrt(3) / 2))[:, None], twice], -1)


def _neighbours_together(places: np.ndarray) -> np.ndarray:
    """An order `(n,)` of places in which neighbours are near each other: what trees are asked so, they find sooner."""
    least = places.min(0, initial=math.inf)
    extent = np.maximum(places.max(0, initial=-math.inf) - least, _TINY)
    count = 2 ** (16 // places.shape[1])  # of cells along each coordinate: NumPy sorts numbers of 16 bits fastest
    cells = np.minimum((places - least) * (count / extent), count - 1).astype(np.int64)
    key = np.ravel_multi_index(tuple(cells.T), (count,) * places.shape[1])
    return np.argsort(key.astype(np.uint16), kind="stable")


def nearest(tree: "KDTree", places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far the nearest point of a tree is from each place, and which it is, `(n,)` each."""
    order = _neighbours_together(places)
    distance, index = np.empty(len(places)), np.empty(len(places), np.int64)
    distance[order], index[order] = tree.query(places[order], workers=torch.get_num_threads())
    return distance, index


class Near(NamedTuple):
    """What values are made of at n pairs: places with their weights, `(n, k)`, and angles.

    They stand as neighbours do: row k is of pair `order[k]`.
    """

    order: np.ndarray
    places: Tensor
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
        key = np.ravel_multi_index(tuple(steps.T[:3]), tuple(steps.max(0)[:3] + 1))
        for column in steps.T[3:]:  # all at once they would be too many
            key = np.unique(key, return_inverse=True)[1] * (column.max() + 1) + column
        _, self.of_sample = np.unique(key, return_inverse=True)
        self.count = np.bincount(self.of_sample)
        self.has_grain = angles.grain is not None
        grain = None if angles.grain is None else np.stack([self.mean(axis) for axis in angles.grain.T], -1)
        theta_h, theta_d, phi_d, cosines = (self.mean(one) for one in angles[:4])
        self.angles = Angles(theta_h, theta_d, phi_d, cosines, grain)
        self._tree = tree_of(np.stack([self.mean(axis) for axis in found.T], -1))

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Of values `(N,)` of samples, those of places."""
        found: np.ndarray = np.bincount(self.of_sample, values) / self.count
        return found

    def near(self, angles: Angles, neighbours: int = NEIGHBOURS) -> Near:
        """The places about some pairs."""
        count = min(neighbours, len(self.count))
        asked = angles.places()
        order = _neighbours_together(asked)
        asked, angles = asked[order], angles.select(order)
        distance, index = self._tree.query(asked, count, workers=torch.get_num_threads())
        distance, index = distance.reshape(-1, count), index.reshape(-1, count)
        distance = np.maximum(distance, _TINY)
        reach = distance[:, -1:] * 1.05
        weight = np.reciprocal(distance)
        weight -= 1 / reach
        weight *= weight
        weight /= weight.sum(1, keepdims=True)
        return Near(order, torch.from_numpy(index), torch.from_numpy(weight), angles)


class Surface:
    """Values of one material at places, and between them.

    Beyond all samples the fitted lobes go on, times what the nearest places are off from them.

    Args:
        places: Where the samples are.
        values: Of the samples, `(N, C)`, in 1/sr.
    """

    def __init__(self, places: Places, values: np.ndarray) -> None:
        self.mean = mean = np.stack([places.mean(channel) for channel in values.T], -1)
        size = np.abs(mean)
        self.scale = max(float(np.quantile(size, 0.02)), 1e-3 * float(size.mean()), 1e-30)
        self._turn = _direction(places.angles, mean.mean(-1))
        lobes = places.angles.lobes(self._turn)
        some = slice(None, None, max(1, len(mean) // (_FITTED if self._turn is None else _FITTED_GRAIN)))
        heights = _heights(lobes[some], mean[some], self.scale)
        off = self.compressed(mean) - self.compressed(lobes @ heights)
        self._widths, self._heights = _used(heights)
        self._knots, self._curve = _curve(np.sqrt(places.angles.theta_h), off)
        self.rest = off - self._along(places.angles.theta_h)
        self._rest = torch.from_numpy(self.rest)

    def compressed(self, values: np.ndarray) -> np.ndarray:
        """The log of large values, and what is linear about 0."""
        found: np.ndarray = np.arcsinh(values / (2 * self.scale))
        return found

    def _along(self, theta_h: np.ndarray) -> np.ndarray:
        place = np.sqrt(theta_h)
        return np.stack([np.interp(place, self._knots, channel) for channel in self._curve.T], -1)

    def at(self, near: Near) -> np.ndarray:
        """Values at pairs whose near places are known, `(n, C)`, in 1/sr; of one place those of its samples."""
        found = np.empty((len(near.order), self.mean.shape[1]))
        if near.places.shape[1] == 1:
            found[near.order] = self.mean[near.places[:, 0].numpy()]
            return found
        rest = functional.embedding_bag(near.places, self._rest, per_sample_weights=near.weight, mode="sum").numpy()
        lobes = near.angles.lobes(self._turn, self._widths)
        smooth = self.compressed(lobes @ self._heights) + self._along(near.angles.theta_h)
        found[near.order] = 2 * self.scale * np.sinh(smooth + rest)
        return found


def _heights(lobes: np.ndarray, values: np.ndarray, scale: float) -> np.ndarray:
    """How high lobes are, none below 0, for the least relative error, `(L, C)`.

    What rises towards the horizon is the same in all channels, as Fresnel's reflection nearly is: each channel's own
    would make colours of noise there.
    """
    white = slice(1 + lobes.shape[1] // 2, None)
    rise = _nonnegative(lobes, values.mean(1), scale)[white]
    own = [_nonnegative(lobes[:, : white.start], one - lobes[:, white] @ rise, scale, one) for one in values.T]
    return np.stack([np.concatenate([one, rise]) for one in own], -1)


def _used(heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The places of widths whose lobes are not flat, few of all, and the heights of the constant and of these lobes."""
    both = heights[1:].reshape(2, -1, heights.shape[1])
    widths = np.flatnonzero(both.sum((0, 2)))  # none is below 0
    return widths, np.concatenate([heights[:1], *both[:, widths]])


def _direction(angles: Angles, values: np.ndarray) -> float | None:
    """The azimuth of the grain, radians: in which bright samples' half vectors tilt most; None without one."""
    if angles.grain is None:
        return None
    slope = np.tan(np.minimum(angles.theta_h, 1.5))
    weight = np.where(slope < _STEEP, np.maximum(values - np.median(values), 0), 0)
    tilted = slope[:, None] * angles.grain[:, :2]
    _, axes = np.linalg.eigh((tilted.T * weight) @ tilted)
    return math.atan2(axes[1, 1], axes[0, 1])


def _nonnegative(lobes: np.ndarray, values: np.ndarray, scale: float, whole: np.ndarray | None = None) -> np.ndarray:
    """Heights `(L,)` for values `(n,)`, a part of whole ones that errors are relative to."""
    weight = 1 / (np.maximum(values if whole is None else whole, 0) + 4 * scale)
    from scipy.optimize import nnls  # late, as below

    # Lobes of neighbouring widths are nearly the same: three changes of mind for each, as scipy has it, can be too few.
    found: np.ndarray = nnls(lobes * weight[:, None], values * weight, maxiter=1000 * lobes.shape[1])[0]
    return found


def _curve(place: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Knots of a curve through values `(n, C)`: means over bins of as many each."""
    place = np.round(place, 4)  # mirror directions are one place, whatever rounding made of them
    edges = np.unique(np.quantile(place, np.linspace(0, 1, _BINS + 1)))
    own = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, max(len(edges) - 2, 0))
    count = np.bincount(own)
    full = count > 0
    sums = [np.bincount(own, column)[full] / count[full] for column in (place, *values.T)]
    return sums[0], np.stack(sums[1:], -1)
