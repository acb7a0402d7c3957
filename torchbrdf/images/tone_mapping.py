"""From linear pictures to display values: Reinhard's global operator, measured once and then frozen."""

import math
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from torchbrdf.color import luminance, safe_power
from torchbrdf.errors import DataError, ShapeError, UsageError

# Added to every luminance before its logarithm, as the implementation that the paper used does.
_DELTA = 1e-5


def composite(display: Tensor, coverage: Tensor, background: float = 0.5) -> Tensor:
    """Display values `(..., H, W, 3)` where `coverage` `(H, W)` is 1, a grey `background` where it is 0."""
    return torch.lerp(torch.full_like(display, background), display, coverage[..., None].to(display))


def log_average_and_white(light: Tensor, key: float = 0.18) -> tuple[Tensor, Tensor]:
    """The log-average and the white of luminances `(..., n)`, `(...)` each, float64."""
    light = light.to(torch.float64).clamp_min(0)
    log_average = (light + _DELTA).log().mean(-1).exp()
    return log_average, key * light.amax(-1) / log_average


def tonemap(
    image: Tensor, log_average: Tensor | float, white: Tensor | float, key: float = 0.18, gamma: float = 2.2
) -> Tensor:
    """What `ToneMap` does, also with numbers of their own for each of several pictures, `(..., 1)`."""
    image = image.clamp_min(0)
    exposure = key / log_average
    scaled = luminance(image)[..., None] * exposure
    # L_d / Y without a division by Y, so that black has a finite gradient.
    ratio = exposure * (1 + scaled / white**2) / (1 + scaled)
    return safe_power((image * ratio).clamp_max(1), 1 / gamma)


@dataclass(frozen=True)
class ToneMap:
    """Reinhard's global operator with its two scene-dependent numbers fixed, so that pictures stay comparable.

    With Y the luminance and L = key Y / log_average: L_d = L (1 + L / white^2) / (1 + L); display values are
    clip(rgb L_d / Y)^(1 / gamma). `white` is the scaled luminance that becomes 1. The paper used the implementation
    of pfstools (pfstmo_reinhard02), whose global form has no other white than the largest luminance of its picture;
    `from_images` therefore takes the largest of the composite. `phi` is the sharpness of the operator's local form;
    the paper lists it, the global form has no use for it: it is recorded and ignored.

    Source: E. Reinhard et al., Photographic Tone Reproduction for Digital Images, 2002, doi:10.1145/566654.566575,
    eq. 1, 2 and 4.
    """

    log_average: float
    white: float
    key: float = 0.18
    gamma: float = 2.2
    phi: float = 1.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
                raise UsageError(f"ToneMap.{name}: expected a number above 0, found {value!r}")

    @classmethod
    def from_images(
        cls, images: Tensor, mask: Tensor | None = None, key: float = 0.18, gamma: float = 2.2, phi: float = 1.0
    ) -> "ToneMap":
        """Measured over the composite of linear `images` `(..., H, W, 3)`, where `mask` `(..., H, W)` is true."""
        if images.shape[-1:] != (3,):
            raise ShapeError(f"ToneMap: expected images (..., 3), found {(*images.shape,)}")
        light = luminance(images.detach()).clamp_min(0)
        if mask is not None:
            light = light[mask.to(light.device, torch.bool).expand(light.shape)]
        if not light.numel():
            raise DataError("ToneMap: no pixel to measure; the mask is empty")
        largest = float(light.max())
        if not (math.isfinite(largest) and largest > 0 and bool(light.isfinite().all())):
            raise DataError(f"ToneMap: expected finite pictures that are not all black; largest luminance {largest}")
        log_average, white = log_average_and_white(light.flatten(), key)
        return cls(log_average.item(), white.item(), key, gamma, phi)

    def __call__(self, image: Tensor) -> Tensor:
        """Display values in [0, 1] of linear `(..., 3)`; negative values count as 0, with gradient 0."""
        return tonemap(image, self.log_average, self.white, self.key, self.gamma)

    def to_dict(self) -> dict[str, float]:
        """The numbers by name, for a record."""
        return asdict(self)
