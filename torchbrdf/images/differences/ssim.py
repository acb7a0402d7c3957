"""Structural similarity."""

from kornia import metrics
from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES, Difference, channels_first, masked_mean
from torchbrdf.reduction import Reduction

_WINDOW = 11


@DIFFERENCES.register("ssim")
class SSIM(Difference):
    """Mean structural similarity of display values over pixels and channels; 1 for pictures that are equal.

    In a Gaussian window of 11 pixels and sigma 1.5 around every pixel, with means m, variances v and covariance c:
    (2 m_x m_y + C1) (2 c + C2) / ((m_x^2 + m_y^2 + C1) (v_x + v_y + C2)), C1 = 0.01^2, C2 = 0.03^2. kornia's map,
    borders mirrored. The loss is 1 - SSIM. Without unit.
    Source: Z. Wang et al., Image Quality Assessment: From Error Visibility to Structural Similarity, 2004,
    doi:10.1109/TIP.2003.819861.

    Args:
        reduction: "none", "mean" or "sum" over the pictures.

    Example:
        >>> from torchbrdf.images import SSIM
        >>> SSIM(reduction="mean")
        SSIM(reduction='mean')
    """

    higher_is_better = True
    least_side = _WINDOW // 2 + 1  # a border narrower than the window's half cannot be mirrored

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The mean of kornia's map."""
        # kornia has a way of its own, two and a half times as fast, for pictures that lie in memory as it expects them.
        first, second = (channels_first(one).contiguous() for one in (image, reference))
        similarity = metrics.ssim(first, second, window_size=_WINDOW, eps=0.0)
        return masked_mean(similarity.mean(1), mask)

    def objective(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """1 - SSIM; rounding may carry the similarity of nearly equal pictures above 1."""
        return (1 - self.compare(image, reference, mask)).clamp_min(0)


def ssim(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    reduction: Reduction = "none",
) -> Tensor:
    """Mean structural similarity of pictures.

    The functional form of `SSIM`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, display values in [0, 1].
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 1 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes, or a side is below 6 pixels.

    Example:
        >>> import torch
        >>> from torchbrdf.images import ssim
        >>> ssim(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([0.0004])
    """
    return SSIM(reduction=reduction)(image, reference, mask)
