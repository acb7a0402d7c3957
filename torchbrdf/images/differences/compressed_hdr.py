"""Differences of powers of radiance."""

from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.images.differences.base import DIFFERENCES, PixelDifference
from torchbrdf.reduction import Reduction


@DIFFERENCES.register("compressed_hdr")
class CompressedHDR(PixelDifference):
    """Root mean square, over pixels and channels, of (I + eps)^p - (R + eps)^p; 0 for pictures that are equal.

    In radiance^p of linear pictures, with the exponent p, 1/3 by default: about how lightness is seen. Negative
    radiance counts as 0. eps, in the pictures' own unit, keeps the slope of black finite; the default suits pictures
    whose white is near 1. `torchbrdf.losses.CompressedLoss` is the same on BRDFs.

    Args:
        exponent: the power p.
        eps: added to radiance, in its unit.
        reduction: "none", "mean" or "sum" over the pictures.

    Raises:
        UsageError: the exponent is not in (0, 2], or eps is not above 0.

    Source: the compressive metric of A. Fores, J. Ferwerda, J. Gu, Toward a Perceptually Based Metric for BRDF
    Modeling, 2012, carried over to pictures; the power of 1/3 is that of CIE lightness, CIE 15.

    Example:
        >>> from torchbrdf.images import CompressedHDR
        >>> CompressedHDR(exponent=0.5)
        CompressedHDR(exponent=0.5, eps=0.001, reduction='none')
    """

    linear = True

    def __init__(self, exponent: float = 1 / 3, eps: float = 1e-3, *, reduction: Reduction = "none") -> None:
        super().__init__(reduction=reduction)
        if not 0 < exponent <= 2:
            raise UsageError(f"CompressedHDR: expected an exponent above 0 and at most 2, found {exponent}")
        if not eps > 0:
            raise UsageError(f"CompressedHDR: expected an eps above 0, found {eps}")
        self.exponent, self.eps = exponent, eps

    def extra_repr(self) -> str:
        """The settings."""
        return f"exponent={self.exponent:g}, eps={self.eps:g}, {super().extra_repr()}"

    def encode(self, picture: Tensor) -> Tensor:
        """(I + eps)^p - eps^p: 0 for black."""
        return (picture.clamp_min(0) + self.eps).pow(self.exponent) - self.eps**self.exponent


def compressed_hdr(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    exponent: float = 1 / 3,
    eps: float = 1e-3,
    reduction: Reduction = "none",
) -> Tensor:
    """Root mean square difference of powers of pictures' radiance.

    The functional form of `CompressedHDR`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, linear radiance.
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        exponent: the power.
        eps: added to radiance, in its unit.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 0 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.
        UsageError: the exponent is not in (0, 2], or eps is not above 0.

    Example:
        >>> import torch
        >>> from torchbrdf.images import compressed_hdr
        >>> compressed_hdr(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([0.6942])
    """
    return CompressedHDR(exponent, eps, reduction=reduction)(image, reference, mask)
