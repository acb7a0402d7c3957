"""Peak signal to noise ratio."""

import torch
from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES, PixelDifference
from torchbrdf.reduction import Reduction


@DIFFERENCES.register("psnr")
class PSNR(PixelDifference):
    """-10 log10(mse), with mse the mean squared difference of display values over pixels and channels.

    In decibels; infinite for pictures that are equal. The loss is the mse itself, in squared display values.

    Args:
        reduction: "none", "mean" or "sum" over the pictures.

    Example:
        >>> from torchbrdf.images import PSNR
        >>> PSNR(reduction="mean")
        PSNR(reduction='mean')
    """

    higher_is_better = True
    unit = "dB"

    def encode(self, picture: Tensor) -> Tensor:
        """The display values as they are."""
        return picture

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """Over all channels. kornia's pools a batch and knows no mask."""
        error = self.objective(image, reference, mask)
        # Equal pictures are infinitely alike, with gradient 0.
        return torch.where(error == 0, torch.inf, -10 * torch.where(error == 0, 1, error).log10())


def psnr(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    reduction: Reduction = "none",
) -> Tensor:
    """Peak signal to noise ratio of pictures.

    The functional form of `PSNR`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, display values in [0, 1].
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction, in dB; infinity for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.

    Example:
        >>> import torch
        >>> from torchbrdf.images import psnr
        >>> psnr(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([6.0206])
    """
    return PSNR(reduction=reduction)(image, reference, mask)
