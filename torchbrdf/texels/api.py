"""Fit a model to every texel of a surface."""

import copy
import hashlib
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf import bounds
from torchbrdf.errors import DataError, ShapeError, UsageError, shown
from torchbrdf.files import locked, writable
from torchbrdf.lobes import Lobe, make_model, model_name, parameters
from torchbrdf.losses import CosineRMSLoss, Loss
from torchbrdf.pairs import check_max_theta
from torchbrdf.parallel import Lost, process_map
from torchbrdf.progress import Progress, quiet
from torchbrdf.texels.folder import TexelFolder
from torchbrdf.texels.maps import TexelMaps
from torchbrdf.texels.problem import Reading
from torchbrdf.texels.solve import Maps, TexelFit, map_names
from torchbrdf.texels.stack import Reader, Sliceable, Stack, TileData
from torchbrdf.texels.tiling import Tile, Tiling
from torchbrdf.texels.writing import check_formats, write_maps

log = logging.getLogger("torchbrdf")

# Tiles for each thread that are read before their fits begin.
AHEAD = 8


def fit_texels(
    observations: Sliceable | Reader,
    lights: Any,
    *,
    views: Any = (0.0, 0.0, 1.0),
    normals: Sliceable | Reader | None = None,
    weights: Sliceable | Reader | None = None,
    irradiance: Any = 1.0,
    saturation: float | None = None,
    shadow: float | None = None,
    model: Lobe | None = None,
    loss: Loss | None = None,
    held: Sequence[str] = (),
    smoothness: float = 0.0,
    sweeps: int = 4,
    max_theta: float = 80.0,
    max_iterations: int = 60,
    tile: int = 64,
    size: tuple[int, int] | None = None,
    out: Path | str | None = None,
    formats: Sequence[str] = ("exr", "png"),
    device: torch.device | str | None = None,
    progress: Progress = quiet,
) -> TexelMaps:
    """Fit a model to every texel of a photometric stack, tile by tile.

    A texel is a material whose pairs are the lights, and is fitted as materials are, by Levenberg-Marquardt; in each
    tile some texels begin from everywhere, and the others from these. See [Texels](how-to/texels.md).

    No more of the stack than some tiles is ever held. Anything that is sliced as numpy's arrays are will do: a
    memory-mapped file, an array of zarr or h5py, a tensor; or a function of two slices, rows and columns. A tile that
    cannot be read has the status FAILED, the log says why, and the others are done.

    Args:
        observations: `(n, H, W, 3)`, linear: f cos_i times irradiance. What is not finite does not count.
        lights: directions to the lights, `(n, 3)`, of any length; or of each texel, `(n, H, W, 3)`; or `Pairs` of n.
            x to the right, y up or down as the normals have it, z to the viewer.
        views: directions to the camera, `(3,)`, or as lights.
        normals: `(H, W, 3)`; a texel without one (0, or NaN) is not fitted. None: +z everywhere.
        weights: how much each value counts, `(n, H, W)`, or with 1 or 3 channels; 0 for shadows.
        irradiance: of each light on a surface that faces it: a number, `(n,)`, or `(n, 3)`.
        saturation: values of at least so much do not count.
        shadow: nothing counts under a light under which no channel of a texel has more than this.
        model: where fits begin; None: one GGX lobe and diffuse.
        loss: a mean over pairs of one value each; None: `CosineRMSLoss`, differences of what was observed.
        held: names of maps whose parameters stay as the model has them, such as "f0".
        smoothness: what it costs that neighbours differ by the whole range of a parameter, as a share of the error,
            squared, of a black surface: 1e-4 is little, 1e-1 much; 0: texels know nothing of each other.
        sweeps: how often neighbours pull at each other, where they do.
        max_theta: only directions at most so many degrees from the normal count.
        max_iterations: of the solver.
        tile: texels of a side of a tile.
        size: H and W, where observations are a function.
        out: a folder for tiles and maps, of which an interrupted fit is taken up; None: maps are kept in memory.
        formats: of the maps in `out`: "exr", "png", "zarr"; see `write_maps`.
        device: where texels are solved; by default the CPU. On a GPU tiles come one after the other, and larger ones
            are better.
        progress: called with the number of texels done.

    Returns:
        Maps by name.

    Raises:
        ShapeError: arrays do not fit together, or a direction is none.
        DataError: no light is above the horizon; `out` has tiles of other settings, or cannot be written.
        UsageError: an option has a value that it cannot have.

    Example:
        >>> from torchbrdf.texels import dome, fit_texels, synthetic_surface
        >>> surface, lights = synthetic_surface(16), dome(64)
        >>> maps = fit_texels(surface.stack(lights), lights, normals=surface.normals)
        >>> maps["roughness"].shape, maps["albedo"].shape
        ((16, 16, 1), (16, 16, 3))
    """
    check_formats(formats)
    stack = Stack(observations, lights, views, normals, weights, size)
    reading = Reading(
        _irradiance(irradiance, stack.count), _number("saturation", saturation), _number("shadow", shadow),
        max_theta, stack.pairs,
    )  # fmt: skip
    check_max_theta(max_theta)
    model = _model(make_model("ggx", 1) if model is None else model, held)
    loss = _loss(CosineRMSLoss() if loss is None else loss)
    fit = TexelFit(
        model, loss, reading, tuple(sorted(held)), _within("smoothness", smoothness, 0, 1e6),
        _whole("sweeps", sweeps, 1, 16), _whole("max_iterations", max_iterations, 1, 10_000),
        _device(device),
    )  # fmt: skip
    tiling = Tiling(stack.size, tile)
    if out is None:
        return _in_memory(fit, stack, tiling, progress)
    with locked(writable(out)):
        folder = TexelFolder(Path(out), _settings(fit, stack, tiling))
        left = [one for one in tiling if not folder.finished(one)]
        failed = _fit_tiles(fit, stack, tiling, left, folder.write, progress)
        maps = TexelMaps(model, tiling, folder.read, failed)
        write_maps(maps, folder.path, formats)
        return maps


def _in_memory(fit: TexelFit, stack: Stack, tiling: Tiling, progress: Progress) -> TexelMaps:
    found: dict[str, Maps] = {}
    failed = _fit_tiles(fit, stack, tiling, list(tiling), lambda tile, maps: found.update({tile.name: maps}), progress)
    return TexelMaps(fit.model, tiling, lambda tile: found.get(tile.name), failed)


def _fit_tiles(
    fit: TexelFit, stack: Stack, tiling: Tiling, tiles: Sequence[Tile], keep: Any, progress: Progress
) -> dict[str, str]:
    """Fit some tiles, each kept when it is done; why others could not be, by their names."""
    total = tiling.size[0] * tiling.size[1]
    done = total - sum(_texels(one) for one in tiles)
    progress(done, total)
    failed: dict[str, str] = {}
    for group in _groups(tiles, AHEAD * torch.get_num_threads()):
        read = list(_read(stack, group, fit.margin, failed))
        done += sum(_texels(one) for one in group) - sum(_texels(one) for one, _ in read)
        every = [data for _, data in read]
        work = process_map(fit, every) if fit.device == "cpu" else map(fit, every)
        for (one, _), maps in zip(read, work, strict=True):
            if isinstance(maps, Lost):
                _say(failed, one, maps.reason)
            else:
                rows, columns = one.within(one.grown(fit.margin, tiling.size))
                keep(one, {name: np.ascontiguousarray(value[rows, columns]) for name, value in maps.items()})
            done += _texels(one)
            progress(done, total)
    return failed


def _read(stack: Stack, tiles: Sequence[Tile], margin: int, failed: dict[str, str]) -> Iterator[tuple[Tile, TileData]]:
    """What was seen of tiles and of the texels around them; of those that can be read."""
    for one in tiles:
        try:
            yield one, stack.read(one.grown(margin, stack.size))
        except (DataError, ShapeError) as error:
            _say(failed, one, str(error))


def _say(failed: dict[str, str], tile: Tile, reason: str) -> None:
    failed[tile.name] = reason
    log.warning("torchbrdf: tile %s: not fitted: %s", tile.name, reason)


def _groups(tiles: Sequence[Tile], size: int) -> Iterator[Sequence[Tile]]:
    for first in range(0, len(tiles), size):
        yield tiles[first : first + size]


def _texels(tile: Tile) -> int:
    return tile.shape[0] * tile.shape[1]


def _settings(fit: TexelFit, stack: Stack, tiling: Tiling) -> dict[str, Any]:
    """Everything that the maps depend on."""
    name, lobes = model_name(fit.model)
    reading = fit.reading
    return {
        "model": name,
        "lobes": lobes,
        "start": parameters(fit.model),
        "held": list(fit.held),
        "loss": fit.loss.registered_name,
        "loss_settings": fit.loss.extra_repr(),
        "size": list(tiling.size),
        "tile": tiling.side,
        "lights": stack.count,
        "stack": stack.digest(),
        "irradiance": hashlib.sha256(reading.irradiance.tobytes()).hexdigest()[:16],
        "saturation": reading.saturation,
        "shadow": reading.shadow,
        "max_theta": reading.max_theta,
        "smoothness": fit.smoothness,
        "sweeps": fit.sweeps,
        "max_iterations": fit.max_iterations,
    }


def _irradiance(value: Any, count: int) -> np.ndarray:
    """Of each light and channel, `(n, 3)`, float32."""
    try:
        found = np.asarray(value.detach().cpu() if isinstance(value, Tensor) else value, dtype=np.float64)
        found = found[:, None] if found.ndim == 1 else found
        found = np.broadcast_to(found, (count, 3)).astype(np.float32)
    except (TypeError, ValueError):
        raise ShapeError(f"irradiance: expected a number, ({count},) or ({count}, 3), found {shown(value)}") from None
    if not (np.isfinite(found).all() and (found > 0).all()):
        raise ShapeError(f"irradiance: expected finite numbers above 0, found {found.min():g} to {found.max():g}")
    return found


def _device(device: torch.device | str | None) -> str:
    try:
        return str(torch.device(device or "cpu"))
    except RuntimeError:
        raise UsageError(f"device: expected one of torch's, such as cuda:0, found {shown(device)}") from None


def _model(model: Lobe, held: Sequence[str]) -> Lobe:
    """The model in float32 on the CPU, if texels can be fitted by it."""
    if not isinstance(model, Lobe):
        raise UsageError(f"model: expected a lobe or a sum of them, as make_model gives, found {shown(model)}")
    for part in model.components():
        if not part.is_separable():
            raise UsageError(f"model: expected lobes that are coefficients times terms, found {type(part).__name__}")
    if any(value.dim() != len(spec.shape) for part in model.components() for name, spec in part.parameter_specs.items()
           for value in [getattr(part, name)]):  # fmt: skip
        raise ShapeError("model: expected parameters of one material, where every texel begins, found a batch")
    names = map_names(model).values()
    for name in held:
        if name not in names:
            raise UsageError(f"held: expected some of {', '.join(names)}, found {shown(name)}")
    if set(held) == set(names):
        raise UsageError("held: expected a parameter that is left to fit, found all of them")
    model_name(model)  # a record can tell which it is
    return copy.deepcopy(model).to("cpu", torch.float32)


def _loss(loss: Loss) -> Loss:
    if not isinstance(loss, Loss) or not loss.is_separable():
        found = loss.registered_name if isinstance(loss, Loss) else shown(loss)
        raise UsageError(f"loss: expected a mean over pairs of one value each, such as cosine_rms, found {found}")
    return loss


def _number(name: str, value: float | None) -> float | None:
    return None if value is None else _within(name, value, *bounds.FINITE)


def _within(name: str, value: Any, low: float, high: float) -> float:
    try:
        return bounds.number(value, low, high)
    except UsageError as error:
        raise UsageError(f"{name}: {error}") from None


def _whole(name: str, value: Any, low: int, high: int) -> int:
    try:
        return bounds.whole(value, low, high)
    except UsageError as error:
        raise UsageError(f"{name}: {error}") from None
