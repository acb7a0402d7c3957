"""What an image difference is: one number for each pair of display pictures."""

from typing import ClassVar

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.registry import Registry

DIFFERENCES: Registry[type["Difference"]] = Registry("difference", "torchbrdf.images.differences")


class Difference:
    """A number for each pair of pictures: `difference(image, reference, mask)` gives `(B,)`.

    Pictures are display values in [0, 1], `(B, H, W, 3)`; the mask, `(H, W)` or `(B, H, W)`, says which pixels count.
    A subclass registers itself, says which way is better and in what unit, and gives `compare`.
    """

    higher_is_better: ClassVar[bool]
    unit: ClassVar[str] = ""

    def __call__(self, image: Tensor, reference: Tensor, mask: Tensor | None = None) -> Tensor:
        """The difference of every picture from its reference, `(B,)`; without a pixel that counts, nan."""
        name = type(self).__name__
        if image.dim() != 4 or image.shape[-1] != 3 or image.shape != reference.shape:
            shapes = f"image {(*image.shape,)}, reference {(*reference.shape,)}"
            raise ShapeError(f"{name}: expected two pictures (B, H, W, 3), found {shapes}")
        counted = torch.ones(image.shape[:-1], dtype=torch.bool, device=image.device)
        if mask is not None:
            if mask.shape not in (image.shape[1:3], image.shape[:3]):
                raise ShapeError(f"{name}: expected a mask {(*image.shape[1:3],)}, found {(*mask.shape,)}")
            counted = counted & mask.to(image.device, torch.bool)
        return self.compare(image, reference, counted)

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The difference, `(B,)`, of checked pictures; mask `(B, H, W)`."""
        raise NotImplementedError


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean of `(B, H, W)` over the pixels of the mask, `(B,)`."""
    return torch.where(mask, values, 0).sum((-2, -1)) / mask.sum((-2, -1))
