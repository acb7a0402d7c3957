"""What surfaces look like under directional lights: the same pairs as fits see, the other way round."""

import math
from collections.abc import Iterator
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


def photograph(maps: TexelMaps, lights: Any, views: Any = (0.0, 0.0, 1.0), normals: Any = None,
               irradiance: float = 1.0) -> Iterator[tuple[Tile, Array]]:  # fmt: skip
    """What a camera sees of a surface under each of some lights, tile by tile.

    Args:
        maps: of the surface.
        lights: directions `(n, 3)`, or `(n, H, W, 3)`.
        views: the same, or `(3,)`.
        normals: `(H, W, 3)`; None: +z.
        irradiance: of a light on a surface that faces it.

    Returns:
        Tiles and what is seen of them, `(n, h, w, 3)`, float32: what `fit_texels` takes. NaN where nothing is known.

    Example:
        >>> from torchbrdf.texels import dome, photograph, synthetic_surface
        >>> surface = synthetic_surface(16)
        >>> [part.shape for tile, part in photograph(surface.maps, dome(4), normals=surface.normals)]
        [(4, 16, 16, 3)]
    """
    count = len(lights)
    nothing = np.zeros((), np.float32)
    stack = Stack(np.broadcast_to(nothing, (count, *maps.size, 3)), lights, views, normals, None, None)
    for tile, model in maps.models():
        data = stack.read(tile)
        pairs, faces = pairs_of(data)
        with torch.no_grad():
            seen = model(pairs) * (pairs.cos_i.clamp_min(0) * irradiance)[..., None]
            seen = torch.where(faces[:, None, None], seen, 0)
        yield tile, np.ascontiguousarray(seen.numpy().reshape(*tile.shape, count, 3).transpose(2, 0, 1, 3))


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
    for tile, part in photograph(maps, [light], view, normals, irradiance):
        found[tile.rows, tile.columns] = part[0]
    return found
