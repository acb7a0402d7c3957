"""What was never measured: which values are extrapolated, and pictures that say where they show them."""

from typing import TypeGuard

import torch
from torch import Tensor

from torchbrdf.color import luminance
from torchbrdf.experiment.matching.judge import Brdf, values_of
from torchbrdf.measured import Measured
from torchbrdf.measured.measured import FAR
from torchbrdf.measured.plausibility import invalid_share
from torchbrdf.measured.resampled import ForPictures
from torchbrdf.pairs import Pairs
from torchbrdf.render import Scene

# Of a pixel's light, from which on it is hatched.
MOST = 0.5
# Pixels from a stripe to the next, along a row, and the width of one, of pictures of 128; and how much of it is left.
STRIPES, WIDTH, LEFT = 8, 2, 0.45
# Of the samples of a grid, from which on it has holes and not a few bad values.
HOLES = 0.01

NOTE = f"Hatched, or dashed: extrapolated, more than {FAR:g}\u00b0 from the nearest sample that was measured."


def is_extrapolated(brdf: Brdf, pairs: Pairs) -> Tensor:
    """Where values of one material are extrapolated, `(N,)`: far from every valid sample of a measurement.

    Args:
        brdf: One material, or a model, which has values everywhere.
        pairs: `(1, N)`.
    """
    if not has_gaps(brdf):
        return torch.zeros(len(pairs), dtype=torch.bool, device="cpu")
    return (brdf.distance_at(pairs)[0] > FAR).cpu()


def has_gaps(brdf: Brdf) -> TypeGuard[Measured]:
    """Whether it is a measurement that was not made everywhere: one without a grid, or with holes in it."""
    return isinstance(brdf, Measured) and not brdf.stand_in and (brdf.is_scattered or invalid_share(brdf) > HOLES)


@torch.no_grad()
def extrapolated_share(brdf: Brdf, scene: Scene) -> Tensor:
    """How much of each pixel's light comes by extrapolated values, `(size, size)`, 0 to 1."""
    # Asked first: a scene's pairs are much work.
    far = is_extrapolated(brdf, scene.pairs) if has_gaps(brdf) else None
    if far is None or not far.any():
        return torch.zeros(scene.size, scene.size, dtype=torch.float32, device="cpu")
    if has_gaps(brdf) and brdf.is_anisotropic:  # as it was drawn
        values = ForPictures(brdf)(Pairs.from_directions(scene.pairs.wi, scene.pairs.wo)).clamp_min(0)
    else:
        values = values_of(brdf, scene.pairs).clamp_min(0)
    found = scene.transport @ torch.cat([values * far[None, :, None], values])
    part, whole = luminance(found)
    return torch.where(whole > 0, part / whole.clamp_min(1e-12), 0)


def hatched(display: Tensor, where: Tensor) -> Tensor:
    """A picture with stripes where something is the case.

    Args:
        display: Display values, `(H, W, 3)`.
        where: `(H, W)`, bool.

    Returns:
        The picture, each stripe nearer to white where it is dark, and to black where it is bright.
    """
    if not where.any():
        return display
    height, width = where.shape
    scale = max(1, round(width / 128))
    down, across = torch.meshgrid(
        torch.arange(height, dtype=torch.int64, device="cpu"),
        torch.arange(width, dtype=torch.int64, device="cpu"),
        indexing="ij",
    )
    stripe = ((down + across) % (STRIPES * scale) < WIDTH * scale) & where
    ink = (luminance(display) < 0.4).to(display)[..., None].expand_as(display)
    return torch.where(stripe[..., None], LEFT * display + (1 - LEFT) * ink, display)
