"""Differences of logarithms of radiance."""

from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.images.differences.base import DIFFERENCES, PixelDifference


@DIFFERENCES.register("log_hdr")
class LogHDR(PixelDifference):
    """Root mean square, over pixels and channels, of log(I + eps) - log(R + eps); 0 for pictures that are equal.

    Natural logarithms of linear radiance: well above eps, 0.1 stands for a ratio of 1.1, however bright. Well below
    eps differences fade to (I - R) / eps, so that black has a value. eps is in the pictures' own unit; the default
    suits pictures whose white is near 1. Negative radiance counts as 0.
    Source: the loss of G. Eilertsen et al., HDR Image Reconstruction from a Single Exposure Using Deep CNNs, 2017,
    doi:10.1145/3130800.3130816, is a mean square of such differences.
    """

    linear = True

    def __init__(self, eps: float = 1e-2) -> None:
        if not eps > 0:
            raise UsageError(f"LogHDR: expected an eps above 0, found {eps}")
        self.eps = eps

    def encode(self, picture: Tensor) -> Tensor:
        """log(1 + I / eps): log(I + eps), moved so that black is 0."""
        return (picture.clamp_min(0) / self.eps).log1p()
