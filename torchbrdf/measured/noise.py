"""How noisy measurements are: by samples that ought to be equal, or by neighbours.

An isotropic, reciprocal material is the same where light and viewer are mirrored at the plane of incidence, or change
places: what samples at such places differ by is noise, and how far the instrument is out of line. Where there are none,
samples are compared with what their neighbours say, beside a smooth surface through all of them: that is noise and what
the surface does not follow, and so the noise at most.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchbrdf.measured.measured import Measured
from torchbrdf.measured.scattered import Angles, Places, Surface, tree_of
from torchbrdf.pairs import Pairs

# Degrees within which samples are at the same place; so many samples at least say something; so many are looked at.
_SAME, LEAST, MOST = 0.05, 30, 4000
# Of more samples than that, as tables have, the next ones in the table are the neighbours.
_TABLE = 200_000
# A share of the value that is rounding, and no noise.
_ROUNDING, _TINY = 1e-5, 1e-30
# Degrees between neighbours in a table.
_NEAR_IN_TABLE = 3.0
# Neighbours, and the largest sum of squares of what they count by in a prediction.
_NEIGHBOURS, _STEADY = 10, 1.0
# Levels at which the noise is told, each from so many samples at least.
_LEVELS, _EACH = 8, 12
# A normal deviation by the median of its size.
_OF_MEDIAN = 1.4826


@dataclass(frozen=True)
class Noise:
    """The noise of one material's samples.

    Attributes:
        share: Of the value, its standard deviation, the median over samples and channels.
        by: What it was told by, in words.
        samples: How many say so.
        level: Values, growing, in 1/sr, `(L,)`.
        deviation: The standard deviation at these, in 1/sr, `(L,)`.
    """

    share: float
    by: str
    samples: int
    level: np.ndarray
    deviation: np.ndarray

    def like(self, values: Tensor, seed: int = 0) -> Tensor:
        """Noise of this size, one draw.

        Args:
            values: In 1/sr, of any shape.
            seed: Of the draw.

        Returns:
            What could be added to the values, of their shape.

        Example:
            >>> noise = Noise(0.1, "made up", 100, np.array([1.0, 2.0]), np.array([0.1, 0.2]))
            >>> noise.like(torch.full((10_000,), 1.5)).std().item()
            0.15...
        """
        size = values.detach().abs().cpu().double().numpy()
        spread = np.interp(size, self.level, self.deviation)
        spread = np.where(size > self.level[-1], self.deviation[-1] * size / max(self.level[-1], _TINY), spread)
        drawn = torch.randn(
            values.shape, generator=torch.Generator("cpu").manual_seed(seed), dtype=torch.float64, device="cpu"
        )
        return (drawn * torch.from_numpy(spread)).to(values)

    def __str__(self) -> str:
        return f"{100 * self.share:.2g} % of the value ({self.by}, {self.samples} samples)"


class _Off(NamedTuple):
    """What samples are off by, as deviations of single ones, `(n, C)`, their values, `(n, C)`, and what told it."""

    off: np.ndarray
    values: np.ndarray
    by: str


def noise_of(measured: Measured) -> Noise | None:
    """How noisy the samples of one material are.

    Args:
        measured: One material.

    Returns:
        The noise; None where samples are too few to tell, are not of a measurement, or of an anisotropic material.

    Example:
        >>> from torchbrdf.measured import load, standins
        >>> noise_of(load(standins()).batch([6])) is None
        True
    """
    return noises_of(measured)[0]


def noises_of(measured: Measured) -> list[Noise | None]:
    """The same of each of M materials; what follows of directions alone is done once for those that share them.

    Args:
        measured: M materials.

    Example:
        >>> from torchbrdf.measured import load, standins
        >>> noises_of(load(standins()).batch([5, 6]))
        [None, None]
    """
    source = measured.source
    if not source.is_sampled or source.stand_in or source.is_anisotropic:
        return [None] * len(measured)
    if len(measured.pairs) > _TABLE:
        every = [_in_table(measured.batch([k])) for k in range(len(measured))]
    else:
        every = list(_scattered(measured))
    return [None if found is None else _told(found) for found in every]


def _told(found: _Off) -> Noise | None:
    """The noise by level, from what samples are off by."""
    size, off = np.abs(found.values).reshape(-1), np.abs(found.off).reshape(-1)
    order = size.argsort(kind="stable")
    parts = [part for part in np.array_split(order, min(_LEVELS, max(len(order) // _EACH, 1))) if len(part)]
    level = np.array([_median(size[part]) for part in parts])
    deviation = _OF_MEDIAN * np.array([_median(off[part]) for part in parts])
    level, first = np.unique(level, return_index=True)
    share = float(_OF_MEDIAN * _median(off / np.maximum(size, _TINY)))
    return Noise(share, found.by, len(found.off), level, deviation[first])


def _median(values: np.ndarray) -> float:
    """As numpy's, which takes ten times as long for few values."""
    ordered = np.sort(values)
    return float((ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2)


def _scattered(measured: Measured) -> Iterator[_Off | None]:
    """By samples at the same place; else by neighbours."""
    where: _Where | None = None
    for row in range(len(measured)):
        own = row if measured.pairs.shape[0] > 1 else 0
        index = ((measured.weight[row, :, 0] > 0) & measured.pairs.above_horizon[own]).nonzero()[:, 0]
        if len(index) < LEAST:
            yield None
            continue
        if where is None or where.row != own or not torch.equal(where.index, index):
            where = _Where(measured.pairs, own, index)
        values = measured.values[row, index].double().cpu().numpy()
        same = _same_place(where, values)
        # Where they are equal but for rounding, somebody made them so.
        if same is not None and np.median(np.abs(same.off) / np.maximum(np.abs(same.values), _TINY)) > _ROUNDING:
            yield same
        else:
            yield _neighbours(where, values)


class _Where:
    """Where samples are, those of `index` of one row of pairs, and which of them are to be compared with each other."""

    def __init__(self, pairs: Pairs, row: int, index: Tensor) -> None:
        self.row, self.index = row, index
        self.angles = Angles.of(pairs.select(samples=index), row)

    @cached_property
    def same(self) -> tuple[np.ndarray, np.ndarray]:
        """The place of each sample, and how many are there."""
        cell = np.round(self.angles.turned() / _SAME).astype(np.int64)
        _, own, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
        return own.reshape(-1), count

    @cached_property
    def places(self) -> Places:
        """For a surface through all of them."""
        return Places(self.angles)

    @cached_property
    def planes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Places `(n,)`, their neighbours `(n, k)`, and what these count in the planes through them, `(n, k)`."""
        places = self.places
        points = np.stack([places.mean(axis) for axis in self.angles.places().T], -1)
        if len(points) <= _NEIGHBOURS:
            return None
        some = np.unique(np.linspace(0, len(points) - 1, min(len(points), MOST)).astype(np.int64))
        distance, index = tree_of(points).query(points[some], _NEIGHBOURS + 1)
        index, reach = index[:, 1:], distance[:, -1:, None]
        step = (points[index] - points[some][:, None]) / np.maximum(reach, 1e-12)
        plane = np.concatenate([np.ones_like(step[..., :1]), step], -1)
        share = np.linalg.pinv(plane, rcond=1e-2)[:, 0]
        steady = np.square(share).sum(1) < _STEADY
        return None if steady.sum() < LEAST else (some[steady], index[steady], share[steady])


def _same_place(where: _Where, values: np.ndarray) -> _Off | None:
    """What samples are off from the mean of those at the same place."""
    own, count = where.same
    several = count[own] > 1
    if several.sum() < LEAST:
        return None
    mean = np.stack([np.bincount(own, channel) / count for channel in values.T], -1)[own]
    spread = np.sqrt(count / np.maximum(count - 1, 1))[own, None]
    return _Off(((values - mean) * spread)[several], mean[several], "samples that ought to be equal")


def _neighbours(where: _Where, values: np.ndarray) -> _Off | None:
    """What samples are off from a plane through their neighbours, beside a smooth surface through all."""
    if where.planes is None:
        return None
    some, index, share = where.planes
    surface = Surface(where.places, values)
    off = surface.rest[some] - np.einsum("nk,nkc->nc", share, surface.rest[index])
    off /= np.sqrt(1 + np.square(share).sum(1, keepdims=True))
    mean = surface.mean[some]
    return _Off(off * np.sqrt(np.square(mean) + 4 * surface.scale**2), mean, "neighbours, at most")


def _in_table(measured: Measured) -> _Off | None:
    """What values of a table are off from the mean of those before and behind, where these are near."""
    count = len(measured.pairs)
    middle = torch.linspace(1, count - 2, MOST, dtype=torch.float64, device="cpu").long()
    places = torch.stack([middle - 1, middle, middle + 1], 1)
    part = measured.batch(samples=places.flatten())
    values = part.values[0].double().cpu().unflatten(0, (-1, 3)).numpy()
    valid = (part.weight[0, :, 0] > 0).cpu().unflatten(0, (-1, 3)).all(1).numpy()
    turned = Angles.of(part.pairs.select([0]), 0).turned().reshape(-1, 3, 3)
    near = (np.abs(np.diff(turned, axis=1)).max((1, 2)) < _NEAR_IN_TABLE) & valid
    if near.sum() < LEAST:
        return None
    off = (values[:, 1] - (values[:, 0] + values[:, 2]) / 2) / np.sqrt(1.5)
    return _Off(off[near], values[near, 1], "neighbours in the table, at most")
