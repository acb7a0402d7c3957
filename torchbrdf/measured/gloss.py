"""Two numbers for gloss: distinctness of image, and contrast gloss.

Both are measurements in the plane of incidence, of luminance (Rec. 709 weights of linear RGB). The dimensions are those
of F. Pellacini, J. Ferwerda, D. Greenberg, Toward a Psychophysically-Based Light Reflection Model for Image Synthesis,
2000, doi:10.1145/344779.344812. How Fores 2012 measures distinctness of image is not clear from its text ("the angle
between the specular direction at 30 degrees and a measurement at 0.3 degrees from the specular direction"); the reading
here gives an angle that is small for sharp lobes, as the paper says it is.
"""

import math

import torch
from torch import Tensor

from torchbrdf.color import luminance
from torchbrdf.measured.measured import Measured
from torchbrdf.pairs import Pairs

LIGHT = 30.0
FRACTION = 0.3
STEP = 0.02
LARGEST_ANGLE = 119.0
"""Scanned from the mirror direction over the normal to 89 degrees on the light's side."""


def distinctness_of_image(measured: Measured) -> Tensor:
    """Distinctness of image: how far off the mirror direction luminance has fallen to 0.3 of its value there.

    The light stands at 30 degrees, and the viewer moves from the mirror direction towards the normal and on. Linear
    between steps of 0.02 degrees. Small for sharp lobes.

    Args:
        measured: M materials.

    Returns:
        Degrees, `(M,)`; 119 where it never falls so far, nan where there is no light to begin with, or no sample near
        the mirror direction.

    Source: see the module, for the dimensions of gloss and for how the paper's sentence is read.

    Example:
        >>> from torchbrdf.measured import load, standins
        >>> distinctness_of_image(load(standins()).batch([6])).shape
        torch.Size([1])
    """
    off = torch.arange(0, LARGEST_ANGLE + STEP / 2, STEP, dtype=torch.float64, device="cpu")
    along = _luminance(measured, torch.full_like(off, LIGHT), off - LIGHT)
    start = along[:, 0]
    ratio = along / start[:, None]
    below = ratio <= FRACTION
    after = below.to(torch.int8).argmax(-1).clamp_min(1)[:, None]
    high, low = ratio.gather(-1, after - 1), ratio.gather(-1, after)
    angle = off[after] - STEP * (FRACTION - low) / (high - low)
    angle = torch.where(below.any(-1, keepdim=True), angle, LARGEST_ANGLE)[:, 0]
    return torch.where((start > 0) & _reached(measured, [LIGHT], [-LIGHT]), angle, torch.nan)


def contrast_gloss(measured: Measured) -> Tensor:
    """Contrast gloss: log10 of luminance at 30:30, the mirror direction, over luminance at 45:0.

    Args:
        measured: M materials.

    Returns:
        `(M,)`; nan if either luminance is not positive, or no sample is near.

    Source: see the module.
    """
    light, viewer = torch.tensor([[LIGHT, 45.0], [-LIGHT, 0.0]], dtype=torch.float64, device="cpu")
    mirror, diffuse = _luminance(measured, light, viewer).clamp_min(0).unbind(-1)
    ratio = mirror / diffuse
    known = (mirror > 0) & (diffuse > 0) & _reached(measured, light.tolist(), viewer.tolist())
    return torch.where(known, ratio, torch.nan).log10()


def _reached(measured: Measured, light: list[float], viewer: list[float]) -> Tensor:
    """Whether samples are near all of some readings, `(M,)`, on the CPU."""
    angles = (torch.tensor(one, dtype=torch.float64, device="cpu") for one in (light, viewer))
    return measured.reaches(_in_plane(*angles)).cpu()


def _luminance(measured: Measured, light: Tensor, viewer: Tensor) -> Tensor:
    """Luminance in the plane of incidence, `(M, N)`; of bands by their wavelengths."""
    values = measured.at(_in_plane(light, viewer))
    return luminance(values) if measured.is_rgb else values @ values.new_tensor(measured.luminance_shares)


def _in_plane(light: Tensor, viewer: Tensor) -> Pairs:
    """Pairs `(1, N)` in the plane of incidence, of angles from the normal towards the light's side, degrees."""
    wi, wo = (
        torch.stack([angle.sin(), torch.zeros_like(angle), angle.cos()], -1)[None]
        for angle in (light * (math.pi / 180), viewer * (math.pi / 180))
    )
    return Pairs.from_directions(wi, wo)
