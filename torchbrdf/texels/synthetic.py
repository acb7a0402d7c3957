"""A surface whose maps are known, made up: painted metal and stone, worn, with bumps."""

import math
from dataclasses import dataclass

import numpy as np

from torchbrdf.errors import UsageError
from torchbrdf.lobes import make_model
from torchbrdf.texels.maps import TexelMaps
from torchbrdf.texels.relight import photograph
from torchbrdf.texels.tiling import Tile

Array = np.ndarray

# Albedo, colour of the highlight times f0, roughness and f0 of what it is made of; f0 of Schlick's formula.
MATERIALS = (
    ((0.45, 0.32, 0.20), (0.040, 0.040, 0.040), 0.45, 0.04),  # stone
    ((0.03, 0.03, 0.03), (0.560, 0.420, 0.240), 0.18, 0.60),  # brass
    ((0.08, 0.16, 0.40), (0.045, 0.045, 0.045), 0.10, 0.05),  # paint
    ((0.35, 0.05, 0.04), (0.040, 0.040, 0.040), 0.25, 0.04),  # other paint
)


@dataclass(frozen=True)
class SyntheticSurface:
    """A made-up surface.

    Args:
        maps: its parameters: one GGX lobe and diffuse.
        normals: `(H, W, 3)`.
    """

    maps: TexelMaps
    normals: Array

    def stack(self, lights: Array, noise: float = 0.01, floor: float = 0.001, seed: int = 0,
              out: Array | None = None) -> Array:  # fmt: skip
        """What a camera above sees under each light, with noise.

        Args:
            lights: directions `(n, 3)`.
            noise: standard deviation, in units of the value.
            floor: what is added to its variance, as a standard deviation.
            seed: of the noise.
            out: where to put it, `(n, H, W, 3)`, such as a memory-mapped file; None: a new array.

        Returns:
            `(n, H, W, 3)`, float32.
        """
        found = np.empty((len(lights), *self.maps.size, 3), np.float32) if out is None else out
        for tile, seen in photograph(self.maps, lights, normals=self.normals):
            found[:, tile.rows, tile.columns] = seen + _noise(seen, noise, floor, tile, seed)
        return found


def synthetic_surface(size: int = 512, seed: int = 0) -> SyntheticSurface:
    """Make up a surface: four materials in patches with sharp edges, wear that changes roughness and colour, bumps.

    Args:
        size: texels of a side.
        seed: of everything that is drawn at random.

    Returns:
        The surface, of which everything is known.

    Example:
        >>> from torchbrdf.texels import synthetic_surface
        >>> synthetic_surface(32).normals.shape
        (32, 32, 3)
    """
    if not isinstance(size, int) or not 8 <= size <= 8192:
        raise UsageError(f"size: expected 8 to 8192 texels, found {size}")
    random = np.random.default_rng(seed)
    which = np.argmax(np.stack([_clouds(size, 3, random) for _ in MATERIALS]), 0)
    wear, grain = _clouds(size, 5, random), random.standard_normal((size, size))
    tint = 1 + 0.25 * _clouds(size, 6, random)[..., None] + 0.05 * grain[..., None]
    columns: list[Array] = [np.array(column)[which] for column in zip(*MATERIALS, strict=True)]
    albedo, reflectance, roughness, f0 = columns
    arrays = {
        "albedo": (albedo * tint).clip(0.005, 0.9),
        "roughness": (roughness * np.exp(0.35 * wear + 0.05 * grain)).clip(0.05, 0.8)[..., None],
        "f0": f0[..., None],
        "specular": (reflectance / f0[..., None] * (1 - 0.1 * wear[..., None].clip(0, 1))).clip(0, 1),
    }
    maps = TexelMaps.of_arrays(make_model("ggx", 1), {name: value.astype(np.float32) for name, value in arrays.items()})
    height = 0.04 * size * _clouds(size, 6, random) * 0.12
    down, right = np.gradient(height)
    normals = np.stack([-right, -down, np.ones_like(height)], -1)
    return SyntheticSurface(maps, (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32))


def _clouds(size: int, octaves: int, random: np.random.Generator) -> Array:
    """Smooth noise of mean 0 and standard deviation 1 with details down to 2^-octaves of a side, `(size, size)`."""
    total = np.zeros((size, size))
    for k in range(octaves):
        nodes = random.standard_normal((2 ** (k + 1) + 2,) * 2)
        place = (np.arange(size) + 0.5) / size * 2 ** (k + 1)
        low = place.astype(int)
        share = place - low
        share = share * share * (3 - 2 * share)
        rows = nodes[low] * (1 - share[:, None]) + nodes[low + 1] * share[:, None]
        total += 0.5**k * (rows[:, low] * (1 - share) + rows[:, low + 1] * share)
    return (total - total.mean()) / max(total.std(), 1e-9)


def _noise(seen: Array, noise: float, floor: float, tile: Tile, seed: int) -> Array:
    """Of each tile its own, so that no order matters."""
    random = np.random.default_rng([seed, tile.row, tile.column])
    deviation = np.sqrt((noise * seen) ** 2 + floor**2)
    return (deviation * random.standard_normal(seen.shape, dtype=np.float32)).astype(np.float32)


def true_errors(surface: SyntheticSurface, stack: Array, lights: Array, max_theta: float = 80.0) -> Array:
    """The errors of a stack at the true parameters, as `CosineRMSLoss` has them, `(H, W)`.

    Args:
        surface: the surface.
        stack: with noise, `(n, H, W, 3)`.
        lights: directions `(n, 3)`.
        max_theta: as `fit_texels` has it.

    Returns:
        Root mean squares over lights and channels.
    """
    found = np.empty(surface.maps.size)
    least = math.cos(math.radians(max_theta))
    for tile, seen in photograph(surface.maps, lights, normals=surface.normals):
        normals = surface.normals[tile.rows, tile.columns]
        counts = (np.einsum("nj,hwj->nhw", lights, normals) > least) & (normals[..., 2] > least)
        square = ((stack[:, tile.rows, tile.columns] - seen) ** 2).mean(-1)
        found[tile.rows, tile.columns] = np.sqrt((square * counts).sum(0) / counts.sum(0))
    return found
