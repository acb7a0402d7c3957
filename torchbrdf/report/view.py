"""Materials and their fits side by side, to turn and to wipe between, in one self-contained page: view.html."""

import base64
import io
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from PIL import Image
from torch import Tensor

from torchbrdf.errors import DataError, UsageError
from torchbrdf.files import write_text
from torchbrdf.images import DIFFERENCES, ToneMap, composite
from torchbrdf.measured import Measured, StandIn
from torchbrdf.render import Camera, Environment, Mesh, Scene, render
from torchbrdf.report.inline import template
from torchbrdf.report.labels import loss_label, model_label

# Of the JPEGs: at 88 and with full colour resolution a picture of 320 pixels takes 10 to 15 kB.
QUALITY = 88


@dataclass(frozen=True)
class Item:
    """What can be looked at: a material, or a fit, whose `reference` is the number of the item that it is a fit of."""

    label: str
    material: str
    kind: Literal["measured", "stand-in", "fit"]
    reference: int | None = None


def write_view(
    path: Path | str,
    groups: Sequence[Measured],
    lights: Mapping[str, Environment],
    mesh: Mesh,
    *,
    size: int = 320,
    steps: int = 12,
    advance: Callable[[int], None] = lambda frames: None,
) -> Path:
    """Draw what the groups hold from `steps` sides in each of the named lights, and write the page; gives its path.

    All pictures in one light share a tone map, measured over those of the first side. A fit's image differences are
    those from the material of the same name; measured, if there is one, else its stand-in. `advance(1)` is called
    after each of the `steps * len(lights)` scenes. A UsageError or DataError says what cannot be shown.
    """
    path = Path(path)
    if steps < 1:
        raise UsageError(f"steps: expected at least 1, found {steps}")
    if path.is_dir():
        raise DataError(f"{path}: expected a file to write, found a folder")
    items = listed(groups)
    if not items or not lights:
        raise UsageError(f"view: expected materials and lights, found {len(items)} and {len(lights)}")
    frames: list[list[list[str]]] = []
    numbers: list[list[list[list[str] | None]]] = []
    tones: list[ToneMap] = []
    for light in lights.values():
        frames.append([])
        numbers.append([])
        for step in range(steps):
            scene = Scene(mesh, Camera(rotation=step * 360 / steps), light, size=size)
            pictures = render(groups, scene)
            if step == 0:
                tones.append(ToneMap.from_images(pictures, scene.mask.expand(pictures.shape[:-1])))
            display = tones[-1](pictures)
            numbers[-1].append(_differences(items, display, scene.mask))
            frames[-1].append([_jpeg(picture) for picture in composite(display, scene.coverage)])
            advance(1)
    write_text(path, _page(items, list(lights), tones, frames, numbers, size))
    return path


def listed(groups: Sequence[Measured]) -> list[Item]:
    """The items of some groups, in their order, each with a label of its own.

    A record of a fits.json that says by which strategy it was made is a fit; another is a stand-in for a material.
    """
    items = [_item(group, row) for group in groups for row in range(len(group))]
    references: dict[str, int] = {}
    for kind in ("stand-in", "measured"):  # so that a measured one takes its stand-in's place
        references |= {item.material: k for k, item in reversed(list(enumerate(items))) if item.kind == kind}
    labels = distinct([item.label for item in items])
    return [
        Item(label, item.material, item.kind, references.get(item.material) if item.kind == "fit" else None)
        for item, label in zip(items, labels, strict=True)
    ]


def distinct(names: Sequence[str]) -> list[str]:
    """The names, those that came before with a number behind."""
    seen: Counter[str] = Counter()
    made = []
    for name in names:
        seen[name] += 1
        made.append(name if seen[name] == 1 else f"{name} #{seen[name]}")
    return made


def first_pair(items: Sequence[Item]) -> tuple[int, int]:
    """What is shown at first: a material and its first fit; without any, two items of one material, or one twice."""
    pairs = [(item.reference, k) for k, item in enumerate(items) if item.reference is not None]
    if pairs:
        first = min(reference for reference, _ in pairs)
        return next(pair for pair in pairs if pair[0] == first)
    first = next((k for k, item in enumerate(items) if item.kind != "fit"), 0)
    same = (k for k, item in enumerate(items) if k != first and item.material == items[first].material)
    return first, next(same, first)


def _item(group: Measured, row: int) -> Item:
    source, material = group.source, group.materials[row]
    if not isinstance(source, StandIn):
        return Item(f"{source.names[material]} (measured)", source.names[material], "measured")
    record = source.records[material]
    name = str(record["material"])
    if "strategy" not in record:
        return Item(f"{name} (stand-in)", name, "stand-in")
    lobes = f"{record['lobes']} lobe{'' if record['lobes'] == 1 else 's'}"
    how = [model_label(record["model"]), lobes, loss_label(str(record.get("loss", ""))), str(record["strategy"])]
    return Item(f"{name}: {', '.join(part for part in how if part)}", name, "fit")


def _differences(items: Sequence[Item], display: Tensor, mask: Tensor) -> list[list[str] | None]:
    """CIELAB Delta E and PSNR of each fit from its material, as text; None for what is no fit of one."""
    pairs = [(k, item.reference) for k, item in enumerate(items) if item.reference is not None]
    texts: list[list[str] | None] = [None] * len(items)
    if pairs:
        fits, references = (display[list(side)] for side in zip(*pairs, strict=True))
        measures = [DIFFERENCES[name]()(fits, references, mask).tolist() for name in ("delta_e76", "psnr")]
        for (k, _), delta_e, psnr in zip(pairs, *measures, strict=True):
            texts[k] = [f"{delta_e:.2f}", f"{psnr:.1f} dB" if math.isfinite(psnr) else "infinite"]
    return texts


def _jpeg(display: Tensor) -> str:
    """Display values `(H, W, 3)` as a data URI."""
    pixels = (display.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, format="JPEG", quality=QUALITY, subsampling="4:4:4", optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(data.getvalue()).decode()


def _page(
    items: Sequence[Item],
    lights: Sequence[str],
    tones: Sequence[ToneMap],
    frames: list[list[list[str]]],
    numbers: list[list[list[list[str] | None]]],
    size: int,
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
    return template("view.html").render(
        title=", ".join(materials[:3]) + (f" and {len(materials) - 3} more" if len(materials) > 3 else ""),
        items=items,
        lights=list(zip(lights, tones, strict=True)),
        size=size,
        steps=len(frames[0]),
        quality=QUALITY,
        data=data,
    )
