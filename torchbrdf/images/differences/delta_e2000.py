"""The CIEDE2000 colour difference."""

import math

import torch
from torch import Tensor

from torchbrdf.color import safe_power
from torchbrdf.images.differences.base import DIFFERENCES, Difference, masked_mean
from torchbrdf.images.differences.delta_e76 import lab
from torchbrdf.reduction import Reduction
from torchbrdf.roots import safe_norm

# Colours of less chroma have no hue. Far below what can be seen, far above where float32 loses its square.
_HUELESS = 1e-9


@DIFFERENCES.register("delta_e2000")
class DeltaE2000(Difference):
    """Mean over pixels of `ciede2000` of display values, taken for sRGB; 0 for pictures that are equal.

    In units of CIEDE2000, of which 1 is about just noticeable.

    Args:
        reduction: "none", "mean" or "sum" over the pictures.

    Example:
        >>> from torchbrdf.images import DeltaE2000
        >>> DeltaE2000(reduction="mean")
        DeltaE2000(reduction='mean')
    """

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The mean of the pixels' differences."""
        return masked_mean(ciede2000(lab(image), lab(reference)), mask)


def delta_e2000(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    reduction: Reduction = "none",
) -> Tensor:
    """Mean CIEDE2000 colour difference between pictures.

    The functional form of `DeltaE2000`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, display values in [0, 1].
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 0 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.

    Example:
        >>> import torch
        >>> from torchbrdf.images import delta_e2000
        >>> delta_e2000(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([39.7441])
    """
    return DeltaE2000(reduction=reduction)(image, reference, mask)


def ciede2000(first: Tensor, second: Tensor) -> Tensor:
    """CIEDE2000 of CIELAB colours `(..., 3)`, with k_L = k_C = k_H = 1: `(...)`; symmetric, 0 for equal colours.

    sqrt((dL/S_L)^2 + (dC/S_C)^2 + (dH/S_H)^2 + R_T (dC/S_C) (dH/S_H)), eq. 22 of the source. The formula jumps where
    hues are opposite. The gradient is 0 at equal colours; the slope of the chroma of a grey counts as 0.

    Source: G. Sharma, W. Wu, E. Dalal, The CIEDE2000 Color-Difference Formula: Implementation Notes, Supplementary
    Test Data, and Mathematical Observations, 2005, doi:10.1002/col.20070.
    """
    mean_chroma = (safe_norm(first[..., 1:]) + safe_norm(second[..., 1:])) / 2
    stretch = 1 + 0.5 * (1 - _saturation(mean_chroma))
    one, two = (torch.stack([x[..., 1] * stretch, x[..., 2]], -1) for x in (first, second))
    chroma_one, chroma_two = safe_norm(one), safe_norm(two)
    mean_chroma = (chroma_one + chroma_two) / 2
    mean_hue, turn = _hues(one, two, chroma_one > _HUELESS, chroma_two > _HUELESS)

    t = 1 - 0.17 * _cos(mean_hue, 1, -30) + 0.24 * _cos(mean_hue, 2, 0)
    t = t + 0.32 * _cos(mean_hue, 3, 6) - 0.20 * _cos(mean_hue, 4, -63)
    square = ((first[..., 0] + second[..., 0]) / 2 - 50).square()
    lightness = (second[..., 0] - first[..., 0]) / (1 + 0.015 * square / (20 + square).sqrt())
    chroma = (chroma_two - chroma_one) / (1 + 0.045 * mean_chroma)
    hue_scale = 1 + 0.015 * mean_chroma * t
    square, signed = _hue_difference(one, two, chroma_one * chroma_two, turn)
    blue = torch.exp(-((torch.rad2deg(mean_hue) - 275) / 25).square())
    rotation = -2 * _saturation(mean_chroma) * torch.sin(math.pi / 3 * blue)
    total = lightness.square() + chroma.square() + square / hue_scale.square()
    return safe_power(total + rotation * chroma * signed / hue_scale, 0.5)


def _hues(one: Tensor, two: Tensor, first_has: Tensor, second_has: Tensor) -> tuple[Tensor, Tensor]:
    """The mean hue, eq. 14, and by how much the second lies ahead, eq. 10, in radians; a hue that is not there is 0."""
    first, second = (
        # The angle of (1, 0) where there is none, so that its gradient is 0 instead of infinite.
        torch.atan2(torch.where(has, x[..., 1], 0), torch.where(has, x[..., 0], 1)).remainder(2 * math.pi)
        for x, has in ((one, first_has), (two, second_has))
    )
    both = first_has & second_has
    turn, total = second - first, first + second
    # The nearer way round, and the mean on that side.
    far = both & (turn.abs() > math.pi)
    ahead = torch.where(far, turn - 2 * math.pi * turn.sign(), turn)
    across = torch.where(total < 2 * math.pi, total + 2 * math.pi, total - 2 * math.pi)
    mean = torch.where(far, across, total) / 2
    return torch.where(both, mean, total), torch.where(both, ahead, 0)


def _hue_difference(one: Tensor, two: Tensor, product: Tensor, turn: Tensor) -> tuple[Tensor, Tensor]:
    """dH^2 and dH = 2 sqrt(C_1 C_2) sin(turn / 2), eq. 11, from the colours' dot and cross product.

    dH^2 = 2 (C_1 C_2 - dot) has the right slope at grey, where the root and the angle have none; for hues that are
    near, where its digits cancel, the same by cross^2 = (C_1 C_2 - dot) (C_1 C_2 + dot).
    """
    dot = (one * two).sum(-1)
    near = dot > 0
    cross = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    signed = cross / torch.where(near, (product + dot) / 2, 1).sqrt()
    square = (2 * (product - dot)).clamp_min(0)
    root = safe_power(square, 0.5) * turn.detach().sign()
    return torch.where(near, signed.square(), square), torch.where(near, signed, root)


def _saturation(chroma: Tensor) -> Tensor:
    """sqrt(C^7 / (C^7 + 25^7)), with the root drawn so that its gradient at 0 is the limit, 0."""
    ratio = chroma / 25
    return ratio.pow(3.5) / (1 + ratio.pow(7)).sqrt()


def _cos(hue: Tensor, times: int, degrees: float) -> Tensor:
    return torch.cos(times * hue + math.radians(degrees))
