"""The viewer: materials and their fits side by side, to turn and to wipe between, in one self-contained page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.experiment.extrapolation import MOST, NOTE, extrapolated_share, hatched
from torchbrdf.experiment.items import Item, list_items
from torchbrdf.experiment.slices import slices_of
from torchbrdf.files import destination, write_text
from torchbrdf.images import DIFFERENCES, ToneMap, composite
from torchbrdf.measured import Measured
from torchbrdf.perception.discrimination.words import MEANING, said, scale
from torchbrdf.progress import Progress, quiet
from torchbrdf.render import Camera, Environment, Mesh, Scene, render
from torchbrdf.report.embed import embed_display, template
from torchbrdf.report.limits import check_pixels
from torchbrdf.report.slices import slices_data

# Of the JPEGs: at 88 and with full colour resolution a picture of 320 pixels takes 10 to 15 kB.
QUALITY = 88
# Of the scenes, a third of what other pictures have: of nickel, chrome and a cloth in the grove and the studio these
# are 48 dB and more from pictures with many times as many, and 0.3 Delta E at most, which is below what JPEG loses.
NODES, LIGHTS = 96, 256
# Of all pictures of a page: 100 materials from 24 sides at 320 pixels are a quarter of it. It then has some 300 MB.
MOST_PIXELS = 2_000_000_000


def write_viewer(
    path: Path | str,
    groups: Sequence[Measured],
    lights: Mapping[str, Environment],
    mesh: Mesh,
    *,
    size: int = 320,
    steps: int = 12,
    backend: str = "software",
    progress: Progress = quiet,
) -> Path:
    """Draw what the groups hold from `steps` sides in each of the named lights, and write the page; gives its path.

    All pictures in one light share a tone map, measured over those of the first side. A fit's image differences are
    those from the material of the same name; measured, if there is one, else its stand-in. `progress` is told
    of each of the `steps * len(lights)` scenes; `backend` is that of `Scene`. A UsageError or DataError says what
    cannot be shown.
    """
    destination(path)
    path = Path(path)
    if steps < 1:
        raise UsageError(f"steps: expected at least 1, found {steps}")
    items = list_items(groups)
    if not items or not lights:
        raise UsageError(f"viewer: expected materials and lights, found {len(items)} and {len(lights)}")
    every = len(items) * len(lights) * steps
    if every * size**2 > MOST_PIXELS:
        raise UsageError(
            f"viewer: expected at most {MOST_PIXELS} pixels on a page, found {every} pictures of {size} x {size}"
        )
    check_pixels("viewer", len(items), size)
    frames: list[list[list[str]]] = []
    numbers: list[list[list[list[str] | None]]] = []
    tones: list[ToneMap] = []
    for light in lights.values():
        frames.append([])
        numbers.append([])
        for step in range(steps):
            scene = Scene(mesh, Camera(rotation=step * 360 / steps), light, size, NODES, LIGHTS, backend=backend)
            pictures = render(groups, scene)
            if step == 0:
                tones.append(ToneMap.from_images(pictures, scene.mask.expand(pictures.shape[:-1])))
            display = tones[-1](pictures)
            numbers[-1].append(_differences(items, display, scene.mask))
            shown = composite(display, scene.coverage)
            frames[-1].append([_jpeg(hatched(*one)) for one in zip(shown, _extrapolated(groups, scene), strict=True)])
            progress(len(frames) * steps - steps + step + 1, len(lights) * steps)
    write_text(path, _page(items, list(lights), tones, frames, numbers, size, _slices(items, groups)))
    return path


def _extrapolated(groups: Sequence[Measured], scene: Scene) -> list[Tensor]:
    """Of each item, where its picture shows mostly what was never measured, `(size, size)`."""
    each = (group.batch([row]) for group in groups for row in range(len(group)))
    return [(extrapolated_share(one, scene) > MOST) & scene.mask for one in each]


def _slices(items: Sequence[Item], groups: Sequence[Measured]) -> dict[str, Any]:
    """What the page has of slices."""
    own = [slices_of(group.batch([row])) for group in groups for row in range(len(group))]
    return slices_data([item.label for item in items], own, [item.reference for item in items])


def first_pair(items: Sequence[Item]) -> tuple[int, int]:
    """What is shown at first: a material and its first fit; without any, two items of one material, or one twice."""
    pairs = [(item.reference, k) for k, item in enumerate(items) if item.reference is not None]
    if pairs:
        first = min(reference for reference, _ in pairs)
        return next(pair for pair in pairs if pair[0] == first)
    first = next((k for k, item in enumerate(items) if item.kind != "fit"), 0)
    same = (k for k, item in enumerate(items) if k != first and item.material == items[first].material)
    return first, next(same, first)


def _differences(items: Sequence[Item], display: Tensor, mask: Tensor) -> list[list[str] | None]:
    """CIELAB Delta E and PSNR of each fit from its material, and what they mean; None for what is no fit of one."""
    pairs = [(k, item.reference) for k, item in enumerate(items) if item.reference is not None]
    texts: list[list[str] | None] = [None] * len(items)
    if pairs:
        fits, references = (display[list(side)] for side in zip(*pairs, strict=True))
        measures = [DIFFERENCES[name]()(fits, references, mask).tolist() for name in ("delta_e76", "psnr")]
        for (k, _), delta_e76, psnr in zip(pairs, *measures, strict=True):
            decibels = "infinite" if psnr == math.inf else f"{psnr:.1f} dB"
            texts[k] = [f"{delta_e76:.2f}", decibels, said("delta_e76", delta_e76)]
    return texts


def _jpeg(display: Tensor) -> str:
    return embed_display(display, "jpeg", quality=QUALITY, subsampling="4:4:4", optimize=True)


def _page(
    items: Sequence[Item],
    lights: Sequence[str],
    tones: Sequence[ToneMap],
    frames: list[list[list[str]]],
    numbers: list[list[list[list[str] | None]]],
    size: int,
    slices: dict[str, Any],
) -> str:
    materials = list(dict.fromkeys(item.material for item in items))
    left, right = first_pair(items)
    data: dict[str, Any] = {
        "items": [asdict(item) for item in items],
        "left": left,
        "right": right,
        "frames": frames,
        "numbers": numbers,
    }
    return template("viewer.html").render(
        title=", ".join(materials[:3]) + (f" and {len(materials) - 3} more" if len(materials) > 3 else ""),
        items=items,
        lights=list(zip(lights, tones, strict=True)),
        size=size,
        steps=len(frames[0]),
        quality=QUALITY,
        meaning=[scale("delta_e76", "\u0394E"), MEANING],
        data=data,
        slices=slices,
        extrapolated=NOTE,
    )
