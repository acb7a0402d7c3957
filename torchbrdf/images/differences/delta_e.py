"""The CIELAB colour difference of 1976."""

from kornia.color import rgb_to_lab
from torch import Tensor

from torchbrdf.images.differences.base import DIFFERENCES, PixelDifference


def lab(picture: Tensor) -> Tensor:
    """CIELAB (D65, 2 degrees) of display values `(..., 3)`: L in [0, 100], a, b.

    kornia's wants sRGB; display values with gamma 2.2 are taken for sRGB, which is what a screen does with them.
    """
    pixels = picture.reshape(-1, 3).T[:, None]  # kornia's pixels are (3, H, W)
    return rgb_to_lab(pixels)[:, 0].T.reshape(picture.shape)


@DIFFERENCES.register("delta_e")
class DeltaE(PixelDifference):
    """Mean over pixels of sqrt(dL^2 + da^2 + db^2), the distance in CIELAB; 0 for pictures that are equal.

    Lab is described at `lab`. A difference of about 2.3 is just noticeable.
    Source: the formula of 1976 in CIE 15, Colorimetry; for the 2.3, M. Mahy et al., Evaluation of Uniform Color
    Spaces Developed after the Adoption of CIELAB and CIELUV, 1994, doi:10.1111/j.1520-6378.1994.tb00070.x.
    """

    power = 1

    def encode(self, picture: Tensor) -> Tensor:
        """L, a and b."""
        return lab(picture)
