"""Just-objectionable differences as ColorVideoVDP predicts them; an extra."""

import importlib
import math
from types import ModuleType

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.images.differences.base import DIFFERENCES, Difference
from torchbrdf.images.encodings import check_luminance
from torchbrdf.precision import undisturbed
from torchbrdf.reduction import Reduction

# The library's `standard_4k`: 30 inches of 3840 x 2160 pixels, seen from twice its height, in an office.
PIXELS_PER_DEGREE = 75.4
PEAK = 200.0
_CONTRAST, _AMBIENT = 1000.0, 250.0  # lux


@DIFFERENCES.register("jod")
class JOD(Difference):
    """10 - JOD by ColorVideoVDP, of display values, sRGB; 0 for pictures that are equal, and lower is better.

    Quality in just-objectionable differences falls from 10, and 1 of them is what 75 % of observers would point out
    when they choose the better of two pictures beside the original. The model filters by contrast sensitivity at a
    number of pixels per degree and a luminance, masks, and pools over the whole picture: what lies outside the mask is
    grey in both and counts as equal, so that the figure falls as the object gets smaller in its frame. Contrast (1000)
    and light of the room (250 lux) are those of the library's display `standard_4k`, and so are the defaults. It works
    in float32. Differentiable; about 60 times as slow as `DeltaE76`.

    Args:
        pixels_per_degree: of the display, from where it is seen; at least 2.
        peak: luminance of the display's white, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Raises:
        UsageError: `cvvdp` is missing or cannot be imported (`pip install torchbrdf[cvvdp]`); or a setting is out of
            range.

    Source: R. Mantiuk et al., ColorVideoVDP: A Visual Difference Predictor for Image, Video and Display Distortions,
    2024, doi:10.1145/3658144.
    """

    unit = "JOD"
    extra = "cvvdp"
    least_side = 8  # for one band of its pyramid below the finest

    def __init__(
        self, pixels_per_degree: float = PIXELS_PER_DEGREE, peak: float = PEAK, *, reduction: Reduction = "none"
    ) -> None:
        super().__init__(reduction=reduction)
        if not 2 <= pixels_per_degree < math.inf:
            raise UsageError(f"JOD: expected pixels_per_degree of at least 2, found {pixels_per_degree}")
        self.pixels_per_degree, self.peak = pixels_per_degree, check_luminance(self, "peak", peak)
        _library()

    def extra_repr(self) -> str:
        """The settings."""
        return f"pixels_per_degree={self.pixels_per_degree:g}, peak={self.peak:g}, {super().extra_repr()}"

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The library's, of finite pictures; nan for others."""
        library = _library()
        # Made anew, which takes 10 ms: it keeps what depends on size and device, and threads may compare at once.
        with undisturbed():
            photometry = library.vvdp_display_photo_eotf(
                self.peak, contrast=_CONTRAST, source_colorspace="sRGB", E_ambient=_AMBIENT
            )
            geometry = library.vvdp_display_geometry(image.shape[2:0:-1], ppd=self.pixels_per_degree)
            metric = library.cvvdp(
                display_photometry=photometry, display_geometry=geometry, quiet=True, device=image.device
            )
        known = (image.isfinite() & reference.isfinite()).flatten(1).all(1) & mask.flatten(1).any(1)
        first, second = (picture.nan_to_num().clamp(0, 1).float() for picture in (image, reference))
        found = metric.loss(first, second, dim_order="BHWC").reshape(-1)
        return torch.where(known, found.to(image.dtype), torch.nan)

    def objective(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The same; rounding may carry it below 0."""
        return self.compare(image, reference, mask).clamp_min(0)


def jod(
    image: Tensor,
    reference: Tensor,
    mask: Tensor | None = None,
    *,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
    peak: float = PEAK,
    reduction: Reduction = "none",
) -> Tensor:
    """10 - JOD between pictures, by ColorVideoVDP.

    The functional form of `JOD`, which says more.

    Args:
        image: pictures `(B, H, W, 3)`, display values in [0, 1].
        reference: what each is compared with, `(B, H, W, 3)`.
        mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.
        pixels_per_degree: of the display, from where it is seen; at least 2.
        peak: luminance of the display's white, in cd/m^2.
        reduction: "none", "mean" or "sum" over the pictures.

    Returns:
        `(B,)`, or a scalar after a reduction; 0 for equal pictures, nan without a pixel that counts.

    Raises:
        ShapeError: pictures or mask have other shapes, or a side is below 8 pixels.
        UsageError: `cvvdp` is missing or cannot be imported; or a setting is out of range.
    """
    return JOD(pixels_per_degree, peak, reduction=reduction)(image, reference, mask)


def _library() -> ModuleType:
    """ColorVideoVDP, or a UsageError that says how it is to be had."""
    try:
        return importlib.import_module("pycvvdp")
    except Exception as error:  # whatever goes wrong in its own imports
        if isinstance(error, ModuleNotFoundError) and error.name == "pycvvdp":
            raise UsageError("jod: cvvdp is missing; pip install torchbrdf[cvvdp]") from None
        wanted = f"torchvision of the same release and build as torch {torch.__version__}"
        raise UsageError(f"jod: cvvdp cannot be imported; expected {wanted}, found {error}") from error
