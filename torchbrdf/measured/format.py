"""What a file format is, and how its files are opened and its samples looked up."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.kinds import FORMATS as _FORMATS
from torchbrdf.pairs import Pairs
from torchbrdf.registry import Registry

Interpolation = Literal["linear", "nearest"]


FORMATS: Registry[type["BrdfFormat"]] = _FORMATS


class Lookup(NamedTuple):
    """Interpolated values, and how many of them had no valid neighbour.

    Attributes:
        values: BRDF values in 1/sr, `(M, N, 3)`.
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
        names: Of the materials, M.
        paths: The file of each material.
        pairs: The directions of the data, float64 on the CPU, `(1, N)` shared or `(M, N)`.
        stand_in: Whether the values come from a model that stands in for a measurement.
        on_merl_bins: Whether `pairs` are the centres of MERL's bins.
        is_reciprocal: Whether values are the same where light and viewer change places, by how they are stored.

    A subclass gives `recognises`, `open` and `read`; and `at`, if it can do better than the nearest sample.
    """

    format: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]] = ()
    names: Sequence[str]
    paths: Sequence[Path]
    pairs: Pairs
    stand_in: bool = False
    on_merl_bins: ClassVar[bool] = False
    is_reciprocal: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether a file is of this format, by `head`, its first 64 bytes (and its size)."""

    @classmethod
    @abstractmethod
    def open(cls, paths: Sequence[Path]) -> "BrdfFormat":
        """Open files that `recognises` said yes to.

        Raises:
            DataError: Names the first file that is bad.
        """

    @abstractmethod
    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """The measured values of some materials at some of `pairs`.

        Args:
            materials: Indices of m materials.
            samples: Indices `(n,)` of pairs, or a slice of them.

        Returns:
            Values in 1/sr, `(m, n, 3)`, and weights `(m, n, 1)`: 1 for valid samples, else 0 and the value 0.
        """

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values at any pairs, zero below the horizon: here those of the nearest valid sample.

        Args:
            pairs: `(1, N)`, or `(m, N)` with pairs of each material's own; dtype and device of the values are theirs.
            materials: Indices of m materials.
            interpolation: "linear" or "nearest".
        """
        return nearest_samples(self, pairs, materials)

    def details(self, material: int) -> dict[str, object]:
        """What only this format can say about one of its materials, by name."""
        return {}


def reopened(source: BrdfFormat) -> tuple[Any, ...]:
    """How a format is pickled, for `__reduce__`: its files are opened again, and once, where it is unpickled."""
    paths = tuple(path.absolute() for path in source.paths)
    stamps = tuple((status.st_mtime_ns, status.st_size) for status in map(Path.stat, paths))
    return _opened_again, (type(source), paths, stamps)


@lru_cache(2)
def _opened_again(kind: Any, paths: tuple[Path, ...], stamps: tuple[tuple[int, int], ...]) -> BrdfFormat:
    found: BrdfFormat = kind(paths)
    return found


def nearest_samples(source: BrdfFormat, pairs: Pairs, materials: list[int]) -> Lookup:
    """The values of the nearest valid samples, of isotropic materials.

    Args:
        source: where values are read.
        pairs: where they are wanted, `(1, n)` or `(m, n)`.
        materials: m of the source's materials.

    Returns:
        Values `(m, n, 3)`, zero below the horizon; those whose nearest sample was not valid are counted as filled.

    Raises:
        DataError: a material has no valid sample.
    """
    from scipy.spatial import KDTree

    own, asked = _coordinates(source.pairs), _coordinates(pairs)
    above = pairs.above_horizon.cpu()
    found, filled = [], []
    for row, material in enumerate(materials):
        values, weight = (part[0] for part in source.read([material], slice(None)))
        valid = weight[:, 0] > 0
        if not valid.any():
            raise DataError(f"{source.names[material]}: expected valid samples, found none")
        points, wanted = own[material if len(own) > 1 else 0], asked[row if len(asked) > 1 else 0]
        _, index = KDTree(points[valid]).query(wanted)
        found.append(values[valid][torch.from_numpy(index)])
        missed = torch.zeros(len(wanted), dtype=torch.bool, device="cpu")
        if not valid.all():
            _, nearest = KDTree(points).query(wanted)
            missed = ~valid[torch.from_numpy(nearest)]
        filled.append((missed & above[row if len(above) > 1 else 0]).sum())
    values = torch.stack(found).to(pairs.device, pairs.dtype)
    return Lookup(torch.where(pairs.above_horizon[..., None], values, 0), torch.stack(filled))


def _coordinates(pairs: Pairs) -> Tensor:
    """Where pairs `(m, n)` lie, `(m, n, 4)`, radians apart; phi_d and phi_d + pi are the same by reciprocity."""
    theta_d, turn = pairs.theta_d.double().cpu(), 2 * pairs.phi_d.double().cpu()
    around = torch.sin(theta_d) / 2
    return torch.stack([pairs.theta_h.double().cpu(), theta_d, around * turn.cos(), around * turn.sin()], -1)
