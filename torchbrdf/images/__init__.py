"""How pictures are read, written, shown and compared."""

from torchbrdf.images.differences import DIFFERENCES, Difference
from torchbrdf.images.files import read_image, write_exr, write_png
from torchbrdf.images.tonemap import ToneMap, luminance, over

__all__ = [
    "DIFFERENCES",
    "Difference",
    "ToneMap",
    "luminance",
    "over",
    "read_image",
    "write_exr",
    "write_png",
]
