"""Differences made for display values, of linear pictures in PU21."""

from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES
from torchbrdf.images.differences.psnr import PSNR
from torchbrdf.images.differences.ssim import SSIM
from torchbrdf.images.encodings import HDR_WHITE, check_luminance, pu21
from torchbrdf.reduction import Reduction

# As the source has it: 100 cd/m^2, white of displays for SDR, counts as the largest display value.
_PEAK = 256.0


@DIFFERENCES.register("pu_psnr")
class PUPSNR(PSNR):
    """`PSNR` of linear pictures in PU21, of which 256, or 100 cd/m^2, is the peak.

    Radiance times a luminance is light in cd/m^2, and `pu21` of each channel, divided by 256, takes the place of a
    display value; it goes up to 2.3. In decibels; infinite for pictures that are equal. The loss is the mean square.

    Args:
        white: luminance of radiance 1, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Raises:
        UsageError: the white is not above 0, or is above 10,000.

    Source: see `pu21`.

    Example:
        >>> from torchbrdf.images import PUPSNR
        >>> PUPSNR(white=100)
        PUPSNR(white=100, reduction='none')
    """

    linear = True

    def __init__(self, white: float = HDR_WHITE, *, reduction: Reduction = "none") -> None:
        super().__init__(reduction=reduction)
        self.white = check_luminance(self, "white", white)

    def extra_repr(self) -> str:
        """The settings."""
        return f"white={self.white:g}, {super().extra_repr()}"

    def encode(self, picture: Tensor) -> Tensor:
        """PU21 of every channel, as a display value."""
        return pu21(self.white * picture) / _PEAK


@DIFFERENCES.register("pu_ssim")
class PUSSIM(SSIM):
    """`SSIM` of linear pictures in PU21, of which 256, or 100 cd/m^2, is the peak; 1 for pictures that are equal.

    Radiance becomes display values as for `PUPSNR`. The loss is 1 - SSIM. Without unit.

    Args:
        white: luminance of radiance 1, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Raises:
        UsageError: the white is not above 0, or is above 10,000.

    Source: see `pu21` and `SSIM`.

    Example:
        >>> from torchbrdf.images import PUSSIM
        >>> PUSSIM(white=100)
        PUSSIM(white=100, reduction='none')
    """

    linear = True

    def __init__(self, white: float = HDR_WHITE, *, reduction: Reduction = "none") -> None:
        super().__init__(reduction=reduction)
        self.white = check_luminance(self, "white", white)

    def extra_repr(self) -> str:
        """The settings."""
        return f"white={self.white:g}, {super().extra_repr()}"

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """SSIM of both in PU21."""
        first, second = (pu21(self.white * picture) / _PEAK for picture in (image, reference))
        return super().compare(first, second, mask)


def pu_psnr(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    white: float = HDR_WHITE,
    reduction: Reduction = "none",
) -> Tensor:
    """Peak signal to noise ratio of linear pictures in PU21.

    The functional form of `PUPSNR`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, linear radiance.
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        white: luminance of radiance 1, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction, in dB; infinity for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.
        UsageError: the white is not above 0, or is above 10,000.

    Example:
        >>> import torch
        >>> from torchbrdf.images import pu_psnr
        >>> pu_psnr(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([-0.0588])
    """
    return PUPSNR(white, reduction=reduction)(image, reference, mask)


def pu_ssim(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    white: float = HDR_WHITE,
    reduction: Reduction = "none",
) -> Tensor:
    """Mean structural similarity of linear pictures in PU21.

    The functional form of `PUSSIM`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, linear radiance.
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        white: luminance of radiance 1, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 1 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes, or a side is below 6 pixels.
        UsageError: the white is not above 0, or is above 10,000.

    Example:
        >>> import torch
        >>> from torchbrdf.images import pu_ssim
        >>> pu_ssim(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([-0.0029])
    """
    return PUSSIM(white, reduction=reduction)(image, reference, mask)
