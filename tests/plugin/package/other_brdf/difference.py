"""An image difference."""

from torch import Tensor

from torchbrdf.images import PixelDifference


class MyDifference(PixelDifference):
    """Root mean square of square roots of radiance."""

    linear = True

    def encode(self, picture: Tensor) -> Tensor:
        """The root, with a finite slope."""
        return (picture.clamp_min(0) + 1e-3).sqrt()
