"""The CIELAB colour difference of 1976."""

import torch
from kornia.color import rgb_to_lab
from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES, Difference, masked_mean


@DIFFERENCES.register("delta_e76")
class DeltaE76(Difference):
    """Mean Euclidean distance in CIELAB (D65); 0 for pictures that are equal. About 2.3 is just noticeable.

    kornia's Lab wants sRGB; display values with gamma 2.2 are taken for sRGB, which is what a screen does with them.
    """

    higher_is_better = False

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The mean of the pixels' distances, each with gradient 0 where it is 0."""
        first, second = (rgb_to_lab(torch.movedim(picture, -1, 1)) for picture in (image, reference))
        square = (first - second).square().sum(1)
        different = square > 0
        return masked_mean(torch.where(different, torch.where(different, square, 1).sqrt(), 0), mask)
