"""The format of values that somebody already has as tensors, and what these must be."""

import operator
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, ShapeError, UsageError, shown
from torchbrdf.measured.bands import checked_wavelengths
from torchbrdf.measured.format import BrdfFormat
from torchbrdf.measured.grain import grain_of
from torchbrdf.names import check_name
from torchbrdf.pairs import Pairs

# By how much the length of a unit vector may be off, by rounding, also of half precision.
_ROUNDING = 1e-2
# Samples by which it is found out whether materials are anisotropic.
_ENOUGH = 20_000


class Samples(BrdfFormat):
    """The format of values that somebody already has as tensors, see `Measured.from_samples`."""

    format = "samples"

    def __init__(
        self,
        pairs: Pairs,
        values: Tensor,
        weight: Tensor | None,
        names: Sequence[str] | None,
        wavelengths: Sequence[float] | None = None,
        anisotropic: bool | None = None,
    ) -> None:
        if values.dim() != 3 or not values.shape[-1] or values.shape[1] != len(pairs):
            raise ShapeError(f"Measured: expected values (M, {len(pairs)}, C), found {(*values.shape,)}")
        self.channels = values.shape[-1]
        self.wavelengths = None if wavelengths is None else checked_wavelengths(wavelengths, self.channels)
        if names is not None and len(names) != len(values):
            raise ShapeError(f"Measured: {len(names)} names for {len(values)} materials")
        valid = values.isfinite().all(-1, keepdim=True) & pairs.above_horizon[..., None]
        given = torch.ones_like(values[..., :1]) if weight is None else weight.to(values).expand(*values.shape[:2], 1)
        self.weight = torch.where(valid, given, 0)
        self.values = torch.where(self.weight > 0, values, 0)
        self.pairs = pairs if pairs.cos_i.dim() == 2 else pairs.unsqueeze()
        given_names = names if names is not None else [f"material{k}" for k in range(len(values))]
        self.names = [check_name(name, "Measured: names") for name in given_names]
        self.paths = []
        if anisotropic and not pairs.is_oriented:
            raise ShapeError("Measured: anisotropic: expected pairs of directions, found cosines or angles alone")
        self._told = anisotropic

    @cached_property
    def is_anisotropic(self) -> bool:  # type: ignore[override]
        """As it was told, or where values are better predicted with the azimuths than without."""
        if self._told is not None or not self.may_be_anisotropic:
            return bool(self._told)
        return any(map(self._is_better_with_azimuths, range(len(self.names))))

    @property
    def may_be_anisotropic(self) -> bool:
        """As it was told, or where the light lies in more than one plane through the normal."""
        return _is_turned(self.pairs) if self._told is None else self._told

    def _is_better_with_azimuths(self, material: int) -> bool:
        pairs = self.pairs.select([material])
        valid = (self.weight[material, :, 0] > 0).nonzero()[:, 0]
        some = valid[:: max(len(valid) // _ENOUGH, 1)].cpu()
        wi, wo = (one[0, some].double().cpu().numpy() for one in (pairs.wi, pairs.wo))
        values = self.values[material, some].double().mean(-1).cpu().numpy()
        return len(some) > 0 and grain_of(wi, wo, values).is_there

    def select(self, materials: list[int]) -> "Samples":
        """Some materials, where all share the pairs."""
        names = [self.names[k] for k in materials]
        weight = self.weight[materials]
        return Samples(self.pairs, self.values[materials], weight, names, self.wavelengths, self._told)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """Whether a file is of this format: never, since samples do not come from files."""
        return False

    @classmethod
    def open(cls, paths: Sequence[Path]) -> "Samples":
        """Refuse: samples do not come from files."""
        raise DataError(f"{paths[0]}: samples do not come from files")

    def reading(self, material: int) -> dict[str, object]:
        """That there was no file."""
        return {"format": self.format}

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """The given values `(m, n, C)` and weights `(m, n, 1)`."""
        return self.values[materials][:, samples], self.weight[materials][:, samples]


def _is_turned(pairs: Pairs) -> bool:
    """Whether the pairs are directions with lights in more than one plane through the normal."""
    if not pairs.is_oriented or not len(pairs):
        return False
    x, y, _ = pairs.wi.double().unbind(-1)
    azimuth = torch.atan2(y, x)[x.square() + y.square() > 1e-6]
    # Twice the angle, as both sides of a plane are one.
    return len(azimuth) > 0 and bool(((2 * (azimuth - azimuth[0])).cos() < 1 - 1e-4).any())


def check_given(pairs: Pairs, values: Tensor) -> None:
    """Refuse tensors that cannot be measurements.

    Args:
        pairs: Where they were measured.
        values: In 1/sr.

    Raises:
        UsageError: `pairs` are none.
        ShapeError: `values` is no tensor of floats, or directions are no unit vectors.
        DataError: There is no value that is finite and above the horizon.

    Example:
        >>> from torchbrdf.measured.samples import check_given
        >>> angle = torch.tensor([[0.1, 0.2]])
        >>> check_given(Pairs.from_half_diff(angle, angle, angle), torch.ones(1, 2, 3))
    """
    if not isinstance(pairs, Pairs):
        raise UsageError(f"Measured: pairs: expected Pairs, found {shown(pairs)}")
    if not isinstance(values, Tensor) or not values.is_floating_point():
        found = str(values.dtype) if isinstance(values, Tensor) else shown(values)
        raise ShapeError(f"Measured: values: expected a tensor of floats (M, N, C), found {found}")
    for name, known in pairs.items():
        if name in ("wi", "wo"):
            length = known.square().sum(-1).sqrt()
            odd = ~((length - 1).abs() <= _ROUNDING)
            if odd.any():
                found = f"{int(odd.sum())} of {odd.numel()} others, the first of the length {length[odd][0].item():.4g}"
                raise ShapeError(f"Measured: pairs: {name}: expected unit vectors, found {found}")
    if values.dim() == 3 and values.numel() and values.shape[1] == len(pairs):
        valid = values.isfinite().all(-1) & pairs.above_horizon.to(values.device)
        if not valid.any():
            raise DataError(f"Measured: values: expected finite ones above the horizon, found none of {valid.numel()}")


def row_of(material: Any, count: int) -> int:
    """An index into so many materials, which may count from the end.

    Raises:
        UsageError: There is no such material.
    """
    try:
        row = operator.index(material)
    except TypeError:
        row = count
    if not -count <= row < count:
        there = f"materials 0 to {count - 1}" if count else "no material, since there is none"
        raise UsageError(f"batch: expected {there}, found {shown(material)}")
    return row


def samples_of(samples: Any, count: int) -> Tensor:
    """An index into so many samples, int64, from what may count from the end, or says of each whether it is meant.

    Raises:
        UsageError: It is no tensor `(n,)` of whole numbers, or of as many truths as there are samples; or there is no
            such sample.
    """
    expected = f"batch: samples: expected a tensor of whole numbers (n,), or of {count} truths"
    if not isinstance(samples, Tensor):
        raise UsageError(f"{expected}, found {shown(samples)}")
    if samples.dim() != 1 or samples.is_floating_point() or samples.is_complex():
        raise UsageError(f"{expected}, found {samples.dtype} {(*samples.shape,)}")
    if samples.dtype == torch.bool:
        if len(samples) != count:
            raise UsageError(f"{expected}, found {len(samples)} truths")
        return samples.nonzero()[:, 0]
    if not len(samples):
        return samples.long()
    low, high = int(samples.min()), int(samples.max())
    if not -count <= low <= high < count:
        raise UsageError(f"batch: expected samples 0 to {count - 1}, found {high if high >= count else low}")
    return samples.long() if low >= 0 else samples.long() % count
