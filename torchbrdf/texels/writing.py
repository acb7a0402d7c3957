"""Maps as files of other programs: OpenEXR, PNG, zarr."""

import importlib.util
import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from kornia.color import linear_rgb_to_rgb
from PIL import Image

from torchbrdf.errors import UsageError, shown
from torchbrdf.files import replacing, write_bytes
from torchbrdf.images import to_bytes
from torchbrdf.images.exr import exr_bytes
from torchbrdf.texels.maps import STATUS, TexelMaps
from torchbrdf.texels.status import TexelStatus

FORMATS = ("exr", "png", "zarr")
ZARR = "maps.zarr.zip"
# What a texel of each status looks like: converged ones dark, so that others are seen.
COLORS = np.array(
    [
        (38, 70, 83),  # converged
        (233, 196, 106),  # max_iterations
        (244, 162, 97),  # stalled
        (231, 60, 150),  # not_finite
        (0, 0, 0),  # no_data
        (120, 120, 120),  # too_few_samples
        (255, 255, 255),  # saturated
        (220, 30, 30),  # failed
    ],
    np.uint8,
)
# The error that is white in its picture: this share of texels have less.
BRIGHT = 0.99
# Rows of a map that are made a picture together.
ROWS = 256
# Neither changes when nothing does: the oldest date that a zip file knows.
_DATE = (1980, 1, 1, 0, 0, 0)


def check_formats(formats: Sequence[str]) -> None:
    """Refuse formats that there are not, or for which a package is missing.

    Raises:
        UsageError: There is one.
    """
    for name in formats:
        if name not in FORMATS:
            raise UsageError(f"formats: expected some of {', '.join(FORMATS)}, found {shown(name)}")
    if "zarr" in formats and importlib.util.find_spec("zarr") is None:
        raise UsageError('formats: zarr needs a package that is not here: pip install "torchbrdf[zarr]"')


def write_maps(maps: TexelMaps, folder: Path | str, formats: Sequence[str] = ("exr", "png")) -> list[Path]:
    """Write every map, one after the other.

    Args:
        maps: What to write.
        folder: Where: `roughness.exr`, 32 bits, of maps of one number with a channel Y; `roughness.png`, to look at:
            colours as sRGB, others from 0 to 1, errors up to what 99 % have less than, NaN magenta; `maps.zarr.zip`,
            a zarr group with an array for each map, in tiles.
        formats: Of "exr", "png" and "zarr".

    Returns:
        The files.

    Raises:
        UsageError: There is no such format, or the package zarr is missing.
        DataError: A file cannot be written, or a tile not be read.
    """
    check_formats(formats)
    written = []
    for name in maps.names if {"exr", "png"} & set(formats) else ():
        values = maps[name]
        if "exr" in formats and name != STATUS:
            written.append(Path(folder) / f"{name}.exr")
            write_bytes(written[-1], exr_bytes(values))
        if "png" in formats:
            written.append(Path(folder) / f"{name}.png")
            _write_png(written[-1], values, name)
    if "zarr" in formats:
        written.append(Path(folder) / ZARR)
        _write_zarr(maps, written[-1])
    return written


def display(values: np.ndarray, name: str, brightest: float | None = None) -> torch.Tensor:
    """A map `(H, W, 1|3)` as display values, `(H, W, 3)`.

    brightest: the error that is white; None: as `BRIGHT` has it.
    """
    if name == STATUS:
        return torch.from_numpy(COLORS[values[..., 0]]).float() / 255
    there = torch.from_numpy(values)
    if values.shape[-1] == 3:
        encoded = linear_rgb_to_rgb(there.clamp(0, 1).movedim(-1, 0)).movedim(0, -1)
        return torch.where(there.isnan(), torch.nan, encoded)
    if name == "error":
        there = there / (_brightest(values) if brightest is None else brightest)
    return there.expand(-1, -1, 3)


def _brightest(errors: np.ndarray) -> float:
    finite = errors[np.isfinite(errors)]
    return max(float(np.quantile(finite, BRIGHT)) if finite.size else 1.0, 1e-30)


def _write_png(path: Path, values: np.ndarray, name: str) -> None:
    """Some rows after the other, as what is worked out between is many times the map."""
    pixels = np.empty((*values.shape[:2], 3), np.uint8)
    brightest = _brightest(values) if name == "error" else None
    for first in range(0, len(values), ROWS):
        rows = slice(first, first + ROWS)
        pixels[rows] = to_bytes(display(values[rows], name, brightest))
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, format="PNG", compress_level=4)
    write_bytes(path, data.getvalue())


def _write_zarr(maps: TexelMaps, path: Path) -> None:
    """An array a map, in chunks of a tile; the same bytes each time."""
    import zarr

    side = maps.tiling.side
    with replacing(path) as temporary:
        dated = temporary.with_name(temporary.name + ".dated")
        try:
            with zarr.storage.ZipStore(dated, mode="w") as store:
                group = zarr.create_group(store, attributes={"status": {one.name: one.value for one in TexelStatus}})
                arrays = {
                    name: group.create_array(
                        name,
                        shape=(*maps.size, maps.channels(name)),
                        chunks=(min(side, maps.size[0]), min(side, maps.size[1]), maps.channels(name)),
                        dtype="uint8" if name == STATUS else "float32",
                    )
                    for name in maps.names
                }
                for tile in maps.tiling:
                    for name, array in arrays.items():
                        array[tile.rows, tile.columns] = maps.tile(name, tile)
            with zipfile.ZipFile(dated) as source, zipfile.ZipFile(temporary, "w") as target:
                for member in source.infolist():
                    target.writestr(zipfile.ZipInfo(member.filename, _DATE), source.read(member))
        finally:
            dated.unlink(missing_ok=True)
