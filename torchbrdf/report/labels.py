"""Words and cells that the report's parts share."""

from dataclasses import dataclass

from torchbrdf.losses import LOSSES

LOSS_LABELS = {"rms": "RMS", "cosine_rms": "cosine RMS", "cube_root": "cube root"}

DIFFERENCE_LABELS = {
    "psnr": "PSNR",
    "ssim": "SSIM",
    "ms_ssim": "MS-SSIM",
    "flip": "FLIP",
    "delta_e": "ΔE 76",
    "delta_e2000": "ΔE 2000",
    "log_hdr": "log HDR",
    "compressed_hdr": "compressed HDR",
}


@dataclass(frozen=True)
class Cell:
    """A cell of a table."""

    text: str
    best: bool = False
    outlier: bool = False


def loss_label(name: str) -> str:
    """A metric's name for people."""
    if name.startswith("rendered_"):
        return f"rendered {difference_label(name.removeprefix('rendered_'))}"
    name = LOSSES.canonical(name)
    return LOSS_LABELS.get(name, name.replace("_", " "))


def difference_label(name: str) -> str:
    """An image difference's name for people."""
    return DIFFERENCE_LABELS.get(name, name.replace("_", " "))


def model_label(name: str) -> str:
    """A model's name for people."""
    return "-".join(word.capitalize() for word in name.split("_"))
