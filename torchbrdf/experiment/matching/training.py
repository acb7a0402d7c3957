"""The pictures that fits see: other shapes, lights and views than those that judge them."""

from pathlib import Path

from torchbrdf.losses import Loss
from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, SideBySide, blob, sphere

DIFFERENCE = "delta_e76"
# Few half vectors and bins, as of `small_scene`: what a fit sees need not be drawn as well as what judges it.
_NODES, _RESOLUTION = 64, (24, 16, 12)


def training_loss(size: int, views: int, cache: Path | None = None) -> Loss:
    """The colour difference of small pictures of the blob from two sides in the grove, and of a sphere there.

    Args:
        size: Pixels of a side of each picture.
        views: How many pictures, 1 to 3.
        cache: A folder for transports.
    """
    made = (
        (blob(), Camera(), Environment.default()),
        (blob(), Camera(120, elevation=20), Environment.default(90)),
        (sphere(), Camera(220, elevation=-10), Environment.default(200)),
    )
    scenes = [Scene(*parts, size, _NODES, resolution=_RESOLUTION, cache=cache) for parts in made[:views]]
    return RenderedLoss(SideBySide(scenes), DIFFERENCE)
