"""The colour difference of ITU-R BT.2124, Delta E ITP."""

import numpy as np
from kornia.color import rgb_to_linear_rgb
from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES, PixelDifference
from torchbrdf.images.encodings import HDR_WHITE, check_luminance, pq
from torchbrdf.images.primaries import BT2020, to_rec709
from torchbrdf.reduction import Reduction

PEAK = 100.0
"""Luminance of a display's white, in cd/m^2: that of reference displays for SDR, ITU-R BT.2035."""

# BT.2100-2, table 7: linear RGB of BT.2020 to LMS, and LMS behind PQ to I, C_T and C_P; T is half of C_T.
_RGB_TO_LMS = np.array([[1688, 2146, 262], [683, 2951, 462], [99, 309, 3688]]) / 4096
_LMS_TO_ICTCP = np.array([[2048, 2048, 0], [6610, -13613, 7003], [17933, -17390, -543]]) / 4096
_SCALE = 720.0
_TO_LMS = (_RGB_TO_LMS @ np.linalg.inv(to_rec709("BT.2020", BT2020))).tolist()
_TO_ITP = (_SCALE * np.array([[1.0], [0.5], [1.0]]) * _LMS_TO_ICTCP).tolist()


def itp(rgb: Tensor) -> Tensor:
    """720 times I, T and P of light, so that distances are Delta E ITP.

    Args:
        rgb: linear, with the primaries of ITU-R BT.709, in cd/m^2 of each at white, `(..., 3)`; below 0 counts as 0.

    Returns:
        `(..., 3)`.

    Source: see `DeltaEITP`.
    """
    cones = pq(rgb.clamp_min(0) @ rgb.new_tensor(_TO_LMS).T)
    return cones @ rgb.new_tensor(_TO_ITP).T


@DIFFERENCES.register("delta_e_itp")
class DeltaEITP(PixelDifference):
    """Mean over pixels of 720 sqrt(dI^2 + dT^2 + dP^2) between displayed colours; 0 for pictures that are equal.

    Display values, taken for sRGB, times the display's peak are light in cd/m^2; in the primaries of BT.2020 it becomes
    LMS, LMS behind PQ becomes I, C_T and C_P, and T = C_T / 2. A difference of 1 is just noticeable to an eye that is
    adapted to it as well as can be; large ones are not in proportion to what is seen. Slopes near black are steep; at
    black, where they would be infinite, they end: see `pq`. `DeltaEITPHDR` is the same on radiance, without a display's
    limits.

    Args:
        peak: luminance of the display's white, in cd/m^2; its black has none.
        reduction: "none", "mean" or "sum" over the pictures.

    Raises:
        UsageError: the peak is not above 0, or is above 10,000.

    Source: ITU-R BT.2124-0, Objective Metric for the Assessment of the Potential Visibility of Colour Differences in
    Television, 2019.

    Example:
        >>> from torchbrdf.images import DeltaEITP
        >>> DeltaEITP(peak=300)
        DeltaEITP(peak=300, reduction='none')
    """

    power = 1

    def __init__(self, peak: float = PEAK, *, reduction: Reduction = "none") -> None:
        super().__init__(reduction=reduction)
        self.peak = check_luminance(self, "peak", peak)

    def extra_repr(self) -> str:
        """The settings."""
        return f"peak={self.peak:g}, {super().extra_repr()}"

    def encode(self, picture: Tensor) -> Tensor:
        """720 times I, T and P."""
        pixels = picture.reshape(-1, 3).T[:, None]  # kornia's pixels are (3, H, W)
        return itp(self.peak * rgb_to_linear_rgb(pixels)[:, 0].T).reshape(picture.shape)


@DIFFERENCES.register("delta_e_itp_hdr")
class DeltaEITPHDR(PixelDifference):
    """`DeltaEITP` of linear pictures: radiance times a luminance is light in cd/m^2, however bright.

    Of radiance that no tone map has compressed, as an HDR display of any range would show it. PQ ends at 10,000
    cd/m^2; brighter light goes on along its formula.

    Args:
        white: luminance of radiance 1, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Raises:
        UsageError: the white is not above 0, or is above 10,000.

    Source: see `DeltaEITP`; for the white, ITU-R BT.2408.

    Example:
        >>> from torchbrdf.images import DeltaEITPHDR
        >>> DeltaEITPHDR(white=100)
        DeltaEITPHDR(white=100, reduction='none')
    """

    linear = True
    power = 1

    def __init__(self, white: float = HDR_WHITE, *, reduction: Reduction = "none") -> None:
        super().__init__(reduction=reduction)
        self.white = check_luminance(self, "white", white)

    def extra_repr(self) -> str:
        """The settings."""
        return f"white={self.white:g}, {super().extra_repr()}"

    def encode(self, picture: Tensor) -> Tensor:
        """720 times I, T and P."""
        return itp(self.white * picture)


def delta_e_itp(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    peak: float = PEAK,
    reduction: Reduction = "none",
) -> Tensor:
    """Mean Delta E ITP between pictures as a display shows them.

    The functional form of `DeltaEITP`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, display values in [0, 1].
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        peak: luminance of the display's white, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 0 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.
        UsageError: the peak is not above 0, or is above 10,000.

    Example:
        >>> import torch
        >>> from torchbrdf.images import delta_e_itp
        >>> delta_e_itp(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([261.2865])
    """
    return DeltaEITP(peak, reduction=reduction)(image, reference, mask)


def delta_e_itp_hdr(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    white: float = HDR_WHITE,
    reduction: Reduction = "none",
) -> Tensor:
    """Mean Delta E ITP between linear pictures.

    The functional form of `DeltaEITPHDR`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, linear radiance.
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        white: luminance of radiance 1, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 0 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.
        UsageError: the white is not above 0, or is above 10,000.

    Example:
        >>> import torch
        >>> from torchbrdf.images import delta_e_itp_hdr
        >>> delta_e_itp_hdr(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([366.8923])
    """
    return DeltaEITPHDR(white, reduction=reduction)(image, reference, mask)
