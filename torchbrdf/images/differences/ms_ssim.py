"""Structural similarity at several scales."""

import torch
from torch import Tensor
from torch.nn import functional

from torchbrdf.color import safe_power
from torchbrdf.images.differences.base import DIFFERENCES, Difference, channels_first
from torchbrdf.reduction import Reduction

_TAPS, _SIGMA = 11, 1.5
_C1, _C2 = 0.01**2, 0.03**2
# The source's exponents, finest scale first.
_EXPONENTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)


@DIFFERENCES.register("ms_ssim")
class MSSSIM(Difference):
    """Structural similarity of display values at five scales, mean over channels; 1 for pictures that are equal.

    l^w_5 prod_k cs_k^w_k: cs_k is the mean at scale k of (2 c + C2) / (v_x + v_y + C2), with the variances and the
    covariance in Gaussian windows of 11 pixels and sigma 1.5 that lie inside the picture; at the coarsest scale it
    is the mean of SSIM, which has the luminances' (2 m_x m_y + C1) / (m_x^2 + m_y^2 + C1) as another factor. Scales
    are halved by means of 2 x 2 pixels, and the mask with them; a window counts by how much of the mask it sees.
    Negative means count as 0, and then so does the gradient. The loss is 1 - MS-SSIM. Without unit.
    Source: Z. Wang, E. Simoncelli, A. Bovik, Multiscale Structural Similarity for Image Quality Assessment, 2003,
    doi:10.1109/ACSSC.2003.1292216. Written here because libraries give no maps, only means over whole pictures.

    Args:
        reduction: "none", "mean" or "sum" over the pictures.

    Example:
        >>> from torchbrdf.images import MSSSIM
        >>> MSSSIM(reduction="mean")
        MSSSIM(reduction='mean')
    """

    higher_is_better = True
    least_side = (_TAPS - 1) * 2 ** (len(_EXPONENTS) - 1) + 1  # so that the coarsest scale holds a window

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The product over scales."""
        first, second = channels_first(image), channels_first(reference)
        counted = mask[:, None].to(image.dtype)
        product = image.new_ones(())
        for scale, exponent in enumerate(_EXPONENTS):
            if scale:
                first, second, counted = (_halved(x) for x in (first, second, counted))
            unlike = _dissimilarity(first, second, luminance=scale == len(_EXPONENTS) - 1)
            seen = _blurred(counted)
            mean = (unlike * seen).sum((-2, -1)) / seen.sum((-2, -1))
            product = product * safe_power(1 - mean, exponent)
        return product.mean(-1)

    def objective(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """1 - MS-SSIM; rounding may carry the similarity of nearly equal pictures above 1."""
        return (1 - self.compare(image, reference, mask)).clamp_min(0)


def ms_ssim(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    reduction: Reduction = "none",
) -> Tensor:
    """Structural similarity of pictures at five scales.

    The functional form of `MSSSIM`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, display values in [0, 1].
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 1 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes, or a side is below 161 pixels.

    Example:
        >>> import torch
        >>> from torchbrdf.images import ms_ssim
        >>> ms_ssim(torch.zeros(1, 161, 161, 3), torch.full((1, 161, 161, 3), 0.5))
        tensor([0.3524])
    """
    return MSSSIM(reduction=reduction)(image, reference, mask)


def _dissimilarity(first: Tensor, second: Tensor, luminance: bool) -> Tensor:
    """1 - cs, with `luminance` 1 - l cs, over windows inside `(B, C, H, W)`.

    v_x + v_y - 2 c is the variance of x - y, and m_x^2 + m_y^2 - 2 m_x m_y the square of its mean: by these, nearly
    equal pictures keep their digits, equal ones are exactly 0 apart, and one blur fewer does.
    """
    mean_first, mean_second = _blurred(first), _blurred(second)
    power = mean_first.square() + mean_second.square()
    apart = (mean_first - mean_second).square()
    variances = _blurred(first.square() + second.square()) - power
    # Rounding may carry a variance below 0, and with it the similarity above 1.
    structure = (_blurred((first - second).square()) - apart).clamp_min(0) / (variances.clamp_min(0) + _C2)
    if not luminance:
        return structure
    light = apart / (power + _C1)
    return structure + light - structure * light


def _blurred(planes: Tensor) -> Tensor:
    """Means of `(B, C, H, W)` under the window wherever it fits, `(B, C, H - 10, W - 10)`."""
    offsets = torch.arange(_TAPS, dtype=planes.dtype, device=planes.device) - _TAPS // 2
    taps = torch.exp(-offsets.square() / (2 * _SIGMA**2))
    taps = taps / taps.sum()
    channels = planes.shape[1]
    rows = functional.conv2d(planes, taps.view(1, 1, -1, 1).expand(channels, -1, -1, -1), groups=channels)
    return functional.conv2d(rows, taps.view(1, 1, 1, -1).expand(channels, -1, -1, -1), groups=channels)


def _halved(planes: Tensor) -> Tensor:
    """Means of 2 x 2 pixels; of an odd side, the last is a mean of those that are there."""
    return functional.avg_pool2d(planes, 2, ceil_mode=True)
