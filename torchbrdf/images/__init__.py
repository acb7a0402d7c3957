"""How pictures are read, written, shown and compared."""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports
from torchbrdf.images.differences import DIFFERENCES, Difference, PixelDifference
from torchbrdf.images.files import read_image, write_exr, write_png
from torchbrdf.images.tone_mapping import ToneMap, composite, log_average_and_white, to_bytes, tonemap

if TYPE_CHECKING:
    from torchbrdf.images.differences.compressed_hdr import CompressedHDR, compressed_hdr
    from torchbrdf.images.differences.delta_e76 import DeltaE76, delta_e76
    from torchbrdf.images.differences.delta_e2000 import DeltaE2000, delta_e2000
    from torchbrdf.images.differences.flip import FLIP, flip
    from torchbrdf.images.differences.log_hdr import LogHDR, log_hdr
    from torchbrdf.images.differences.ms_ssim import MSSSIM, ms_ssim
    from torchbrdf.images.differences.psnr import PSNR, psnr
    from torchbrdf.images.differences.ssim import SSIM, ssim

# What needs kornia, which is slow to import: imported at first use.
_HOME = {
    "CompressedHDR": "differences.compressed_hdr",
    "compressed_hdr": "differences.compressed_hdr",
    "DeltaE2000": "differences.delta_e2000",
    "delta_e2000": "differences.delta_e2000",
    "DeltaE76": "differences.delta_e76",
    "delta_e76": "differences.delta_e76",
    "FLIP": "differences.flip",
    "flip": "differences.flip",
    "LogHDR": "differences.log_hdr",
    "log_hdr": "differences.log_hdr",
    "MSSSIM": "differences.ms_ssim",
    "ms_ssim": "differences.ms_ssim",
    "PSNR": "differences.psnr",
    "psnr": "differences.psnr",
    "SSIM": "differences.ssim",
    "ssim": "differences.ssim",
}
__all__ = [
    "DIFFERENCES",
    "FLIP",
    "MSSSIM",
    "PSNR",
    "SSIM",
    "CompressedHDR",
    "DeltaE76",
    "DeltaE2000",
    "Difference",
    "LogHDR",
    "PixelDifference",
    "ToneMap",
    "composite",
    "compressed_hdr",
    "delta_e76",
    "delta_e2000",
    "flip",
    "log_average_and_white",
    "log_hdr",
    "ms_ssim",
    "psnr",
    "read_image",
    "ssim",
    "to_bytes",
    "tonemap",
    "write_exr",
    "write_png",
]

__getattr__, __dir__ = exports(__name__, _HOME)
