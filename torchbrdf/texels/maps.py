"""Maps of a surface: of every texel its parameters, its error, and how its fit ended."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import torch

from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import component_names, with_parameters
from torchbrdf.registry import unknown
from torchbrdf.texels.solve import Maps, map_names, map_sizes
from torchbrdf.texels.status import TexelStatus
from torchbrdf.texels.tiling import Tile, Tiling

Array = np.ndarray
STATUS = "status"
REFLECTANCE = "reflectance"
"""The map that follows from others: a lobe's colour times its f0, what it reflects at normal incidence."""


class TexelMaps:
    """What was fitted to every texel: `maps["roughness"]` is a map, `(H, W, 1)`.

    There is a map of each parameter, named as the lobe names it, with a number behind where several lobes have it;
    "error", in the loss's units; "status", see `TexelStatus`; and "reflectance" of a lobe with `f0`, its colour times
    that: with one view the two are hardly known apart, and their product is. Parameters are NaN where nothing could be
    fitted.

    Args:
        model: that was fitted; its own parameters are where fits began.
        tiling: of the surface.
        get: gives the maps of a tile; None of one that is not there.
        failed: why a tile is not there, by its name.

    Example:
        >>> from torchbrdf.texels import synthetic_surface
        >>> surface = synthetic_surface(16)
        >>> surface.maps["albedo"].shape
        (16, 16, 3)
    """

    def __init__(
        self,
        model: Lobe,
        tiling: Tiling,
        get: Callable[[Tile], Maps | None],
        failed: Mapping[str, str] | None = None,
    ) -> None:
        self.model, self.tiling, self.failed = model, tiling, dict(failed or {})
        self._get = get
        self._kept: tuple[str, Maps | None] = ("", None)  # several maps are asked for of one tile
        self._sizes = map_sizes(model)
        self._derived = _reflectances(model)

    @classmethod
    def of_arrays(cls, model: Lobe, arrays: Maps) -> "TexelMaps":
        """Maps that are there as a whole, `(H, W, ...)` each; without errors these are 0."""
        h, w = next(iter(arrays.values())).shape[:2]
        sizes = map_sizes(model)
        whole = {name: np.zeros((h, w, sizes[name]), np.uint8 if name == STATUS else np.float32) for name in sizes}
        for name, values in arrays.items():
            whole[name][...] = values
        return cls(model, Tiling((h, w), 64), lambda t: {k: v[t.rows, t.columns] for k, v in whole.items()})

    @property
    def size(self) -> tuple[int, int]:
        """H and W."""
        return self.tiling.size

    @property
    def names(self) -> list[str]:
        """Of all maps."""
        return [*self._sizes, *self._derived]

    def channels(self, name: str) -> int:
        """How many numbers a texel of a map has."""
        if name in self._derived:
            return self._sizes[self._derived[name][0]]
        if name not in self._sizes:
            raise unknown("map", name, self.names)
        return self._sizes[name]

    def __getitem__(self, name: str) -> Array:
        channels = self.channels(name)
        found = np.empty((*self.size, channels), np.uint8 if name == STATUS else np.float32)
        for tile in self.tiling:
            found[tile.rows, tile.columns] = self.tile(name, tile)
        return found

    def tile(self, name: str, tile: Tile) -> Array:
        """A map of one tile, `(h, w, channels)`."""
        if self._kept[0] != tile.name:
            self._kept = (tile.name, self._get(tile))
        there = self._kept[1]
        if there is None:
            nothing = TexelStatus.FAILED if name == STATUS else np.nan
            return np.full((*tile.shape, self.channels(name)), nothing, np.uint8 if name == STATUS else np.float32)
        if name in self._derived:
            color, f0 = self._derived[name]
            return there[color] * there[f0]
        return there[name]

    def counts(self) -> dict[str, int]:
        """How many texels ended how, by the status' name, the most frequent first."""
        found: Counter[str] = Counter()
        for tile in self.tiling:
            numbers = np.bincount(self.tile(STATUS, tile).ravel(), minlength=len(TexelStatus)).tolist()
            found.update({one.name: numbers[one] for one in TexelStatus if numbers[one]})
        return dict(found.most_common())

    def region(self, name: str, rows: slice, columns: slice) -> Array:
        """A part of a map, `(h, w, channels)`."""
        part = Tile(0, 0, rows, columns)
        found = np.empty((*part.shape, self.channels(name)), np.uint8 if name == STATUS else np.float32)
        for tile in self.tiling.meeting(part):
            both = tile.common(part)
            inner, outer = both.within(tile), both.within(part)
            found[outer] = self.tile(name, tile)[inner]
        return found

    def model_of(self, rows: slice, columns: slice) -> Lobe:
        """The fitted model of a part, batched, a material for each texel, row after row."""
        parts = {full: self.region(name, rows, columns) for full, name in map_names(self.model).items()}
        values = {full: torch.from_numpy(part.reshape(-1, part.shape[-1])) for full, part in parts.items()}
        count = len(next(iter(values.values())))
        return with_parameters(self.model.batched(count), values)


def _reflectances(model: Lobe) -> dict[str, tuple[str, str]]:
    """The maps that follow from two others, which are a lobe's colour and its f0."""
    names = map_names(model)
    found = {}
    for own in _own_names(model):
        if "f0" in own[1] and own[0] is not None:
            number = names[own[1]["f0"]].removeprefix("f0")
            found[REFLECTANCE + number] = (names[own[0]], names[own[1]["f0"]])
    return found


def _own_names(model: Lobe) -> Iterator[tuple[str | None, dict[str, str]]]:
    """Of each lobe the full name of its colour, if it is one times a scalar function, and of all its parameters."""
    for lobe, own in zip(model.components(), component_names(model), strict=True):
        color = lobe.albedo_spec()
        yield (None if color is None else own[color.name]), own
