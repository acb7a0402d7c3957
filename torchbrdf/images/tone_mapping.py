"""From linear pictures to display values, Reinhard's global operator, measured once and then frozen; and to bytes."""

import logging
import math
from dataclasses import asdict, dataclass

import numpy as np
import torch
from torch import Tensor

from torchbrdf.color import luminance, safe_power
from torchbrdf.errors import DataError, ShapeError, UsageError, shown

# Added to every luminance before its logarithm, as the implementation that the paper used does.
_DELTA = 1e-5
# Of the numbers of a tone map: their squares are numbers, too.
_LARGEST = 1e100

# How a value that is no number is shown: magenta, which no tone map makes of a whole area by itself.
NOT_A_NUMBER = (255, 0, 255)


def to_bytes(display: Tensor) -> np.ndarray:
    """Display values as bytes, as every file of pictures has them.

    Args:
        display: Display values, `(..., 3)`, clamped to [0, 1]; a pixel with a NaN becomes magenta.

    Returns:
        `(..., 3)`, uint8.

    Example:
        >>> to_bytes(torch.tensor([[0.0, 0.5, 1.0], [0.0, torch.nan, 0.0]])).tolist()
        [[0, 128, 255], [255, 0, 255]]
    """
    display = display.detach().cpu().to(torch.float32)
    pixels = (display.nan_to_num(0).clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    pixels[display.isnan().any(-1).numpy()] = NOT_A_NUMBER
    return pixels


def composite(display: Tensor, coverage: Tensor, background: float = 0.5) -> Tensor:
    """Lay a picture over a grey background.

    Args:
        display: Display values, `(..., H, W, 3)`.
        coverage: The share of each pixel that the picture covers, 0 to 1, `(H, W)`.
        background: The display value of the grey.

    Returns:
        Display values, `(..., H, W, 3)`.

    Example:
        >>> composite(torch.ones(1, 2, 3), torch.tensor([[0.0, 1.0]]))[0, :, 0]
        tensor([0.5000, 1.0000])
    """
    return torch.lerp(torch.full_like(display, background), display, coverage[..., None].to(display))


def log_average_and_white(light: Tensor, key: float = 0.18) -> tuple[Tensor, Tensor]:
    """What Reinhard's global operator measures of pictures: log-average luminance and white.

    Args:
        light: Luminances of the pixels of each picture, `(..., n)`.
        key: The display luminance of the log-average.

    Returns:
        The log-average, in the unit of `light`, and the scaled luminance that becomes white, `(...)` each, float64.

    Source: see `ToneMap`.
    """
    light = light.to(torch.float64).clamp_min(0)
    log_average = (light + _DELTA).log().mean(-1).exp()
    return log_average, key * light.amax(-1) / log_average


def tonemap(
    image: Tensor, log_average: Tensor | float, white: Tensor | float, key: float = 0.18, gamma: float = 2.2
) -> Tensor:
    """Tone-map linear pictures by Reinhard's global operator, the functional form of `ToneMap`.

    Args:
        image: Linear radiance, `(..., 3)`; negative values count as 0, with gradient 0.
        log_average: As `log_average_and_white` gives it; a number, or one for each of several pictures, `(..., 1)`.
        white: The same.
        key: The display luminance of the log-average.
        gamma: Of the display.

    Returns:
        Display values in [0, 1], `(..., 3)`. An infinite channel is 1, as its limit is; a pixel with a NaN is NaN, so
        that losses do not take it for a colour, and `to_bytes` makes it magenta.

    Source: see `ToneMap`.

    Example:
        >>> tonemap(torch.tensor([0.0, 0.0, torch.inf]), log_average=0.5, white=2.0)
        tensor([0., 0., 1.])
    """
    image = image.clamp_min(0)
    exposure = key / log_average
    scaled = luminance(image)[..., None] * exposure
    above = 1 + scaled / white**2
    # L_d / Y without a division by Y, so that black has a finite gradient; beyond what the dtype holds, the limit.
    huge = above.isinf()
    ratio = torch.where(
        huge, exposure / white / white, exposure * torch.where(huge, 1, above) / torch.where(huge, 1, 1 + scaled)
    )
    return safe_power((image * ratio).clamp_max(1), 1 / gamma)


@dataclass(frozen=True)
class ToneMap:
    """Reinhard's global operator with its two scene-dependent numbers fixed, so that pictures stay comparable.

    With Y the luminance and L = key Y / log_average: L_d = L (1 + L / white^2) / (1 + L); display values are
    clip(rgb L_d / Y)^(1 / gamma). `white` is the scaled luminance that becomes 1. The paper used the implementation
    of pfstools (pfstmo_reinhard02), whose global form has no other white than the largest luminance of its picture;
    `from_images` therefore takes the largest of the composite. `phi` is the sharpness of the operator's local form;
    the paper lists it, the global form has no use for it: it is recorded and ignored.

    Args:
        log_average: Of the luminances of the picture that it was measured on, in their unit.
        white: The scaled luminance that becomes white.
        key: The display luminance of the log-average.
        gamma: Of the display.
        phi: Recorded and ignored.

    Raises:
        UsageError: A number is not above 0, or above 1e100.

    Source: E. Reinhard et al., Photographic Tone Reproduction for Digital Images, 2002, doi:10.1145/566654.566575,
    eq. 1, 2 and 4.

    Example:
        >>> tone = ToneMap.from_images(torch.tensor([[[1.0, 1.0, 1.0], [0.1, 0.1, 0.1]]]))
        >>> tone(torch.tensor([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]))
        tensor([[1., 1., 1.],
                [0., 0., 0.]])
    """

    log_average: float
    white: float
    key: float = 0.18
    gamma: float = 2.2
    phi: float = 1.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not (isinstance(value, int | float) and 0 < value < _LARGEST):
                raise UsageError(
                    f"ToneMap.{name}: expected a number above 0 and below {_LARGEST:g}, found {shown(value)}"
                )

    @classmethod
    def from_images(
        cls, images: Tensor, mask: Tensor | None = None, key: float = 0.18, gamma: float = 2.2, phi: float = 1.0
    ) -> "ToneMap":
        """Tone map measured on pictures, over all of them together.

        Args:
            images: Linear, `(..., H, W, 3)`. Pixels that are not finite do not count, and the log says how many.
            mask: Which pixels count, `(..., H, W)`; by default all.
            key: As for the class.
            gamma: As for the class.
            phi: As for the class.

        Raises:
            ShapeError: The images have other than three channels.
            DataError: No pixel counts, or all are black.
        """
        if images.shape[-1:] != (3,):
            raise ShapeError(f"ToneMap: expected images (..., 3), found {(*images.shape,)}")
        light = luminance(images.detach()).clamp_min(0)
        if mask is not None:
            light = light[mask.to(light.device, torch.bool).expand(light.shape)]
        if not light.numel():
            raise DataError("ToneMap: no pixel to measure; the mask is empty")
        finite = light.isfinite()
        count = light.numel() - int(finite.sum())
        light = light[finite]
        largest = float(light.max()) if light.numel() else math.nan
        if not largest > 0:
            found = "nothing but black, as of materials whose values are all 0" if largest == 0 else "no finite pixel"
            raise DataError(f"ToneMap: expected pictures with some light, found {found}")
        if count:
            message = "torchbrdf: tone map: %d of %d pixels are not finite and do not count"
            logging.getLogger("torchbrdf").warning(message, count, finite.numel())
        log_average, white = log_average_and_white(light, key)
        return cls(log_average.item(), white.item(), key, gamma, phi)

    def __call__(self, image: Tensor) -> Tensor:
        """Display values in [0, 1] of linear `(..., 3)`, as `tonemap` has them."""
        return tonemap(image, self.log_average, self.white, self.key, self.gamma)

    def to_dict(self) -> dict[str, float]:
        """The numbers by name, for a record."""
        return asdict(self)
