"""How pictures are read, written, shown and compared."""

from torchbrdf.images.differences import DIFFERENCES, Difference, PixelDifference
from torchbrdf.images.files import read_image, write_exr, write_png
from torchbrdf.images.tone_mapping import ToneMap, composite, log_average_and_white, tonemap

__all__ = [
    "DIFFERENCES",
    "Difference",
    "PixelDifference",
    "ToneMap",
    "composite",
    "log_average_and_white",
    "read_image",
    "tonemap",
    "write_exr",
    "write_png",
]
