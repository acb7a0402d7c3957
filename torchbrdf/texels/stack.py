"""A photometric stack: what was seen of every texel under each light, read tile by tile."""

import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError, ShapeError, shown
from torchbrdf.pairs import Pairs
from torchbrdf.reading import reading
from torchbrdf.texels.tiling import Tile

log = logging.getLogger("torchbrdf")

Array = np.ndarray
# Texels of each side at which a stack is known again.
PROBES = 4


class Sliceable(Protocol):
    """An array that may be anywhere: of numpy, memory-mapped, of zarr or h5py, a tensor."""

    @property
    def shape(self) -> Any:
        """Of all of it."""
        ...

    def __getitem__(self, index: Any) -> Any: ...


Reader = Callable[[slice, slice], Any]
"""A function of rows and columns that gives that part of an array."""


@dataclass(frozen=True)
class Field:
    """An array over a surface, of which parts are read: `(*lead, H, W, *last)`.

    Args:
        name: what to call it.
        values: the array, or a function of rows and columns.
        lead: dimensions before the rows; columns of tail: what may come after the columns.
        size: H and W.
        tails: the dimensions that may come after them.
    """

    name: str
    values: Sliceable | Reader
    lead: tuple[int, ...]
    size: tuple[int, int]
    tails: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        if not callable(self.values):
            self._check(tuple(self.values.shape), self.size)

    def read(self, rows: slice, columns: slice) -> Array:
        """A part, float32.

        Raises:
            DataError: It cannot be read, or a function gives another shape.
        """
        size = (rows.stop - rows.start, columns.stop - columns.start)
        with reading(f"{self.name}[{rows.start}:{rows.stop}, {columns.start}:{columns.stop}]", "numbers"):
            if not callable(self.values):
                found = self.values[(*[slice(None)] * len(self.lead), rows, columns)]
            else:
                found = self.values(rows, columns)
            found = found.detach().cpu().numpy() if isinstance(found, Tensor) else np.asarray(found)
            if found.dtype.kind not in "fiub":
                raise DataError(f"{self.name}: expected real numbers, found {found.dtype}")
            self._check(found.shape, size)
            with np.errstate(over="ignore"):  # beyond float32 it is infinite, which does not count
                return np.ascontiguousarray(found, dtype=np.float32)

    def _check(self, shape: tuple[int, ...], size: tuple[int, int]) -> None:
        if shape not in [(*self.lead, *size, *tail) for tail in self.tails]:
            raise ShapeError(f"{self.name}: expected {self._said(size)}, found {shape}")

    def _said(self, size: tuple[int, int]) -> str:
        return " or ".join(str((*self.lead, *size, *tail)) for tail in self.tails)


@dataclass(frozen=True)
class TileData:
    """What was seen of h x w texels under n lights.

    observations: `(n, h, w, 3)`; weights: `(n, h, w)` or with 1 or 3 channels, or None; normals: `(h, w, 3)` or None;
    lights, views: `(n, 3)`, or `(n, h, w, 3)`.
    """

    observations: Array
    weights: Array | None
    normals: Array | None
    lights: Array
    views: Array

    @property
    def shape(self) -> tuple[int, int]:
        """h and w."""
        return self.observations.shape[1:3]


class Stack:
    """Observations of a surface of H x W texels under n lights.

    Args:
        observations: `(n, H, W, 3)`: `fit_texels` says what.
        lights: directions `(n, 3)` or `(n, H, W, 3)`; or pairs `(n,)`.
        views: the same, or `(3,)`; None with pairs.
        normals: `(H, W, 3)`, or None.
        weights: `(n, H, W)`, or with 1 or 3 channels, or None.
        size: H and W, where observations are a function.

    Raises:
        ShapeError: Something has another shape, or a direction is none.
        DataError: No light is above the horizon.
    """

    def __init__(
        self,
        observations: Sliceable | Reader,
        lights: Any,
        views: Any,
        normals: Sliceable | Reader | None,
        weights: Sliceable | Reader | None,
        size: tuple[int, int] | None,
    ) -> None:
        self.pairs = lights if isinstance(lights, Pairs) else None
        observations, normals, weights = (_array(one) for one in (observations, normals, weights))
        lights = _array(lights) if self.pairs is None else self.pairs
        self.count = len(lights) if self.pairs is not None else lights.shape[0] if lights.shape else 0
        self.size = _size(observations, size, self.count)
        self.observations = Field("observations", observations, (self.count,), self.size, ((3,),))
        self.normals = None if normals is None else Field("normals", normals, (), self.size, ((3,),))
        tails = ((), (1,), (3,))
        self.weights = None if weights is None else Field("weights", weights, (self.count,), self.size, tails)
        self.lights: Array | Field = _NOWHERE
        self.views: Array | Field = _NOWHERE
        if self.pairs is None:
            self.lights = self._directions("lights", lights)
            self.views = self._directions("views", _array(views))
            self._check_horizon()
        elif self.pairs.shape != (self.count,) or normals is not None:
            found = "normals, too" if normals is not None else f"{(*self.pairs.shape,)}"
            raise ShapeError(f"lights: expected pairs (n,) without normals, as they are of the surface, found {found}")

    def read(self, tile: Tile) -> TileData:
        """What was seen of a tile.

        Raises:
            DataError: It cannot be read.
        """

        def part(field: Field | None) -> Array | None:
            return None if field is None else field.read(tile.rows, tile.columns)

        observations = part(self.observations)
        lights, views = (one if isinstance(one, Array) else part(one) for one in (self.lights, self.views))
        assert observations is not None
        assert lights is not None
        assert views is not None
        return TileData(observations, part(self.weights), part(self.normals), lights, views)

    def digest(self) -> str:
        """What tells a stack from others: its values at some texels, and its directions."""
        found = hashlib.sha256()
        places = [np.unique(np.linspace(0, side - 1, PROBES).round().astype(int)) for side in self.size]
        fields = [self.observations, self.normals, self.weights, self.lights, self.views]
        for field in fields:
            if isinstance(field, Array):
                found.update(field.tobytes())
            elif field is not None:
                for row in places[0].tolist():
                    for column in places[1].tolist():
                        try:
                            values = field.read(slice(row, row + 1), slice(column, column + 1)).tobytes()
                        except DataError:  # the tile's own fit says so
                            values = b"?"
                        found.update(values)
        if self.pairs is not None:
            found.update(self.pairs.cos_i.double().cpu().numpy().tobytes())
            found.update(self.pairs.cos_o.double().cpu().numpy().tobytes())
        return found.hexdigest()[:16]

    def _directions(self, name: str, values: Any) -> "Array | Field":
        """Directions that all texels share, `(n, 3)`, of length 1; or those of each."""
        if len(values.shape) == 4:
            return Field(name, values, (self.count,), self.size, ((3,),))
        shared = ((self.count, 3),) if name == "lights" else ((self.count, 3), (3,))
        if tuple(values.shape) not in shared:
            expected = " or ".join(map(str, (*shared, (self.count, *self.size, 3))))
            raise ShapeError(f"{name}: expected {expected}, found {(*values.shape,)}")
        found = np.broadcast_to(np.asarray(values, dtype=np.float64), (self.count, 3))
        length = np.linalg.norm(found, axis=-1, keepdims=True)
        bad = np.flatnonzero(~(np.isfinite(length[:, 0]) & (length[:, 0] > 0)))
        if len(bad):
            raise ShapeError(f"{name}[{bad[0]}]: expected a direction, found {shown(found[bad[0]].tolist())}")
        return (found / length).astype(np.float32)

    def _check_horizon(self) -> None:
        """Say which lights, or views, are below the horizon of a surface that faces +z; refuse all of them."""
        if self.normals is not None:
            return
        for name, values in (("lights", self.lights), ("views", self.views)):
            if not isinstance(values, Array):
                continue
            below = np.flatnonzero(values[:, 2] <= 0)
            said = f"expected directions above the horizon, z > 0, found {len(below)} of {len(values)} below"
            if len(below) == len(values):
                raise DataError(f"{name}: {said}; directions point away from the surface")
            if len(below):
                log.warning("torchbrdf: %s: %s, the first is %d; they do not count", name, said, below[0])


_NOWHERE = np.zeros((0, 3), np.float32)


def _array(values: Any) -> Any:
    """What has a shape, and functions, as they are; lists and tensors as arrays."""
    if isinstance(values, Tensor):
        return values.detach().cpu().numpy()
    if values is None or hasattr(values, "shape") or callable(values):
        return values
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ShapeError(f"texels: expected an array of numbers, or a function, found {shown(values)}") from None


def _size(observations: Any, size: tuple[int, int] | None, count: int) -> tuple[int, int]:
    """H and W."""
    if not count:
        raise ShapeError("lights: expected at least one direction (n, 3), found none")
    if not callable(observations):
        shape = tuple(observations.shape)
        if len(shape) != 4 or shape[0] != count or shape[3] != 3 or 0 in shape:
            raise ShapeError(f"observations: expected ({count}, H, W, 3), one for each light, found {shape}")
        if size is not None and tuple(size) != shape[1:3]:
            raise ShapeError(f"size: expected {shape[1:3]} of the observations, found {tuple(size)}")
        return shape[1], shape[2]
    if size is None or len(size) != 2 or not all(isinstance(side, int) and side > 0 for side in size):
        raise ShapeError(f"size: expected (H, W) of observations that are a function, found {shown(size)}")
    return size[0], size[1]


def local_directions(directions: Array, normals: Array) -> Tensor:
    """Directions in the surface's frame, whose z is the normal and whose x lies below the image's, `(M, n, 3)`.

    directions: `(n, 3)` or `(n, M, 3)`; normals: `(M, 3)` of length 1.
    """
    z = torch.from_numpy(normals)
    # Next to +x itself the image's y serves.
    axis = torch.zeros_like(z)
    steep = (z[:, 0].abs() > 0.999).long()
    axis.scatter_(1, steep[:, None], 1.0)
    x = axis - z * (axis * z).sum(-1, keepdim=True)
    x = x / x.norm(dim=-1, keepdim=True)
    frame = torch.stack([x, torch.linalg.cross(z, x), z], 1)
    given = torch.from_numpy(directions)
    if given.dim() == 2:
        return torch.einsum("mij,nj->mni", frame, given)
    return torch.einsum("mij,nmj->mni", frame, given)
