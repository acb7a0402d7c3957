"""How pictures are read, written, shown and compared."""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports
from torchbrdf.images.differences import DIFFERENCES, Difference, PixelDifference
from torchbrdf.images.encodings import pq, pu21
from torchbrdf.images.files import read_image, write_exr, write_png
from torchbrdf.images.tone_mapping import ToneMap, composite, log_average_and_white, to_bytes, tonemap

if TYPE_CHECKING:
    from torchbrdf.images.differences.compressed_hdr import CompressedHDR, compressed_hdr
    from torchbrdf.images.differences.delta_e76 import DeltaE76, delta_e76
    from torchbrdf.images.differences.delta_e2000 import DeltaE2000, delta_e2000
    from torchbrdf.images.differences.delta_e_itp import DeltaEITP, DeltaEITPHDR, delta_e_itp, delta_e_itp_hdr
    from torchbrdf.images.differences.flip import FLIP, flip
    from torchbrdf.images.differences.jod import JOD, jod
    from torchbrdf.images.differences.log_hdr import LogHDR, log_hdr
    from torchbrdf.images.differences.ms_ssim import MSSSIM, ms_ssim
    from torchbrdf.images.differences.psnr import PSNR, psnr
    from torchbrdf.images.differences.pu21 import PUPSNR, PUSSIM, pu_psnr, pu_ssim
    from torchbrdf.images.differences.ssim import SSIM, ssim

# What needs kornia, which is slow to import: imported at first use.
_HOME = {
    "CompressedHDR": "differences.compressed_hdr",
    "compressed_hdr": "differences.compressed_hdr",
    "DeltaE76": "differences.delta_e76",
    "delta_e76": "differences.delta_e76",
    "DeltaE2000": "differences.delta_e2000",
    "delta_e2000": "differences.delta_e2000",
    "DeltaEITP": "differences.delta_e_itp",
    "DeltaEITPHDR": "differences.delta_e_itp",
    "delta_e_itp": "differences.delta_e_itp",
    "delta_e_itp_hdr": "differences.delta_e_itp",
    "FLIP": "differences.flip",
    "flip": "differences.flip",
    "JOD": "differences.jod",
    "jod": "differences.jod",
    "LogHDR": "differences.log_hdr",
    "log_hdr": "differences.log_hdr",
    "MSSSIM": "differences.ms_ssim",
    "ms_ssim": "differences.ms_ssim",
    "PSNR": "differences.psnr",
    "psnr": "differences.psnr",
    "PUPSNR": "differences.pu21",
    "PUSSIM": "differences.pu21",
    "pu_psnr": "differences.pu21",
    "pu_ssim": "differences.pu21",
    "SSIM": "differences.ssim",
    "ssim": "differences.ssim",
}
__all__ = [
    "DIFFERENCES",
    "FLIP",
    "JOD",
    "MSSSIM",
    "PSNR",
    "PUPSNR",
    "PUSSIM",
    "SSIM",
    "CompressedHDR",
    "DeltaE76",
    "DeltaE2000",
    "DeltaEITP",
    "DeltaEITPHDR",
    "Difference",
    "LogHDR",
    "PixelDifference",
    "ToneMap",
    "composite",
    "compressed_hdr",
    "delta_e76",
    "delta_e2000",
    "delta_e_itp",
    "delta_e_itp_hdr",
    "flip",
    "jod",
    "log_average_and_white",
    "log_hdr",
    "ms_ssim",
    "pq",
    "psnr",
    "pu21",
    "pu_psnr",
    "pu_ssim",
    "read_image",
    "ssim",
    "to_bytes",
    "tonemap",
    "write_exr",
    "write_png",
]

__getattr__, __dir__ = exports(__name__, _HOME)
