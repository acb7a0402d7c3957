"""Bands as linear RGB: what another format's values are to an observer."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.measured.bands import bands_in_words, colors_label, rgb_weights
from torchbrdf.measured.format import BrdfFormat, Interpolation, Lookup
from torchbrdf.pairs import Pairs


def weights_of(channels: int, wavelengths: Sequence[float] | None, illuminant: str, where: str) -> Tensor:
    """What bands are multiplied by to be linear RGB, `(C, 3)`, float64; one band is grey.

    Args:
        channels: C.
        wavelengths: Of the bands, nm; None where nobody knows them.
        illuminant: As of `rgb_weights`.
        where: Whose they are, for errors.

    Raises:
        DataError: Nobody knows the wavelengths of several bands.

    Example:
        >>> from torchbrdf.measured.colors import weights_of
        >>> weights_of(1, None, "D65", "a laser").tolist()
        [[1.0, 1.0, 1.0]]
    """
    if wavelengths is None and channels > 1:
        found = bands_in_words(channels, None)
        expected = "expected wavelengths, to make colours of"
        raise DataError(f"{where}: {expected}, found {found}; give them (nm), or --bands keep, if there is")
    return torch.from_numpy(rgb_weights(wavelengths or [0.0], illuminant))


class InColors(BrdfFormat):
    """The format of another's bands as linear RGB; values are interpolated in bands.

    Args:
        source: What has bands.
        illuminant: As of `rgb_weights`.
    """

    def __init__(self, source: BrdfFormat, illuminant: str) -> None:
        self.source, self.illuminant = source, illuminant
        self.weights = weights_of(source.channels, source.wavelengths, illuminant, source.names[0])
        self.names, self.paths, self.stand_in = source.names, source.paths, source.stand_in
        self.is_anisotropic = source.is_anisotropic

    @property
    def format(self) -> str:  # type: ignore[override]
        """The name of the other format."""
        return self.source.format

    @property
    def pairs(self) -> Pairs:  # type: ignore[override]
        """Where the values were measured."""
        return self.source.pairs

    @property
    def on_merl_bins(self) -> bool:  # type: ignore[override]
        """As the other format has it."""
        return self.source.on_merl_bins

    @property
    def is_reciprocal(self) -> bool:  # type: ignore[override]
        """As the other format has it."""
        return self.source.is_reciprocal

    @property
    def settings(self) -> Mapping[str, tuple[str, ...]]:  # type: ignore[override]
        """As the other format has them."""
        return self.source.settings

    @property
    def told(self) -> Mapping[str, str]:  # type: ignore[override]
        """As the other format was."""
        return self.source.told

    @property
    def is_scattered(self) -> bool:
        """As the other format has it."""
        return self.source.is_scattered

    def has_grain(self, material: int) -> bool:
        """As the other format has it."""
        return self.source.has_grain(material)

    @classmethod
    def recognises(cls, path: Path, head: bytes) -> bool:
        """No file is of this format."""
        return False

    @classmethod
    def open(cls, paths: Sequence[Path]) -> "InColors":
        """Refuse: there are no such files."""
        raise DataError(f"{paths[0]}: expected bands of another format")

    def read(self, materials: list[int], samples: Tensor | slice) -> tuple[Tensor, Tensor]:
        """The measured values as linear RGB, `(m, n, 3)`, and their weights."""
        values, weight = self.source.read(materials, samples)
        return values @ self.weights.to(values), weight

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """Values at any pairs as linear RGB."""
        found = self.source.at(pairs, materials, interpolation)
        return Lookup(found.values @ self.weights.to(found.values), found.filled)

    def distance_at(self, pairs: Pairs, materials: list[int]) -> Tensor:
        """How far pairs are from the nearest sample."""
        return self.source.distance_at(pairs, materials)

    def reading(self, material: int) -> dict[str, object]:
        """How the file was read, and how bands became colours."""
        return self.source.reading(material) | {"colours": self._label}

    def details(self, material: int) -> dict[str, object]:
        """What the other format says, and how bands became colours."""
        return self.source.details(material) | {"colours": self._label}

    @property
    def _label(self) -> str:
        return colors_label(self.source.wavelengths or [0.0], self.illuminant)
