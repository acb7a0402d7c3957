"""A sheet of pictures: each material, its fits beside it, and below each fit where it differs and by how much."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from torch import Tensor

from torchbrdf.experiment.items import Item, list_items
from torchbrdf.experiment.labels import difference_label
from torchbrdf.experiment.pictures import BRIGHTEST, COLOR_MAP, DIFFERENCE, color_difference
from torchbrdf.files import write_json
from torchbrdf.images import DIFFERENCES, ToneMap, composite, to_bytes, write_exr, write_png
from torchbrdf.measured import Measured
from torchbrdf.perception.discrimination.words import INTERVAL, MEANING, brief, scale
from torchbrdf.progress import Progress, quiet
from torchbrdf.render import Scene, render
from torchbrdf.report.limits import check_pixels
from torchbrdf.report.style import new_figure

# Pictures side by side, unless a material has more fits.
ACROSS = 8
# A cell in inches: a picture and, above it, its title. Smaller where the sheet would be higher than MOST_INCHES.
SIDE, TITLE, MOST_INCHES = 2.1, 0.4, 150.0
# Of a title, to a line; of what numbers mean, to an inch.
LETTERS, LETTERS_OF_FOOT = 36, 19
# Between pictures, as a share of a cell; room for the colour scale, and for what numbers mean, in inches.
GAP, SCALE_WIDTH, FOOT = 0.03, 0.9, 0.5

# Names that a folder of pictures has for itself.
SHEET, TONE_MAP = "sheet", "tonemap"


@dataclass(frozen=True)
class SheetCell:
    """Where the picture of an item stands on a sheet, or the map of how it differs from its reference."""

    row: int
    column: int
    item: int
    is_map: bool = False


def draw_groups(
    folder: Path, groups: Sequence[Measured], scene: Scene, progress: Progress = quiet
) -> list[tuple[Path, str]]:
    """Draw materials and fits in one scene under one tone map: a PNG and a linear EXR of each, and a sheet of all.

    Args:
        folder: Where `NAME.png`, `NAME.exr`, `sheet.png` and `tonemap.json` are written.
        groups: Loaded files.
        scene: What they are drawn in.
        progress: Of the pixels.

    Returns:
        The PNG files, and what each shows, for people.

    Raises:
        UsageError: All pictures together have more than `limits.MOST_PIXELS` pixels.
    """
    items = list_items(groups, reserved=(SHEET, TONE_MAP))
    check_pixels("render", len(items), scene.size)
    linear = render(groups, scene, progress)
    tone = ToneMap.from_images(linear, scene.mask.expand(linear.shape[:-1]))
    display = tone(linear)
    maps = torch.zeros(linear.shape[:-1], dtype=linear.dtype, device="cpu")
    delta_e = [math.nan] * len(items)
    for k, item in enumerate(items):
        if item.reference is not None:
            pair = display[k], display[item.reference]
            maps[k] = color_difference(*pair)
            delta_e[k] = DIFFERENCES[DIFFERENCE]()(pair[0][None], pair[1][None], scene.mask).item()
    written = []
    for item, picture, shown in zip(items, linear, display, strict=True):
        path = folder / f"{item.stem}.png"
        write_png(path, composite(shown, scene.coverage))
        write_exr(path.with_name(f"{item.stem}.exr"), picture)
        written.append((path, item.label))
    write_json(folder / f"{TONE_MAP}.json", tone.to_dict())
    sheet = folder / f"{SHEET}.png"
    write_sheet(sheet, items, display, maps, delta_e, scene.coverage)
    fits = any(item.reference is not None for item in items)
    return [*written, (sheet, "all of them" + ", and where fits differ from their materials" * fits)]


def write_sheet(
    path: Path, items: Sequence[Item], display: Tensor, maps: Tensor, delta_e: Sequence[float], coverage: Tensor
) -> None:
    """Write the sheet as one PNG file, whole or not at all.

    Args:
        path: The file.
        items: What is shown.
        display: Display values of each item, `(n, H, W, 3)`.
        maps: The colour difference of each pixel to the reference of its item, `(n, H, W)`, CIELAB Delta E.
        delta_e: The mean of it over the object; of no meaning where there is no reference.
        coverage: How much of a pixel the object covers, `(H, W)`.
    """
    cells = sheet_cells(items)
    across, rows = (1 + max(getattr(cell, key) for cell in cells) for key in ("column", "row"))
    fits = any(cell.is_map for cell in cells)
    side = min(SIDE, MOST_INCHES / rows - TITLE)
    size = min(7.5, 3.5 * side)
    height, width, foot = rows * (side + TITLE), across * side, FOOT * fits
    with new_figure(path, width + SCALE_WIDTH * fits, height + foot, layout=None) as figure:
        axes = figure.add_axes(
            (0, foot / (height + foot), width / (width + SCALE_WIDTH * fits), height / (height + foot))
        )
        axes.set(xlim=(0, across), ylim=(height / side, 0))
        axes.set_axis_off()
        for cell in cells:
            k, top = cell.item, cell.row * (1 + TITLE / side) + TITLE / side
            shown = COLOR_MAP(maps[k].numpy() / BRIGHTEST)[..., :3] if cell.is_map else display[k].numpy()
            picture = to_bytes(composite(torch.from_numpy(shown), coverage))
            axes.imshow(picture, extent=(cell.column + GAP, cell.column + 1 - GAP, top + 1 - 2 * GAP, top))
            said = _mean(delta_e[k]) if cell.is_map else _title(items[k])
            # Three lines are as high as the room for them, at 72 points an inch.
            fitting = min(size, 72 * (TITLE - GAP * side) / (1.25 * (1 + said.count("\n"))))
            axes.text(cell.column + 0.5, top - GAP, said, fontsize=fitting, ha="center", va="bottom")
        axes.set(xlim=(0, across), ylim=(height / side, 0), aspect="auto")  # which imshow changed
        if fits:
            tall = min(height - TITLE, 4 * SIDE)
            place = (1 - 0.75 * SCALE_WIDTH / figure.get_figwidth(), 1 - (tall + 0.3) / (height + foot))
            bar = figure.add_axes((*place, 0.15 / figure.get_figwidth(), (tall - 0.1) / (height + foot)))
            figure.colorbar(ScalarMappable(Normalize(0, BRIGHTEST), COLOR_MAP), cax=bar, extend="max")
            bar.set_ylabel("CIELAB ΔE 76 to the reference, pixel by pixel", fontsize=7.5)
            bar.tick_params(labelsize=7.5)
            meant = f"{scale(DIFFERENCE, f'mean {difference_label(DIFFERENCE)}')}. {MEANING} {INTERVAL}"
            lines = textwrap.fill(meant, int(figure.get_figwidth() * LETTERS_OF_FOOT))
            figure.text(0.01, 0.5 * foot / (height + foot), lines, fontsize=7, va="center")


def sheet_cells(items: Sequence[Item]) -> list[SheetCell]:
    """What stands where: blocks of a reference with its fits beside it and their maps below; then all that is neither.

    Blocks stand side by side where there is room for ACROSS pictures.
    """
    blocks = [
        (k, fits) for k in range(len(items)) if (fits := [j for j, one in enumerate(items) if one.reference == k])
    ]
    across = max([ACROSS, *(1 + len(fits) for _, fits in blocks)])
    cells: list[SheetCell] = []
    row, column = 0, 0
    for k, fits in blocks:
        if column + 1 + len(fits) > across:
            row, column = row + 2, 0
        cells.append(SheetCell(row, column, k))
        for j, fit in enumerate(fits, column + 1):
            cells += [SheetCell(row, j, fit), SheetCell(row + 1, j, fit, is_map=True)]
        column += 1 + len(fits)
    row += 2 * bool(blocks)
    there = {cell.item for cell in cells}
    alone = [k for k in range(len(items)) if k not in there]
    return cells + [SheetCell(row + n // across, n % across, k) for n, k in enumerate(alone)]


def _mean(delta_e: float) -> str:
    """What stands above a map."""
    share = brief(DIFFERENCE, delta_e, interval=True)
    return f"mean ΔE {delta_e:.2f}" + (f"\ntold apart by {share}" if share else "")


def _title(item: Item) -> str:
    """An item's label in two lines, or three."""
    name, _, how = item.label.partition(": ")
    return "\n".join(textwrap.wrap(name, LETTERS) + textwrap.wrap(how, LETTERS))
