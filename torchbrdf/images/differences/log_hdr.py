"""Differences of logarithms of radiance."""

from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.images.differences.base import DIFFERENCES, PixelDifference
from torchbrdf.reduction import Reduction


@DIFFERENCES.register("log_hdr")
class LogHDR(PixelDifference):
    """Root mean square, over pixels and channels, of log(I + eps) - log(R + eps); 0 for pictures that are equal.

    Natural logarithms of linear radiance: well above eps, 0.1 stands for a ratio of 1.1, however bright. Well below
    eps differences fade to (I - R) / eps, so that black has a value. eps is in the pictures' own unit; the default
    suits pictures whose white is near 1. Negative radiance counts as 0.

    Args:
        eps: added to radiance, in its unit.
        reduction: "none", "mean" or "sum" over the pictures.

    Raises:
        UsageError: eps is not above 0.

    Source: the loss of G. Eilertsen et al., HDR Image Reconstruction from a Single Exposure Using Deep CNNs, 2017,
    doi:10.1145/3130800.3130816, is a mean square of such differences.

    Example:
        >>> from torchbrdf.images import LogHDR
        >>> LogHDR(eps=0.1)
        LogHDR(eps=0.1, reduction='none')
    """

    linear = True

    def __init__(self, eps: float = 1e-2, *, reduction: Reduction = "none") -> None:
        super().__init__(reduction=reduction)
        if not eps > 0:
            raise UsageError(f"LogHDR: expected an eps above 0, found {eps}")
        self.eps = eps

    def extra_repr(self) -> str:
        """The settings."""
        return f"eps={self.eps:g}, {super().extra_repr()}"

    def encode(self, picture: Tensor) -> Tensor:
        """log(1 + I / eps): log(I + eps), moved so that black is 0."""
        return (picture.clamp_min(0) / self.eps).log1p()


def log_hdr(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    eps: float = 1e-2,
    reduction: Reduction = "none",
) -> Tensor:
    """Root mean square difference of the logarithms of pictures' radiance.

    The functional form of `LogHDR`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, linear radiance.
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        eps: added to radiance, in its unit.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 0 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.
        UsageError: eps is not above 0.

    Example:
        >>> import torch
        >>> from torchbrdf.images import log_hdr
        >>> log_hdr(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([3.9318])
    """
    return LogHDR(eps, reduction=reduction)(image, reference, mask)
