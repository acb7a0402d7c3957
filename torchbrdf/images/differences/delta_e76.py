"""The CIELAB colour difference of 1976."""

from kornia.color import rgb_to_lab
from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES, PixelDifference
from torchbrdf.reduction import Reduction


def lab(picture: Tensor) -> Tensor:
    """CIELAB (D65, 2 degrees) of display values `(..., 3)`: L in [0, 100], a, b.

    kornia's wants sRGB; display values with gamma 2.2 are taken for sRGB, which is what a screen does with them.
    """
    pixels = picture.reshape(-1, 3).T[:, None]  # kornia's pixels are (3, H, W)
    return rgb_to_lab(pixels)[:, 0].T.reshape(picture.shape)


@DIFFERENCES.register("delta_e76")
class DeltaE76(PixelDifference):
    """Mean over pixels of sqrt(dL^2 + da^2 + db^2), the distance in CIELAB; 0 for pictures that are equal.

    Lab is described at `lab`. A difference of about 2.3 is just noticeable.
    Source: the formula of 1976 in CIE 15, Colorimetry; for the 2.3, M. Mahy et al., Evaluation of Uniform Color
    Spaces Developed after the Adoption of CIELAB and CIELUV, 1994, doi:10.1111/j.1520-6378.1994.tb00070.x.

    Args:
        reduction: "none", "mean" or "sum" over the pictures.

    Example:
        >>> from torchbrdf.images import DeltaE76
        >>> DeltaE76(reduction="mean")
        DeltaE76(reduction='mean')
    """

    power = 1

    def encode(self, picture: Tensor) -> Tensor:
        """L, a and b."""
        return lab(picture)


def delta_e76(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    reduction: Reduction = "none",
) -> Tensor:
    """Mean CIELAB colour difference of 1976 between pictures.

    The functional form of `DeltaE76`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, display values in [0, 1].
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 0 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.

    Example:
        >>> import torch
        >>> from torchbrdf.images import delta_e76
        >>> delta_e76(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([53.3890])
    """
    return DeltaE76(reduction=reduction)(image, reference, mask)


# Its name until there was another.
DIFFERENCES.alias("delta_e", "delta_e76")
