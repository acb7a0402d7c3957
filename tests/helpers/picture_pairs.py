"""Pairs of pictures that image differences are tried on."""

import torch
from torch import Tensor

from torchbrdf.images import DIFFERENCES, Difference

Pictures = tuple[Tensor, Tensor, Tensor]
# Every difference that the package comes with; those that need an extra are tried apart, where it is installed.
NAMES = [name for name, kind in DIFFERENCES.items() if not kind.extra]


def pair(batch: int = 2, height: int = 24, width: int = 20) -> Pictures:
    generator = torch.Generator().manual_seed(3)
    reference = torch.rand(batch, height, width, 3, generator=generator, dtype=torch.float64)
    noise = 0.2 * torch.rand(reference.shape, generator=generator, dtype=torch.float64)
    image = (reference + noise - 0.1).clamp(0, 1)
    mask = torch.rand(height, width, generator=generator) > 0.3
    return image, reference, mask


def pictures(difference: Difference, batch: int = 2, side: int = 0) -> Pictures:
    """A pair that the difference is defined for: display values, or radiance up to 4."""
    least = max(difference.least_side, side)
    image, reference, mask = pair(batch, least + 4, least) if least > 24 or side else pair(batch)
    scale = 4.0 if difference.linear else 1.0
    return scale * image, scale * reference, mask


def gradient(difference: Difference, image: Tensor, reference: Tensor, mask: Tensor | None = None) -> Tensor:
    """The slope of the loss."""
    image = image.clone().requires_grad_()
    (slope,) = torch.autograd.grad(difference.loss(image, reference, mask).sum(), image)
    return slope
