"""How pictures are read, written, shown and compared."""

from torchbrdf.images.differences import DIFFERENCES, Difference, PixelDifference
from torchbrdf.images.files import read_image, write_exr, write_png
from torchbrdf.images.tonemap import ToneMap, displayed, measured, over

__all__ = [
    "DIFFERENCES",
    "Difference",
    "PixelDifference",
    "ToneMap",
    "displayed",
    "measured",
    "over",
    "read_image",
    "write_exr",
    "write_png",
]
