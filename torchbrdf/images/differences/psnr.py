"""Peak signal to noise ratio."""

from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES, PixelDifference


@DIFFERENCES.register("psnr")
class PSNR(PixelDifference):
    """-10 log10(mse), with mse the mean squared difference of display values over pixels and channels.

    In decibels; infinite for pictures that are equal. The loss is the mse itself, in squared display values.
    """

    higher_is_better = True
    unit = "dB"

    def encode(self, picture: Tensor) -> Tensor:
        """The display values as they are."""
        return picture

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """Over all channels. kornia's pools a batch and knows no mask."""
        return -10 * self.objective(image, reference, mask).log10()
