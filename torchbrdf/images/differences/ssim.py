"""Structural similarity."""

import torch
from kornia.metrics import ssim
from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.images.differences.base import DIFFERENCES, Difference, masked_mean

_WINDOW = 11


@DIFFERENCES.register("ssim")
class SSIM(Difference):
    """Mean structural similarity of display values over pixels and channels; 1 for pictures that are equal.

    kornia's map, Gaussian window of 11 pixels and sigma 1.5; windows at the mask's border see both backgrounds.
    Source: Z. Wang et al., Image Quality Assessment: From Error Visibility to Structural Similarity, 2004,
    doi:10.1109/TIP.2003.819861.
    """

    higher_is_better = True

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The mean of kornia's map."""
        if min(image.shape[1:3]) <= _WINDOW // 2:
            raise ShapeError(f"SSIM: expected pictures of at least {_WINDOW // 2 + 1} pixels, found {(*image.shape,)}")
        first, second = torch.movedim(image, -1, 1), torch.movedim(reference, -1, 1)
        return masked_mean(ssim(first, second, window_size=_WINDOW, eps=0.0).mean(1), mask)
