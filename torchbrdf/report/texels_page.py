"""report.html of a fit of texels: maps beside the truth, how good they are, and the surface lit anew."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.experiment.pictures import BRIGHTEST, COLOR_MAP, color_difference
from torchbrdf.files import write_text
from torchbrdf.report.embed import embed_display, template
from torchbrdf.report.tables import Column, table
from torchbrdf.texels import TexelMaps, TexelStatus, relight
from torchbrdf.texels.maps import STATUS
from torchbrdf.texels.synthetic import Camera
from torchbrdf.texels.writing import COLORS, display

Array = np.ndarray

# Maps that are shown, and the difference that is the brightest colour of their maps, as a share of the value.
SHOWN = {"albedo": 0.2, "reflectance": 0.2, "roughness": 0.2}
# A fit is as good as the truth if its error is at most so many times that of the true parameters.
GOOD = 1.01
# A light from where none was, and a camera from where none was; degrees from the normal, and round it.
SCENES = {
    "A light that no fit saw, the camera above": ((38.0, 200.0), (0.0, 0.0)),
    "The camera 45 degrees to the side, where no fit saw the surface from": ((40.0, 170.0), (45.0, 10.0)),
}
# Pixels of a picture are so many that patches of a few texels are seen.
LEAST_SIDE = 256


@dataclass(frozen=True)
class Row:
    """Pictures side by side, as data URIs: the truth, the fit, and their difference."""

    title: str
    said: str
    truth: str
    fit: str
    difference: str


def write_texels_report(folder: Path, maps: TexelMaps, camera: Camera) -> Path:
    """Write the page.

    Args:
        folder: Of the run.
        maps: What was fitted.
        camera: Whose photographs it was fitted to; its surface is the truth.

    Returns:
        Its path.
    """
    truth, normals = camera.surface.maps, camera.surface.normals
    ratio = _ratios(maps, camera)
    known = np.isfinite(ratio)
    counts = maps.counts()
    rows = [_map_row(name, top, maps[name], truth[name]) for name, top in SHOWN.items()]
    lit = [
        _lit_row(title, *(relight(one, _direction(*light), _direction(*view), normals) for one in (truth, maps)))
        for title, (light, view) in SCENES.items()
    ]
    page = template("texels.html").render(
        title="Texels: a surface fitted under directional lights",
        size=maps.size,
        lights=len(camera.lights),
        noise=camera.noise,
        floor=camera.floor,
        good=GOOD,
        share=f"{100 * float((ratio[known] <= GOOD).mean()):.2f}" if known.any() else "0",
        rows=rows,
        lit=lit,
        brightest=BRIGHTEST,
        ratio=_embed(torch.from_numpy(_colored((ratio - 0.9) / 0.2))),
        error=_embed(display(maps["error"], "error")),
        status=_embed(display(maps[STATUS], STATUS)),
        legend=[(one, counts[one.name], "rgb({},{},{})".format(*COLORS[one])) for one in TexelStatus
                if one.name in counts],
        tables=[_numbers(maps, truth)],
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )  # fmt: skip
    path = folder / "report.html"
    write_text(path, page)
    return path


def _ratios(maps: TexelMaps, camera: Camera) -> Array:
    """The error of each texel over that at the true parameters, `(H, W)`."""
    found = np.empty(maps.size)
    for tile in maps.tiling:
        found[tile.rows, tile.columns] = maps.tile("error", tile)[..., 0] / camera.true_errors(tile.rows, tile.columns)
    return found


def _numbers(maps: TexelMaps, truth: TexelMaps) -> object:
    """How far parameters are from the truth."""
    rows = []
    for name in SHOWN:
        off = np.abs(maps[name] / np.maximum(truth[name], 1e-6) - 1)
        off = off[np.isfinite(off)]
        rows.append((name, *(np.quantile(off, part) if off.size else np.nan for part in (0.5, 0.9, 0.99))))
    heads = ("map", "median", "90 % have less", "99 % have less")
    columns: list[Column[tuple[object, ...]]] = [Column(heads[0], lambda row: row[0])]
    columns += [
        Column(head, lambda row, k=k: row[k], lambda value: f"{100 * value:.1f} %")  # type: ignore[misc]
        for k, head in enumerate(heads) if k
    ]  # fmt: skip
    note = (
        "Differences from the truth as a share of it. Where a highlight is hardly seen, as of rough stone with a "
        "reflectance of 4 %, noise leaves its width open: errors say whether a fit is as good as it can be, not these."
    )
    return table("How far maps are from the truth", note, rows, columns)


def _map_row(name: str, top: float, found: Array, true: Array) -> Row:
    off = (np.abs(found - true) / np.maximum(true, 1e-6)).mean(-1)
    said = f"difference: black is none, bright yellow {100 * top:g} % of the value and more"
    beside, fit = (_embed(display(one, name)) for one in (true, found))
    return Row(name, said, beside, fit, _embed(torch.from_numpy(_colored(off / top))))


def _lit_row(title: str, true: Array, found: Array) -> Row:
    white = max(float(np.nanquantile(true, 0.995)), 1e-9)
    pictures = [display(one / white, "") for one in (true, found)]
    delta = color_difference(pictures[1].nan_to_num(), pictures[0].nan_to_num()).numpy()
    said = f"mean Delta E {float(delta.mean()):.2f}, 99 % of texels below {float(np.quantile(delta, 0.99)):.1f}"
    beside, fit = (_embed(one) for one in pictures)
    return Row(title, said, beside, fit, _embed(torch.from_numpy(_colored(delta / BRIGHTEST))))


def _colored(values: Array) -> Array:
    colors: Array = np.asarray(COLOR_MAP(np.clip(np.nan_to_num(values, nan=0.0), 0, 1))[..., :3], dtype=np.float32)
    return np.where(np.isnan(values)[..., None], np.float32(np.nan), colors)


def _embed(picture: Tensor) -> str:
    """A picture with whole numbers of pixels for a texel, so that none is blurred."""
    times = max(1, -(-LEAST_SIDE // max(picture.shape[:2])))
    return embed_display(picture.repeat_interleave(times, 0).repeat_interleave(times, 1), "webp", quality=92)


def _direction(theta: float, phi: float) -> tuple[float, float, float]:
    theta, phi = np.radians(theta), np.radians(phi)
    return float(np.sin(theta) * np.cos(phi)), float(np.sin(theta) * np.sin(phi)), float(np.cos(theta))
