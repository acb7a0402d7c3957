"""What an image difference is: one number for each pair of pictures, to report and to minimise."""

from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchbrdf.color import safe_power
from torchbrdf.errors import ShapeError
from torchbrdf.kinds import DIFFERENCES as _DIFFERENCES
from torchbrdf.precision import widened, without_autocast
from torchbrdf.reduction import Reduction, check_reduction, reduced
from torchbrdf.registry import Registry
from torchbrdf.roots import safe_norm

DIFFERENCES: Registry[type["Difference"]] = _DIFFERENCES

# What both pictures show where nothing counts, so that windows that reach there see them equal.
_GREY = 0.5


class Difference(nn.Module):
    """How far apart two pictures are: `difference(image, reference, mask)` gives a number for each pair.

    Pictures are `(B, H, W, 3)`, float: linear radiance if `linear`, else display values in [0, 1]. The mask, `(H, W)`
    or `(B, H, W)`, says which pixels count; elsewhere both pictures are taken for grey (0.5), whatever they hold.
    Pictures of half precision are compared in float32, and what is found is given in theirs.
    Calling gives the figure that is reported; `loss` gives what a fit minimises, a measure of the same thing.

    A subclass registers itself, says what it compares, which way is better, in what unit and on how small a picture,
    and gives `compare`, the figure; and `objective`, where the figure is not itself a loss.

    Args:
        reduction: "none" gives `(B,)`, one for each pair of pictures; "mean" and "sum" a scalar.

    Raises:
        UsageError: the reduction is none of these.

    Example:
        >>> import torch
        >>> from torchbrdf.images import DIFFERENCES
        >>> image, reference = torch.zeros(2, 8, 8, 3), torch.full((2, 8, 8, 3), 0.1)
        >>> DIFFERENCES["psnr"]()(image, reference)
        tensor([20., 20.])
        >>> DIFFERENCES["psnr"](reduction="mean").loss(image, reference)
        tensor(0.0100)
    """

    linear: ClassVar[bool] = False
    higher_is_better: ClassVar[bool] = False
    unit: ClassVar[str] = ""
    least_side: ClassVar[int] = 1
    """The smallest side, in pixels, of the pictures that it is defined for."""
    extra: ClassVar[str] = ""
    """What has to be installed for it beside torchbrdf, as in `pip install torchbrdf[extra]`; "" if nothing has."""

    def __init__(self, *, reduction: Reduction = "none") -> None:
        super().__init__()
        check_reduction(self, reduction)
        self.reduction: Reduction = reduction

    @property
    def registered_name(self) -> str:
        """The name it is registered under; its class's, if it is not."""
        return DIFFERENCES.name_of(type(self)) or type(self).__name__

    def forward(self, image: Tensor, reference: Tensor, mask: Tensor | None = None) -> Tensor:
        """The difference of every picture from its reference; without a pixel that counts, nan.

        Args:
            image: pictures `(B, H, W, 3)`.
            reference: what each is compared with, `(B, H, W, 3)`.
            mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.

        Returns:
            `(B,)`, or a scalar after a reduction.

        Raises:
            ShapeError: the pictures or the mask have other shapes, or the pictures are too small.
        """
        return self._reduced(self.compare, image, reference, mask)

    def loss(self, image: Tensor, reference: Tensor, mask: Tensor | None = None) -> Tensor:
        """What a fit minimises: at least 0, and 0 for equal pictures; without a pixel that counts, nan.

        Its gradient is finite everywhere: where the true one is infinite or undefined, as at equal pixels, it is 0.

        Args:
            image: pictures `(B, H, W, 3)`.
            reference: what each is compared with, `(B, H, W, 3)`.
            mask: which pixels count, `(H, W)` or `(B, H, W)`; None: all.

        Returns:
            `(B,)`, or a scalar after a reduction.

        Raises:
            ShapeError: the pictures or the mask have other shapes, or the pictures are too small.
        """
        return self._reduced(self.objective, image, reference, mask)

    def extra_repr(self) -> str:
        """The settings."""
        return f"reduction={self.reduction!r}"

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The figure, `(B,)`, of checked pictures of one dtype; mask `(B, H, W)`, bool."""
        raise NotImplementedError

    def objective(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The loss, `(B,)`, of checked pictures: the figure, if nothing else is said."""
        return self.compare(image, reference, mask)

    def _reduced(
        self, measure: Callable[[Tensor, Tensor, Tensor], Tensor], image: Tensor, reference: Tensor, mask: Tensor | None
    ) -> Tensor:
        """A measure of checked pictures, those of half precision in float32 and without autocast, in their dtype."""
        image, reference, mask = self._checked(image, reference, mask)
        with without_autocast(image.device.type):
            found = measure(widened(image), widened(reference), mask)
        return reduced(found.to(image.dtype), self.reduction)

    def _checked(self, image: Tensor, reference: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        name = type(self).__name__
        if image.dim() != 4 or image.shape[-1] != 3 or image.shape != reference.shape:
            shapes = f"image {(*image.shape,)}, reference {(*reference.shape,)}"
            raise ShapeError(f"{name}: expected two pictures (B, H, W, 3), found {shapes}")
        if not (image.is_floating_point() and reference.is_floating_point()):
            raise ShapeError(f"{name}: expected pictures of floats, found {image.dtype} and {reference.dtype}")
        if min(image.shape[1:3]) < self.least_side:
            side, shape = self.least_side, (*image.shape,)
            raise ShapeError(f"{name}: expected pictures of at least {side} x {side} pixels, found {shape}")
        dtype = torch.promote_types(image.dtype, reference.dtype)
        image, reference = image.to(dtype), reference.to(dtype)
        if mask is None:
            return image, reference, torch.ones(image.shape[:-1], dtype=torch.bool, device=image.device)
        if mask.shape not in (image.shape[1:3], image.shape[:3]):
            raise ShapeError(f"{name}: expected a mask {(*image.shape[1:3],)}, found {(*mask.shape,)}")
        mask = mask.to(image.device, torch.bool).expand(image.shape[:3])
        counted = mask[..., None]
        return torch.where(counted, image, _GREY), torch.where(counted, reference, _GREY), mask


class PixelDifference(Difference):
    """A mean over pixels of how far apart they are, each encoded by itself, so that Gauss-Newton solvers apply.

    With e = encode(image) - encode(reference), `(..., F)`, and |e| its length in a pixel:
    power 2: the figure is sqrt(mean(|e|^2) / F), the root mean square, and the loss the mean square mean(|e|^2) / F;
    power 1: figure and loss are mean(|e|), with gradient 0 in pixels where e = 0.
    A subclass gives `encode`.

    Example:
        >>> import torch
        >>> from torchbrdf.images import DIFFERENCES
        >>> DIFFERENCES["log_hdr"](eps=0.5).encode(torch.tensor([[0.0, 0.5, 1.0]]))
        tensor([[0.0000, 0.6931, 1.0986]])
    """

    power: ClassVar[int] = 2

    def encode(self, picture: Tensor) -> Tensor:
        """What is compared of every pixel: `(..., 3)` to `(..., F)`."""
        raise NotImplementedError

    def compare(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The root mean square, or the mean length."""
        objective = self.objective(image, reference, mask)
        return safe_power(objective, 0.5) if self.power == 2 else objective

    def objective(self, image: Tensor, reference: Tensor, mask: Tensor) -> Tensor:
        """The mean square, or the mean length."""
        difference = self.encode(image) - self.encode(reference)
        if self.power == 2:
            return masked_mean(difference.square().mean(-1), mask)
        return masked_mean(safe_norm(difference), mask)


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean of `(B, H, W)` over the pixels of the mask, `(B,)`."""
    return torch.where(mask, values, 0).sum((-2, -1)) / mask.sum((-2, -1))


def channels_first(picture: Tensor) -> Tensor:
    """`(B, H, W, 3)` as `(B, 3, H, W)`."""
    return torch.movedim(picture, -1, 1)
