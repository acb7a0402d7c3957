"""FLIP: the difference that an observer sees when two pictures alternate."""

import math

import numpy as np
import torch
from kornia.color import rgb_to_linear_rgb
from torch import Tensor
from torch.nn import functional

from torchbrdf.color import safe_power
from torchbrdf.errors import UsageError
from torchbrdf.images.differences.base import (
    DIFFERENCES,
    Difference,
    channels_first,
    masked_mean,
)
from torchbrdf.reduction import Reduction
from torchbrdf.roots import safe_norm

# Linear sRGB to XYZ, IEC 61966-2-1, exact, as the source has it; kornia's is rounded. Relative to white, (1, 1, 1).
_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
_TO_XYZ = (_XYZ / _XYZ.sum(1, keepdims=True)).tolist()
_TO_RGB = np.linalg.inv(_TO_XYZ).tolist()
# Contrast sensitivity: a and b of both Gaussians of each opponent channel, table 1.
_SENSITIVITY = (
    ((1.0, 0.0047),),
    ((1.0, 0.0053),),
    ((34.1, 0.04), (13.5, 0.025)),
)
_WIDEST = 0.04
_POWER, _KNEE, _AT_KNEE = 0.7, 0.4, 0.95  # q_c, p_c, p_t
_FEATURE_WIDTH, _FEATURE_POWER = 0.082, 0.5  # w in degrees, q_f
PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * math.pi / 180  # 3840 pixels over 0.7 m, seen from 0.7 m
_GREEN_TO_BLUE = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # the pair of colours that is furthest apart


@DIFFERENCES.register("flip")
class FLIP(Difference):
    """Mean over pixels of FLIP between display values, sRGB, seen at a number of pixels per degree.

    E_c^(1 - E_f) in every pixel, in [0, 1], 0 for pictures that are equal. E_c: how far apart the colours are that
    are left after the eye's contrast sensitivity, by HyAB in CIELAB with Hunt's effect, to the power 0.7, stretched
    to [0, 1] so that 0.4 of the largest becomes 0.95. E_f: how much more of an edge or a point there is in one
    picture, to the power 0.5. Both powers have an infinite slope where pictures are equal; there it counts as 0.
    67.02 pixels per degree are those of 3840 pixels over 0.7 m seen from 0.7 m. Symmetric; without unit.

    Args:
        pixels_per_degree: of the display, from where it is seen; at least 2.
        reduction: "none", "mean" or "sum" over the pictures.

    Raises:
        UsageError: pixels_per_degree is below 2.

    Source: P. Andersson et al., FLIP: A Difference Evaluator for Alternating Images, 2020, doi:10.1145/3406183.

    Example:
        >>> from torchbrdf.images import FLIP
        >>> FLIP(pixels_per_degree=40)
        FLIP(pixels_per_degree=40, reduction='none')
    """

    def __init__(self, pixels_per_degree: float = PIXELS_PER_DEGREE, *, reduction: Reduction = "none") -> None:
        super().__init__(reduction=reduction)
        if not 2 <= pixels_per_degree < math.inf:  # below, no neighbour would be in reach of the edge filters
            raise UsageError(f"FLIP: expected pixels_per_degree of at least 2, found {pixels_per_degree}")
        self.pixels_per_degree = pixels_per_degree

    def extra_repr(self) -> str:
        """The settings."""
        return f"pixels_per_degree={self.pixels_per_degree:g}, {super().extra_repr()}"

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The mean of the map."""
        return masked_mean(self.map(image, reference), mask)

    def map(self, image: Tensor, reference: Tensor) -> Tensor:
        """FLIP of every pixel, `(B, H, W)`, of display values `(B, H, W, 3)`."""
        first, second = (_opponent(rgb_to_linear_rgb(channels_first(x))) for x in (image, reference))
        colour = self._colour(first, second)
        feature = self._feature(first[:, :1], second[:, :1])
        # colour^(1 - feature), whose slope by colour is infinite at 0
        different = colour > 0
        return torch.where(different, torch.where(different, colour, 1).pow(1 - feature), 0 * colour)

    def _colour(self, first: Tensor, second: Tensor) -> Tensor:
        """E_c, `(B, H, W)`, of opponent pictures."""
        pair = torch.tensor(_GREEN_TO_BLUE, dtype=first.dtype, device=first.device)[:, :, None, None]
        green, blue = _perceived(_opponent(pair)).split(1)
        largest = _hyab(green, blue).pow(_POWER)
        apart = _hyab(_perceived(self._filtered(first)), _perceived(self._filtered(second)))
        share = safe_power(apart, _POWER) / largest
        above = _AT_KNEE + (share - _KNEE) / (1 - _KNEE) * (1 - _AT_KNEE)
        return torch.where(share < _KNEE, share * (_AT_KNEE / _KNEE), above)

    def _filtered(self, opponent: Tensor) -> Tensor:
        """What of `(B, 3, H, W)` the eye resolves, by its contrast sensitivity in each channel."""
        radius = math.ceil(3 * math.sqrt(_WIDEST / (2 * math.pi**2)) * self.pixels_per_degree)
        degrees = _offsets(radius, opponent) / self.pixels_per_degree
        filtered = []
        for channel, gaussians in zip(opponent.split(1, 1), _SENSITIVITY, strict=True):
            heights = [a * math.sqrt(math.pi / b) for a, b in gaussians]
            kernels = [torch.exp(-(math.pi**2) / b * degrees.square()) for _, b in gaussians]
            parts = [height * _convolved(channel, taps, taps) for height, taps in zip(heights, kernels, strict=True)]
            weight = [height * taps.sum().square() for height, taps in zip(heights, kernels, strict=True)]
            filtered.append(torch.stack(parts).sum(0) / torch.stack(weight).sum())
        return torch.cat(filtered, 1)

    def _feature(self, first: Tensor, second: Tensor) -> Tensor:
        """E_f, `(B, H, W)`, of luminances `(B, 1, H, W)`: the larger of the changes of edges and points."""
        width = 0.5 * _FEATURE_WIDTH * self.pixels_per_degree
        pixels = _offsets(math.ceil(3 * width), first)
        bell = torch.exp(-pixels.square() / (2 * width**2))
        smooth = bell / bell.sum()
        changes = []
        for kernel in (-pixels * bell, (pixels.square() / width**2 - 1) * bell):
            # Both signs sum to 1, so that the largest response is 1.
            taps = torch.where(kernel > 0, kernel / kernel.clamp_min(0).sum(), kernel / -kernel.clamp_max(0).sum())
            strengths = []
            for picture in (first, second):
                both = torch.cat([_convolved(picture, smooth, taps), _convolved(picture, taps, smooth)], 1)
                strengths.append(safe_norm(both, dim=1))
            changes.append((strengths[0] - strengths[1]).abs())
        return safe_power(torch.maximum(*changes) / math.sqrt(2), _FEATURE_POWER)


def flip(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
    reduction: Reduction = "none",
) -> Tensor:
    """Mean FLIP between pictures: the difference seen when they alternate.

    The functional form of `FLIP`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, display values in [0, 1].
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        pixels_per_degree: of the display, from where it is seen.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 0 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes.
        UsageError: pixels_per_degree is below 2.

    Example:
        >>> import torch
        >>> from torchbrdf.images import flip
        >>> flip(torch.zeros(1, 8, 8, 3), torch.full((1, 8, 8, 3), 0.5))
        tensor([0.9315])
    """
    return FLIP(pixels_per_degree, reduction=reduction)(image, reference, mask)


def _offsets(radius: int, like: Tensor) -> Tensor:
    """-radius ... radius."""
    return torch.arange(-radius, radius + 1, dtype=like.dtype, device=like.device)


def _convolved(plane: Tensor, down: Tensor, across: Tensor) -> Tensor:
    """`(B, 1, H, W)` under a separable kernel, the border's pixels repeated outwards."""
    radius = len(down) // 2
    padded = functional.pad(plane, (radius, radius, radius, radius), mode="replicate")
    return functional.conv2d(functional.conv2d(padded, down.view(1, 1, -1, 1)), across.view(1, 1, 1, -1))


def _transformed(picture: Tensor, matrix: list[list[float]]) -> Tensor:
    """The matrix times every pixel of `(B, 3, H, W)`."""
    return torch.einsum("ij,bjhw->bihw", picture.new_tensor(matrix), picture)


def _opponent(linear: Tensor) -> Tensor:
    """Y, X - Y and Y - Z of linear sRGB `(B, 3, H, W)`.

    The source filters YCxCz, which are 116 Y - 16, 500 (X - Y) and 200 (Y - Z): the filters keep scale and offset, and
    without them black stays exactly 0, where the clamp to what can be shown would cut gradients off.
    """
    x, y, z = _transformed(linear, _TO_XYZ).unbind(1)
    return torch.stack([y, x - y, y - z], 1)


def _perceived(opponent: Tensor) -> Tensor:
    """CIELAB with Hunt's effect, L, 0.01 L a and 0.01 L b, of what of `_opponent` can be shown."""
    y, x_y, y_z = opponent.unbind(1)
    xyz = torch.stack([y + x_y, y, y - y_z], 1)
    # Through sRGB and back, for the sake of its limits.
    xyz = _transformed(_transformed(xyz, _TO_RGB).clamp(0, 1), _TO_XYZ)
    knee = 6 / 29
    root = torch.where(xyz > knee**3, xyz.clamp_min(knee**3).pow(1 / 3), xyz / (3 * knee**2) + 4 / 29)
    x, y, z = root.unbind(1)
    lightness = 116 * y - 16
    return torch.stack([lightness, 5 * lightness * (x - y), 2 * lightness * (y - z)], 1)


def _hyab(first: Tensor, second: Tensor) -> Tensor:
    """|dL| + sqrt(da^2 + db^2), `(B, H, W)`, of `(B, 3, H, W)`; its gradient is 0 where a term is 0."""
    apart = first - second
    return apart[:, 0].abs() + safe_norm(apart[:, 1:], dim=1)
