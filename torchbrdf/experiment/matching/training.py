"""The pictures that fits see: other shapes, lights and views than those that judge them."""

import math
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.experiment.matching.candidates import AND, PICTURES
from torchbrdf.fitting import stratified
from torchbrdf.losses import CombinedLoss, ImageLoss, Loss, make_loss
from torchbrdf.measured import Measured
from torchbrdf.measured.measured import Interpolation, Lookup, Samples
from torchbrdf.measured.merl import bin_centers
from torchbrdf.pairs import Pairs
from torchbrdf.precision import undisturbed
from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, SideBySide, blob, sphere

DIFFERENCE = "delta_e76"
# Few half vectors and bins, as of `small_scene`: what a fit sees need not be drawn as well as what judges it.
_NODES, _RESOLUTION = 64, (24, 16, 12)
# As of `fit`: degrees from the normal, and samples that a solver sees. Pictures show more; but with values up to
# 85 degrees most fits of RGL's measurements are worse.
MAX_THETA, _SAMPLES = 80.0, 20_000


class Resampled(Samples):
    """The format of measurements at some of MERL's bins, which know what is between those as they did before.

    Args:
        measured: Materials.
        pairs: Those bins, `(1, N)`.
    """

    is_sampled = False

    def __init__(self, measured: Measured, pairs: Pairs) -> None:
        super().__init__(pairs, measured.reciprocal_at(pairs), None, measured.names)
        self.measured = measured

    def select(self, materials: list[int]) -> "Resampled":
        """Some materials."""
        return Resampled(self.measured.batch(materials), self.pairs)

    def reading(self, material: int) -> dict[str, object]:
        """As the measurement has it."""
        return self.measured.source.reading(self.measured.materials[material])

    def at(self, pairs: Pairs, materials: list[int], interpolation: Interpolation) -> Lookup:
        """As the measurement has it."""
        return self.measured.batch(materials).lookup(pairs, interpolation)


@undisturbed()
def evenly(measured: Measured) -> Measured:
    """Materials at some of MERL's bins, up to `MAX_THETA` from the normal.

    Measurements that follow a highlight have hardly a sample elsewhere, and fits to those are far off in pictures.

    Args:
        measured: Materials.
    """
    pairs = bin_centers().to(dtype=torch.float32)
    inside = torch.minimum(pairs.cos_i, pairs.cos_o)[0] > math.cos(math.radians(MAX_THETA))
    pairs = pairs.select(samples=inside.nonzero()[:, 0])
    pairs = pairs.select(samples=stratified(len(pairs), _SAMPLES, 0))
    return Measured(Resampled(measured, pairs), dtype=torch.float32)


def seen_by(loss: Loss, measured: Measured) -> Measured:
    """What a fit under a loss is given: samples as they are or, where values count, at some of MERL's bins.

    A fit to all of MERL's bins is worth its time where values alone count.
    """
    pictures_alone = isinstance(loss, ImageLoss)
    whole = measured.on_merl_bins and not isinstance(loss, CombinedLoss)
    return measured if pictures_alone or whole else evenly(measured)


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


# Of Delta E beside a metric of values: with less, tables follow the metric to where it does not see, and with more they
# follow these few pictures.
FACTOR = 1 / 50


def find_loss(name: str, pictures: RenderedLoss) -> Loss:
    """A loss by the name that candidates have it under.

    Args:
        name: A registered loss of values, `PICTURES`, or both with `AND` between.
        pictures: What fits see.
    """
    if name == PICTURES:
        return pictures
    metric, both, _ = name.partition(AND)
    return CombinedLoss(make_loss(metric), pictures, FACTOR) if both else make_loss(metric)


def training_loss(size: int, views: int, cache: Path | None = None) -> RenderedLoss:
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
