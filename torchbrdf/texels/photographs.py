"""What surfaces look like under directional lights: the same pairs as fits see, the other way round."""

import math
from typing import Any

import numpy as np
import torch

from torchbrdf.errors import ShapeError
from torchbrdf.texels.maps import TexelMaps
from torchbrdf.texels.problem import pairs_of
from torchbrdf.texels.stack import Stack
from torchbrdf.texels.tiling import Tile

Array = np.ndarray


def dome(count: int, max_theta: float = 70.0) -> Array:
    """Directions spread evenly over a part of the hemisphere about +z.

    Args:
        count: n.
        max_theta: the angle from +z of its edge, degrees.

    Returns:
        Unit vectors `(n, 3)`, float32.

    Source: R. Swinbank and R. J. Purser, Fibonacci grids: A novel approach to global modelling, 2006,
    doi:10.1256/qj.05.227.

    Example:
        >>> from torchbrdf.texels import dome
        >>> dome(64).shape
        (64, 3)
    """
    if not isinstance(count, int) or count < 1:
        raise ShapeError(f"dome: expected at least one direction, found {count}")
    place = np.arange(count) + 0.5
    z = 1 - place / count * (1 - math.cos(math.radians(max_theta)))
    azimuth, sine = place * math.pi * (3 - math.sqrt(5)), np.sqrt(1 - z * z)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], -1).astype(np.float32)


def photograph(maps: TexelMaps, lights: Any, rows: slice, columns: slice, *, views: Any = (0.0, 0.0, 1.0),
               normals: Any = None, irradiance: float = 1.0) -> Array:  # fmt: skip
    """What a camera sees of a part of a surface under each of some lights: what `fit_texels` takes.

    Args:
        maps: of the surface.
        lights: directions `(n, 3)`, or `(n, H, W, 3)`.
        rows: of the part.
        columns: of the part.
        views: directions as lights, or `(3,)`.
        normals: `(H, W, 3)`; None: +z.
        irradiance: of a light on a surface that faces it.

    Returns:
        `(n, h, w, 3)`, float32; NaN where nothing is known.

    Example:
        >>> from torchbrdf.texels import dome, photograph, synthetic_surface
        >>> surface = synthetic_surface(16)
        >>> photograph(surface.maps, dome(4), slice(0, 16), slice(0, 8), normals=surface.normals).shape
        (4, 16, 8, 3)
    """
    count = len(lights)
    nothing = np.broadcast_to(np.zeros((), np.float32), (count, *maps.size, 3))
    part = Tile(0, 0, rows, columns)
    pairs, faces = pairs_of(Stack(nothing, lights, views, normals, None, None).read(part))
    with torch.no_grad():
        seen = maps.model_of(rows, columns)(pairs) * (pairs.cos_i.clamp_min(0) * irradiance)[..., None]
        seen = torch.where(faces[:, None, None], seen, 0)
    return np.ascontiguousarray(seen.numpy().reshape(*part.shape, count, 3).transpose(2, 0, 1, 3))


def relight(maps: TexelMaps, light: Any, view: Any = (0.0, 0.0, 1.0), normals: Any = None,
            irradiance: float = 1.0) -> Array:  # fmt: skip
    """What a camera sees of a surface under one light.

    Args:
        maps: of the surface.
        light: its direction, `(3,)`.
        view: the camera's, `(3,)`.
        normals: `(H, W, 3)`; None: +z.
        irradiance: of the light on a surface that faces it.

    Returns:
        A linear picture `(H, W, 3)`, float32; NaN where nothing is known.

    Example:
        >>> from torchbrdf.texels import relight, synthetic_surface
        >>> surface = synthetic_surface(16)
        >>> relight(surface.maps, (0.5, 0.0, 0.8), normals=surface.normals).shape
        (16, 16, 3)
    """
    found = np.empty((*maps.size, 3), np.float32)
    for tile in maps.tiling:
        seen = photograph(maps, [light], tile.rows, tile.columns, views=view, normals=normals, irradiance=irradiance)
        found[tile.rows, tile.columns] = seen[0]
    return found
