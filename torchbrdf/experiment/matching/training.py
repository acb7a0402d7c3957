"""The pictures that fits see: other shapes, lights and views than those that judge them."""

import math
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.fitting import stratified
from torchbrdf.losses import Loss
from torchbrdf.measured import Measured
from torchbrdf.measured.merl import bin_centers
from torchbrdf.precision import undisturbed
from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, SideBySide, blob, sphere

DIFFERENCE = "delta_e76"
# Few half vectors and bins, as of `small_scene`: what a fit sees need not be drawn as well as what judges it.
_NODES, _RESOLUTION = 64, (24, 16, 12)
# As of `fit`: degrees from the normal, and samples that a solver sees.
_MAX_THETA, _SAMPLES = 80.0, 20_000


@undisturbed()
def evenly(measured: Measured) -> Measured:
    """What losses of values see: a table at MERL's bins as it is, other samples at some of these bins.

    Measurements that follow a highlight have hardly a sample elsewhere, and fits to those are far off in pictures.

    Args:
        measured: Materials.
    """
    if measured.on_merl_bins:
        return measured
    pairs = bin_centers().to(dtype=torch.float32)
    inside = torch.minimum(pairs.cos_i, pairs.cos_o)[0] > math.cos(math.radians(_MAX_THETA))
    pairs = pairs.select(samples=inside.nonzero()[:, 0])
    pairs = pairs.select(samples=stratified(len(pairs), _SAMPLES, 0))
    return Measured.from_samples(pairs, measured.reciprocal_at(pairs), names=measured.names)


@undisturbed()
def lamps(height: int = 256, count: int = 24, seed: int = 3) -> Tensor:
    """Round lamps of many sizes all around, the smaller the brighter: a latitude-longitude picture, linear.

    Nearly every half angle is lit at nearly every angle of incidence, which no natural light does in one picture.

    Args:
        height: Of the picture, which is twice as wide.
        count: How many lamps, half a width of 1.5 to 15 degrees each.
        seed: Of where they are, their widths and colours.
    """
    generator = torch.Generator("cpu").manual_seed(seed)
    polar = (torch.arange(height, dtype=torch.float32, device="cpu") + 0.5) * (torch.pi / height)
    turn = (torch.arange(2 * height, dtype=torch.float32, device="cpu") + 0.5) * (torch.pi / height) - torch.pi
    polar, turn = torch.meshgrid(polar, turn, indexing="ij")
    toward = torch.stack([polar.sin() * turn.sin(), polar.cos(), -polar.sin() * turn.cos()], -1)
    picture = torch.full_like(toward, 0.25)
    for _ in range(count):
        middle = torch.nn.functional.normalize(
            torch.randn(3, dtype=torch.float32, generator=generator, device="cpu"), dim=0
        )
        width = 1.5 * 10 ** float(torch.rand(1, dtype=torch.float32, generator=generator, device="cpu"))
        color = 0.8 + 0.4 * torch.rand(3, dtype=torch.float32, generator=generator, device="cpu")
        away = torch.rad2deg(torch.acos((toward @ middle).clamp(-1, 1)))[..., None]
        picture += torch.sigmoid((width - away) * 2) * (40 * (3 / width) ** 1.6) * color
    return picture


def training_loss(size: int, views: int, cache: Path | None = None) -> Loss:
    """The colour difference of small pictures: the blob in the grove, the blob among lamps, and a sphere in the grove.

    Args:
        size: Pixels of a side of each picture.
        views: How many pictures, 1 to 3.
        cache: A folder for transports.
    """
    made = (
        (blob(), Camera(), Environment.default()),
        (blob(), Camera(120, elevation=20), Environment.from_image(lamps())),
        (sphere(), Camera(220, elevation=-10), Environment.default(200)),
    )
    scenes = [Scene(*parts, size, _NODES, resolution=_RESOLUTION, cache=cache) for parts in made[:views]]
    return RenderedLoss(SideBySide(scenes), DIFFERENCE)
