"""What bands of wavelengths measured values are of, and what they are as colours."""

from abc import abstractmethod
from typing import Self

from torchbrdf.color import LUMINANCE
from torchbrdf.errors import DataError
from torchbrdf.measured.bands import DEFAULT_ILLUMINANT, bands_in_words, luminance_shares
from torchbrdf.measured.colors import InColors
from torchbrdf.measured.format import BrdfFormat


class InBands:
    """The part of `Measured` that knows bands."""

    source: BrdfFormat

    @property
    @abstractmethod
    def names(self) -> list[str]:
        """Names of the materials."""

    @abstractmethod
    def _view(self, **changes: object) -> Self:
        """The same, but for what is changed."""

    @property
    def channels(self) -> int:
        """How many numbers a value has, C: 3 of linear RGB, else one a band."""
        return self.source.channels

    @property
    def wavelengths(self) -> tuple[float, ...] | None:
        """Of the C bands, nm, growing; None of linear RGB, and where nobody knows them."""
        return self.source.wavelengths

    @property
    def is_rgb(self) -> bool:
        """Whether values are linear RGB."""
        return self.channels == 3 and self.wavelengths is None

    @property
    def has_colors(self) -> bool:
        """Whether values are linear RGB, or can be made so, see `to_rgb`."""
        return self.is_rgb or self.wavelengths is not None or self.channels == 1

    @property
    def luminance_shares(self) -> tuple[float, ...]:
        """What each channel counts in luminance; bands whose wavelengths nobody knows count alike."""
        if self.is_rgb:
            return LUMINANCE
        return (1 / self.channels,) * self.channels if self.wavelengths is None else luminance_shares(self.wavelengths)

    def to_rgb(self, illuminant: str = DEFAULT_ILLUMINANT) -> Self:
        """The same materials in linear RGB, by the CIE 1931 observer; itself, if it is so.

        Args:
            illuminant: "D65", daylight, or "E", equal power at all wavelengths.

        Raises:
            DataError: Nobody knows the wavelengths of several bands.
            UsageError: There is no such illuminant.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> from torchbrdf.measured import Measured
            >>> angle = torch.tensor([[0.1, 0.2]])
            >>> pairs = Pairs.from_half_diff(angle, angle, angle)
            >>> grey = Measured.from_samples(pairs, torch.ones(1, 2, 31), wavelengths=range(400, 710, 10))
            >>> grey.to_rgb().values[0, 0]
            tensor([1.0000, 1.0000, 1.0000])
        """
        return self if self.is_rgb else self._view(source=InColors(self.source, illuminant))

    def check_rgb(self, who: str) -> None:
        """Refuse bands where linear RGB is needed.

        Args:
            who: Needs it, for the message.

        Raises:
            DataError: Values are bands.

        Example:
            >>> from torchbrdf.measured import load, standins
            >>> load(standins()).check_rgb("pictures")
        """
        if not self.is_rgb:
            found = bands_in_words(self.channels, self.wavelengths)
            raise DataError(
                f"{who}: expected linear RGB, found {found}: {', '.join(self.names[:3])}; --bands rgb, or to_rgb()"
            )
