"""A measured BRDF: values on Pairs, read from their source in the parts that are asked for."""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Self, get_args
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.measured.format import FORMATS, BrdfFormat, Interpolation, Lookup, reopened
from torchbrdf.measured.in_bands import InBands
from torchbrdf.measured.samples import Samples, check_given, row_of, samples_of
from torchbrdf.pairs import Pairs, check_max_theta
from torchbrdf.registry import unknown

__all__ = ["FORMATS", "BrdfFormat", "Interpolation", "Lookup", "Measured", "Samples", "reopened"]


FAR = 12.0
"""Degrees from the nearest sample up to which a reading counts as measured: instruments take steps of up to 20."""


def reading_45_0() -> Pairs:
    """The 45:0 reading, `(1, 1)`: light at 45 degrees, viewer at the normal."""
    angle = torch.full((1, 1), math.pi / 8, dtype=torch.float64, device="cpu")
    return Pairs.from_half_diff(angle, angle, torch.zeros_like(angle), torch.zeros_like(angle))


# The samples of shared pairs that were asked for last, with device and dtype, the last ones first.
_LAST: WeakKeyDictionary[Pairs, list[tuple[tuple[torch.device, torch.dtype], Tensor | None, Pairs]]] = (
    WeakKeyDictionary()
)
_SELECTIONS = 3


def _same(one: Tensor | None, other: Tensor | None) -> bool:
    return one is other or (one is not None and other is not None and torch.equal(one, other))


class Measured(InBands):
    """Measured BRDFs of M materials on N pairs of directions, from `load` or from `from_samples`.

    `pairs` are the directions, `values` `(M, N, C)` the BRDF in 1/sr without the cosine, in linear RGB (C is 3) or in
    bands, whose `wavelengths` are given where they are known; and `weight` `(M, N, 1)` is 1
    for valid samples; invalid ones have weight 0 and value 0. Tables are big: values and weights are read at first
    use, and `batch` gives a part that reads only its own.

    Args:
        source: What reads the values.
        materials: Indices of M of the source's materials; by default all.
        samples: Indices `(N,)` of the source's pairs; by default all.
        max_theta: Samples with a direction farther than this from the normal, in degrees, have weight 0.
        dtype: Of pairs, values and weights; by default torch's default dtype.
        device: Of pairs, values and weights; by default the CPU.

    Example:
        >>> from torchbrdf.measured import load, standins
        >>> measured = load(standins()).batch([5, 0])
        >>> measured
        Measured(fits: light-red-paint, alum-bronze; 2 materials, 1096216 pairs)
        >>> len(measured.within(80).pairs)
        909696
    """

    def __init__(
        self,
        source: BrdfFormat,
        materials: Sequence[int] | None = None,
        samples: Tensor | None = None,
        max_theta: float = 90.0,
        dtype: torch.dtype | None = None,
        device: torch.device | str | None = None,
    ) -> None:
        self.source = source
        self.materials = list(range(len(source.names))) if materials is None else list(materials)
        self.samples = samples
        self.max_theta = max_theta
        self.dtype = dtype or torch.get_default_dtype()
        self.device = torch.device(device or "cpu")
        self._whole: tuple[tuple[Tensor, Tensor], list[int], Tensor] | None = None

    @classmethod
    def from_samples(
        cls,
        pairs: Pairs,
        values: Tensor,
        weight: Tensor | None = None,
        names: Sequence[str] | None = None,
        wavelengths: Sequence[float] | None = None,
        anisotropic: bool | None = None,
    ) -> "Measured":
        """Measured BRDFs from tensors.

        Args:
            pairs: Where the values were measured, `(N,)`, `(1, N)` or `(M, N)`.
            values: In 1/sr without the cosine, `(M, N, C)`: linear RGB, or bands; samples that are not finite or below
                the horizon get weight 0.
            weight: How much each sample counts, which broadcasts to `(M, N, 1)`; by default 1.
            names: Of the M materials.
            wavelengths: Of the C bands, nm, growing; None: linear RGB where C is 3, else unknown.
            anisotropic: Whether values depend on how the surface is turned; by default found by the values, where the
                pairs are directions with the light in more than one plane through the normal.

        Raises:
            UsageError: `pairs` are none.
            ShapeError: The shapes do not fit together, directions are no unit vectors, wavelengths do not grow, or
                pairs without directions are said to be of anisotropic materials.
            DataError: A name is none; or no value at all is finite and above the horizon.

        Example:
            >>> angle = torch.tensor([[0.1, 0.2]])
            >>> measured = Measured.from_samples(Pairs.from_half_diff(angle, angle, angle), torch.ones(1, 2, 3))
            >>> measured.weight[0, :, 0]
            tensor([1., 1.])
        """
        check_given(pairs, values)
        source = Samples(pairs, values, weight, names, wavelengths, anisotropic)
        return cls(source, dtype=values.dtype, device=values.device)

    @property
    def names(self) -> list[str]:
        """Names of the materials."""
        return [self.source.names[k] for k in self.materials]

    @property
    def stand_in(self) -> bool:
        """Whether the values come from a model that stands in for a measurement."""
        return self.source.stand_in

    @property
    def on_merl_bins(self) -> bool:
        """Whether the pairs are the centres of MERL's bins, which are the denser the nearer theta_h is to 0."""
        return self.source.on_merl_bins

    @property
    def is_anisotropic(self) -> bool:
        """Whether values depend on how the surface is turned about its normal: on the azimuths of both directions."""
        return self.source.is_anisotropic and any(map(self.source.has_grain, self.materials))

    @property
    def may_be_anisotropic(self) -> bool:
        """Whether lobes with a grain can be fitted: the pairs tell how the surface is turned."""
        return self.source.may_be_anisotropic

    def __len__(self) -> int:
        return len(self.materials)

    def __repr__(self) -> str:
        shown = ", ".join(self.names[:3]) + (", ..." if len(self) > 3 else "")
        return f"Measured({self.source.format}: {shown}; {len(self)} materials, {len(self.pairs)} pairs)"

    def _view(self, **changes: object) -> Self:
        names = ("source", "materials", "samples", "max_theta", "dtype", "device")
        return type(self)(**{name: getattr(self, name) for name in names} | changes)

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> "Measured":
        """The same materials on another device or in another dtype; None leaves either as it is."""
        if torch.device(device or self.device) == self.device and (dtype or self.dtype) == self.dtype:
            return self
        return self._view(device=device or self.device, dtype=dtype or self.dtype)

    def batch(self, materials: Sequence[int] | None = None, samples: Tensor | None = None) -> "Measured":
        """Some of these materials, and some of these samples.

        Args:
            materials: Indices into these materials; by default all.
            samples: Indices `(n,)` into these samples, or of each whether it is meant, `(N,)`; by default all.

        Raises:
            UsageError: There is no such material or sample.
        """
        rows = list(range(len(self))) if materials is None else [row_of(k, len(self)) for k in materials]
        own = self.samples
        if samples is not None:
            samples = samples_of(samples, len(self.source.pairs) if own is None else len(own))
            own = samples if own is None else own[samples.to(own.device)]
        found = self._view(materials=[self.materials[k] for k in rows], samples=own)
        found._take_data(self, rows, samples)
        return found

    def _take_data(self, other: "Measured", rows: list[int], samples: Tensor | None) -> None:
        """What another has read need not be read again: a view where these rows of it are one slice of all samples."""
        if "_data" not in other.__dict__ and other._whole is None:
            return
        if samples is not None:
            self._whole = other._data, rows, samples
        elif rows and rows == list(range(rows[0], rows[-1] + 1)):
            values, weight = other._data
            self._data = values[rows[0] : rows[-1] + 1], weight[rows[0] : rows[-1] + 1]

    def within(self, max_theta: float) -> "Measured":
        """The same materials without directions near the horizon.

        Shared pairs beyond are left out; where every material has its own, they get weight 0.

        Args:
            max_theta: How far both directions may be from the normal, in degrees, above 0 and at most 90.

        Raises:
            ShapeError: The angle is out of range.
        """
        check_max_theta(max_theta)
        pairs = self.source.pairs
        if max_theta >= self.max_theta and (self.max_theta >= 90 or self.samples is not None or pairs.shape[0] > 1):
            return self  # with what it has read
        limited = self._view(max_theta=min(max_theta, self.max_theta))
        if max_theta < 90 and pairs.shape[0] == 1:
            keep = self._low(pairs, max_theta)[0]
            keep = keep if self.samples is None else keep[self.samples.cpu()]
            samples = keep.nonzero()[:, 0]
            limited.samples = samples if self.samples is None else self.samples.cpu()[samples]
            limited._take_data(self, list(range(len(self))), samples)
        return limited

    @staticmethod
    def _low(pairs: Pairs, max_theta: float) -> Tensor:
        lowest = math.cos(math.radians(max_theta)) - 1e-12
        return (pairs.cos_i >= lowest) & (pairs.cos_o >= lowest)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled without what can be read again, and of values in memory with those of these materials only."""
        source, materials = self.source, self.materials
        if isinstance(source, Samples) and source.pairs.shape[0] == 1:
            source, materials = source.select(materials), list(range(len(materials)))
        return Measured, (source, materials, self.samples, self.max_theta, self.dtype, self.device)

    @cached_property
    def pairs(self) -> Pairs:
        """Directions of the samples, `(1, N)` shared by all materials or `(M, N)`."""
        source = self.source.pairs
        if source.shape[0] > 1:
            return source.select(self.materials, self.samples).to(self.device, self.dtype)
        # Batches of a database have the same again and again, with what lobes and fits made of them.
        key, last = (self.device, self.dtype), _LAST.get(source, [])
        known = next((one for one in last if one[0] == key and _same(one[1], self.samples)), None)
        known = known or (key, self.samples, source.select(samples=self.samples).to(self.device, self.dtype))
        _LAST[source] = [known, *(one for one in last if one is not known)][:_SELECTIONS]
        return known[2]

    @cached_property
    def _data(self) -> tuple[Tensor, Tensor]:
        if self._whole is not None:
            known, rows, index = self._whole
            self._whole = None  # and with it what others have read
            values, weight = (one[rows] if rows != list(range(len(one))) else one for one in known)
            index = index.to(self.device)
            return values.index_select(1, index), weight.index_select(1, index)
        samples = slice(None) if self.samples is None else self.samples.cpu()
        shape = (len(self), len(self.source.pairs if self.samples is None else self.samples))
        values = torch.empty(*shape, self.channels, dtype=self.dtype, device=self.device)
        weight = torch.empty(*shape, 1, dtype=self.dtype, device=self.device)
        for row, material in enumerate(self.materials):  # one at a time, so that only one is ever held in float64
            read = self.source.read([material], samples)
            for part, found, expected in zip(("values", "weights"), read, (values, weight), strict=True):
                if found.shape != (1, *expected.shape[1:]):
                    where = f"{type(self.source).__name__}.read: {self.source.names[material]}: {part}"
                    raise ShapeError(f"{where}: expected {(1, *expected.shape[1:])}, found {(*found.shape,)}")
                expected[row] = found[0]
        if self.max_theta < 90 and self.source.pairs.shape[0] > 1:
            high = ~self._low(self.source.pairs.select(self.materials, self.samples), self.max_theta).to(self.device)
            values.masked_fill_(high[..., None], 0)
            weight.masked_fill_(high[..., None], 0)
        return values, weight

    @property
    def values(self) -> Tensor:
        """BRDF values in 1/sr, `(M, N, C)`."""
        return self._data[0]

    @property
    def weight(self) -> Tensor:
        """Weight of each sample: 1 where it is valid, else 0, `(M, N, 1)`."""
        return self._data[1]

    def at(self, pairs: Pairs, interpolation: Interpolation = "linear") -> Tensor:
        """Interpolated values at any pairs.

        Args:
            pairs: `(N,)`, `(1, N)`, or `(M, N)` with pairs of each material's own.
            interpolation: "linear" or "nearest".

        Returns:
            Values in 1/sr, `(M, N, C)`, zero below the horizon; dtype and device are the pairs'.

        Raises:
            ShapeError: The pairs fit neither one nor all materials.
            UsageError: There is no such interpolation.
            DataError: A material has no valid sample.

        Example:
            >>> from torchbrdf.measured import load, standins
            >>> angle = torch.tensor([0.0, 0.5])
            >>> load(standins()).at(Pairs.from_half_diff(angle, angle, angle)).shape
            torch.Size([10, 2, 3])
        """
        return self.lookup(pairs, interpolation).values

    def reciprocal_at(self, pairs: Pairs) -> Tensor:
        """Values as `at` gives them, of a measurement the mean of both orders of light and viewer.

        No two of them are quite equal where both were measured, and scenes take one pair for both.

        Args:
            pairs: As of `at`.

        Example:
            >>> from torchbrdf.measured import load, standins
            >>> angle = torch.tensor([0.0, 0.5])
            >>> load(standins()).reciprocal_at(Pairs.from_half_diff(angle, angle, angle)).shape
            torch.Size([10, 2, 3])
        """
        if self.source.is_reciprocal or self.stand_in:
            return self.at(pairs)
        return (self.at(pairs) + self.at(Pairs.from_directions(pairs.wo, pairs.wi))) / 2

    def lookup(self, pairs: Pairs, interpolation: Interpolation = "linear") -> Lookup:
        """Interpolated values as `at` gives them, with the count of pairs that had no valid neighbour."""
        if interpolation not in get_args(Interpolation):
            raise unknown("interpolation", interpolation, get_args(Interpolation))
        return self.source.at(self._asked(pairs), self.materials, interpolation)

    def _asked(self, pairs: Pairs) -> Pairs:
        """Pairs `(1, N)` or `(M, N)`."""
        if len(pairs.shape) == 1:
            pairs = pairs.unsqueeze()
        if len(pairs.shape) != 2 or pairs.shape[0] not in (1, len(self)):
            raise ShapeError(f"at: expected pairs ({len(self)} or 1, N), found {(*pairs.shape,)}")
        return pairs

    def distance_at(self, pairs: Pairs) -> Tensor:
        """How far pairs are from the nearest valid sample: where values are measured, interpolated or guessed.

        It is the angle by which light and viewer would have to turn, as a root mean square of both, for the samples of
        an isotropic, reciprocal material.

        Args:
            pairs: As of `at`.

        Returns:
            Degrees, `(M, N)`; 0 of a model in a measurement's place.

        Raises:
            ShapeError: The pairs fit neither one nor all materials.

        Example:
            >>> angle = torch.tensor([[0.1, 0.2]])
            >>> measured = Measured.from_samples(Pairs.from_half_diff(angle, angle, angle), torch.ones(1, 2, 3))
            >>> measured.distance_at(Pairs.from_half_diff(angle + math.radians(1), angle, angle)).round(decimals=1)
            tensor([[1., 1.]])
        """
        return self.source.distance_at(self._asked(pairs), self.materials)

    def reaches(self, pairs: Pairs) -> Tensor:
        """Whether there is a sample within `FAR` degrees of pairs, for all of them, `(M,)`.

        Grids are taken to be whole: only scattered samples leave gaps.

        Args:
            pairs: As of `at`.
        """
        if not self.is_scattered:
            return torch.ones(len(self), dtype=torch.bool, device=self.device)
        return (self.distance_at(pairs) <= FAR).all(-1).to(self.device)

    @property
    def is_scattered(self) -> bool:
        """Whether values are interpolated between samples without a grid."""
        return self.source.is_scattered

    @property
    def has_45_0(self) -> Tensor:
        """Of each material, whether samples are near the 45:0 reading, `(M,)`."""
        return self.reaches(reading_45_0())

    def diffuse_45_0(self) -> Tensor:
        """Diffuse albedo by the 45:0 reading, pi f(45:0), clamped to [0, 1].

        wi is at 45 degrees and wo at the normal: theta_h = theta_d = 22.5 degrees, phi_d = 0. `has_45_0` says whether
        it was measured thereabouts.

        Returns:
            `(M, C)`, without a unit.
        """
        value = self.at(reading_45_0())[:, 0]
        return (math.pi * value).clamp(0, 1).to(self.device, self.dtype)
