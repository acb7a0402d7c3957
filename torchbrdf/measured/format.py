"""What a file format is, and how its files are opened and its samples looked up."""

import hashlib
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from torchbrdf.errors import DataError
from torchbrdf.kinds import FORMATS as _FORMATS
from torchbrdf.measured.scattered import Angles, Near, Places, Surface, nearest, tree_of
from torchbrdf.pairs import Pairs
from torchbrdf.registry import Registry

if TYPE_CHECKING:
    from scipy.spatial import KDTree

Interpolation = Literal["linear", "nearest"]

# Pairs that are looked up at once, and materials whose samples are kept ready for it.
_CHUNK = 1 << 16
_KEPT = 128

FORMATS: Registry[type["BrdfFormat"]] = _FORMATS


class Lookup(NamedTuple):
    """Interpolated values, and how many of them had no valid neighbour.

    Attributes:
        values: BRDF values in 1/sr, `(M, N, C)`.
        filled: Of each material, how many pairs took the nearest valid value, `(M,)`, int64.
    """

    values: Tensor
    filled: Tensor


class BrdfFormat(ABC):
    """Base of file formats: the data of M materials, read from files. A format is a registered subclass.

    Attributes:
        format: The name of the format.
        suffixes: Those that no other kind of file has: a file so named that is not of the format is a bad one, and not
            one to pass over.
        is_text: Whether files are text; of a format that is not, a text is no bad file, whatever its suffix.
        names: Of the materials, M.
        paths: The file of each material.
        pairs: The directions of the data, float64 on the CPU, `(1, N)` shared or `(M, N)`.
        channels: How many numbers a value has, C: 3 of linear RGB, else one a band.
        wavelengths: Of the C bands, nm, growing; None of linear RGB, and where nobody knows them.
        stand_in: Whether the values come from a model that stands in for a measurement.
        on_merl_bins: Whether `pairs` are the centres of MERL's bins.
        is_sampled: Whether samples are measurements, whose noise can be told.
        is_reciprocal: Whether values are the same where light and viewer change places, by how they are stored or
            interpolated; by default where `at` is the one here.
        is_anisotropic: Whether values depend on how the surface is turned about its normal; a property where that
            depends on the files.
        settings: What a reader can be told that a file does not say, and the values of each, the default first.
        told: What it was told of them.
        one_a_file: Whether each file has one material, whose name `name_of` gives.
        is_joined: Whether `joined` reads no file again.

    A subclass gives `recognises`, `open` and `read`; and `at`, if it has a better way than between scattered samples.
    """

    format: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]] = ()
    is_text: ClassVar[bool] = True
    names: Sequence[str]
    paths: Sequence[Path]
    pairs: Pairs
    channels: int = 3
    wavelengths: tuple[float, ...] | None = None
    stand_in: bool = False
    on_merl_bins: ClassVar[bool] = False
    is_sampled: ClassVar[bool] = True
    is_reciprocal: ClassVar[bool] = False
    is_anisotropic: bool = False
    settings: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    told: Mapping[str, str] = MappingProxyType({})
    one_a_file: ClassVar[bool] = True
    is_joined: ClassVar[bool] = False

    def __init_subclass__(cls, **keywords: Any) -> None:
        """Values between scattered samples are reciprocal, and those of a way of its own need not be."""
        super().__init_subclass__(**keywords)
        if "is_reciprocal" not in cls.__dict__:
            cls.is_reciprocal = cls.at is BrdfFormat.at

    @classmethod
    @abstractmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether a file is of this format, by `head`, its first 64 bytes (and its size)."""

    @classmethod
    def hint(cls, path: Path, head: bytes) -> str:
        """What a file that no format knows lacks to be of this one, in words; "" where that is not to be told."""
        return ""

    @classmethod
    @abstractmethod
    def open(cls, paths: Sequence[Path]) -> "BrdfFormat":
        """Open files that `recognises` said yes to.

        Raises:
            DataError: Names the first file that is bad.
        """

    @classmethod
    def joined(cls, sources: "Sequence[BrdfFormat]") -> "BrdfFormat":
        """One source of several of one format, made with the same settings: by default their files are opened again.

        Args:
            sources: With a file each, one at least; where bands are kept, with the same.
        """
        if len(sources) == 1:
            return sources[0]
        paths, told = [path for one in sources for path in one.paths], sources[0].told
        return cls.open(paths, told) if told else cls.open(paths)  # type: ignore[call-arg]

    @classmethod
    def name_of(cls, path: Path) -> str:
        """The name that a file gives its material, without opening it."""
        return path.stem

    @abstractmethod
    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """The measured values of some materials at some of `pairs`.

        Args:
            materials: Indices of m materials.
            samples: Indices `(n,)` of pairs, or a slice of them.

        Returns:
            Values in 1/sr, `(m, n, C)`, and weights `(m, n, 1)`: 1 for valid samples, else 0 and the value 0.
        """

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values at any pairs, zero below the horizon: here those between scattered samples.

        Args:
            pairs: `(1, N)`, or `(m, N)` with pairs of each material's own; dtype and device of the values are theirs.
            materials: Indices of m materials.
            interpolation: "linear" or "nearest".

        Raises:
            DataError: A material has no valid sample.
        """
        values = pairs.cos_i.new_empty((len(materials), len(pairs), self.channels))
        for row, part, near, surface in self._looked_up(pairs, materials, 1 if interpolation == "nearest" else None):
            values[row, part] = torch.from_numpy(surface.at(near)).to(values)
        filled = [self._filled(pairs, row, material) for row, material in enumerate(materials)]
        return Lookup(
            torch.where(pairs.above_horizon[..., None], values, 0),
            torch.tensor(filled, dtype=torch.int64, device=pairs.device),
        )

    def _looked_up(
        self, pairs: Pairs, materials: list[int], neighbours: int | None
    ) -> Iterator[tuple[int, slice, Near, Surface]]:
        """For each part of the pairs and each material what it is made of; materials with the same samples share it."""
        for start in range(0, len(pairs), _CHUNK):
            part = slice(start, start + _CHUNK)
            found: tuple[Places, int, Near] | None = None
            for row, material in enumerate(materials):
                own = row if pairs.shape[0] > 1 else 0
                places, surface = self.surface(material)
                if found is None or found[0] is not places or found[1] != own:
                    angles = Angles.of(pairs.select(samples=part), own, places.has_grain)
                    found = places, own, places.near(angles, *([] if neighbours is None else [neighbours]))
                yield row, part, found[2], surface

    @property
    def is_scattered(self) -> bool:
        """Whether values are interpolated between samples without a grid: where `at` is the one here."""
        return type(self).at is BrdfFormat.at

    @property
    def _ready(self) -> "OrderedDict[object, Any]":
        """What was made of samples to look others up, the latest last."""
        found: OrderedDict[object, Any] = self.__dict__.setdefault("_made_ready", OrderedDict())
        return found

    def __getstate__(self) -> dict[str, object]:
        """Without what is made of the samples again."""
        return {name: value for name, value in self.__dict__.items() if name != "_made_ready"}

    def surface(self, material: int) -> tuple[Places, Surface]:
        """Where a material has valid samples, and its values there."""
        found: tuple[Places, Surface] | None = self._ready.get(material)
        if found is None:
            values, weight = (part[0].cpu().numpy() for part in self.read([material], slice(None)))
            valid = weight[:, 0] > 0
            if not valid.any():
                raise DataError(f"{self.names[material]}: expected valid samples, found none")
            places = self._places(material, valid)
            found = places, Surface(places, values[valid].astype(np.float64))
            self._keep(material, found)
        return found

    def _places(self, material: int, valid: np.ndarray) -> Places:
        """The places of valid samples: one for all materials that share pairs and validity."""
        row = material if self.pairs.shape[0] > 1 else 0
        grain = self.has_grain(material)
        key = (row, grain, hashlib.sha256(valid.tobytes()).digest())
        found: Places | None = self._ready.get(key)
        if found is None:
            found = Places(Angles.of(self.pairs.select(samples=torch.from_numpy(valid.nonzero()[0])), row, grain))
            self._keep(key, found)
        return found

    def _keep(self, key: object, thing: object) -> None:
        self._ready[key] = thing
        while len(self._ready) > _KEPT:
            self._ready.popitem(last=False)

    def _turned(self, material: int) -> "tuple[KDTree, np.ndarray]":
        """Where a material's samples above the horizon are, in degrees, and which of them are valid."""
        found: tuple[KDTree, np.ndarray] | None = self._ready.get(("turned", material))
        if found is None:
            row = material if self.pairs.shape[0] > 1 else 0
            above = self.pairs.above_horizon[row].cpu()
            own = self.pairs.select(samples=above.nonzero()[:, 0])
            samples = Angles.of(own, row, self.has_grain(material)).turned()
            valid = self.read([material], slice(None))[1][0, :, 0].cpu()[above].numpy() > 0
            found = tree_of(samples), valid
            self._keep(("turned", material), found)
        return found

    def _filled(self, pairs: Pairs, row: int, material: int) -> int:
        """How many pairs above the horizon have as their nearest sample one that is not valid."""
        tree, valid = self._turned(material)
        if valid.all():
            return 0
        own = row if pairs.shape[0] > 1 else 0
        _, sample = nearest(tree, Angles.of(pairs, own, self.has_grain(material)).turned())
        return int((pairs.above_horizon[own].cpu().numpy() & ~valid[sample]).sum())

    def distance_at(self, pairs: Pairs, materials: list[int]) -> Tensor:
        """How far pairs are from the nearest valid sample, `(m, N)`, degrees; 0 of what stands in for a measurement.

        Args:
            pairs: As of `at`.
            materials: Indices of m materials.
        """
        found = pairs.cos_i.new_zeros((len(materials), len(pairs)))
        if self.stand_in:
            return found
        for row, material in enumerate(materials):
            tree, valid = self._turned(material)
            if not valid.all():
                tree = tree_of(tree.data[valid])
            asked = Angles.of(pairs, row if pairs.shape[0] > 1 else 0, self.has_grain(material)).turned()
            found[row] = torch.from_numpy(nearest(tree, asked)[0]).to(found)
        return found

    def reading(self, material: int) -> dict[str, object]:
        """How the file of a material was read, by name: its format, and what was told, believed and made of it."""
        found: dict[str, object] = {"format": self.format}
        if material < len(self.paths):
            found["file"] = self.paths[material].name
        return found | ({"settings": dict(self.told)} if self.told else {})

    @property
    def may_be_anisotropic(self) -> bool:
        """Whether lobes with a grain can be fitted: also where samples that know azimuths look isotropic."""
        return self.is_anisotropic

    def has_grain(self, material: int) -> bool:
        """Whether one of the materials is anisotropic: by default each, where the source is."""
        return self.is_anisotropic

    def details(self, material: int) -> dict[str, object]:
        """What only this format can say about one of its materials, by name."""
        return {}


def padded_pairs(wi: list[Tensor], wo: list[Tensor]) -> Pairs:
    """The pairs of M materials with different numbers of them, `(M, N)`, filled up with some below the horizon.

    These count as nothing that was measured or is missing.

    Args:
        wi: Unit vectors to the light, `(n, 3)` of each material.
        wo: Those to the viewer.
    """
    toward, seen = (pad_sequence(part, batch_first=True) for part in (wi, wo))
    padding = toward.square().sum(-1) == 0
    toward[..., 2] += padding
    seen[..., 0] += 0.8 * padding
    seen[..., 2] -= 0.6 * padding
    return Pairs.from_directions(toward, seen)


def reopened(source: BrdfFormat, settings: Mapping[str, str] | None = None) -> tuple[Any, ...]:
    """How a format is pickled, for `__reduce__`: its files are opened again, and once, where it is unpickled.

    Args:
        source: The format, made of paths and, if any were given, of settings.
        settings: What its reader was told.
    """
    paths = tuple(path.absolute() for path in source.paths)
    stamps = tuple((status.st_mtime_ns, status.st_size) for status in map(Path.stat, paths))
    return _opened_again, (type(source), paths, stamps, tuple((settings or {}).items()))


@lru_cache(2)
def _opened_again(
    kind: Any, paths: tuple[Path, ...], stamps: tuple[tuple[int, int], ...], settings: tuple[tuple[str, str], ...]
) -> BrdfFormat:
    found: BrdfFormat = kind(paths, dict(settings)) if settings else kind(paths)
    return found
