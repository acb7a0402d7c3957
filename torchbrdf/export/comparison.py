"""What an export changed, as pictures show it."""

from collections.abc import Mapping, Sequence

import torch

from torchbrdf.export.base import Brdf
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.render import Scene, render

# The first says whether it is worth telling, the second is the one that the calibrated share may be known of.
DIFFERENCES_SHOWN = ("delta_e76", "delta_e_itp")


def picture_differences(
    brdf: Brdf, shown: Brdf, scene: Scene, differences: Sequence[str] = DIFFERENCES_SHOWN
) -> Mapping[str, float]:
    """How far the picture of an exported material is from that of the original, under a tone map of the latter.

    Args:
        brdf: The original.
        shown: What a renderer will show, see `Exported`.
        scene: What is drawn.
        differences: Registered names of image differences.

    Returns:
        The differences by name.

    Example:
        >>> from torchbrdf.export import picture_differences
        >>> from torchbrdf.lobes import Lambert
        >>> from torchbrdf.render import Scene, sphere
        >>> scene = Scene(sphere(2), size=16, nodes=8, light_samples=16)
        >>> found = picture_differences(Lambert(albedo=0.5), Lambert(albedo=0.51), scene)
        >>> 0.1 < found["delta_e76"] < 1
        True
    """
    measures = {name: DIFFERENCES[name]() for name in differences}
    reference, picture = render([brdf, shown], scene)
    black = not (reference[scene.mask] > 0).any()  # of which there is no tone map
    tone = ToneMap.from_images(torch.ones_like(reference) if black else reference, scene.mask)
    pairs = {False: (tone(picture), tone(reference)), True: (picture, reference)}
    with torch.no_grad():
        return {
            name: measure(*(one[None] for one in pairs[measure.linear]), scene.mask).item()
            for name, measure in measures.items()
        }
