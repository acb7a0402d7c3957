"""How far apart two pictures are. A difference a file."""

from torchbrdf.images.differences.base import DIFFERENCES, Difference, PixelDifference

__all__ = ["DIFFERENCES", "Difference", "PixelDifference"]
