"""Peak signal to noise ratio."""

from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES, Difference, masked_mean


@DIFFERENCES.register("psnr")
class PSNR(Difference):
    """-10 log10(mean squared difference of display values); infinite for pictures that are equal."""

    higher_is_better = True
    unit = "dB"

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """Over all channels. kornia's pools a batch and knows no mask."""
        return -10 * masked_mean((image - reference).square().mean(-1), mask).log10()
