"""A surface whose maps are known, made up: painted metal and stone, worn, with bumps."""

import math
from dataclasses import dataclass

import numpy as np

from torchbrdf.errors import UsageError
from torchbrdf.lobes import make_model
from torchbrdf.texels.maps import TexelMaps
from torchbrdf.texels.photographs import photograph

Array = np.ndarray

# Texels of a row whose noise is drawn together.
BLOCK = 64
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

    def camera(self, lights: Array, noise: float = 0.01, floor: float = 0.001, seed: int = 0) -> "Camera":
        """A camera above, which sees the surface under each light: the observations of `fit_texels`, made when asked.

        Args:
            lights: directions `(n, 3)`.
            noise: standard deviation, in units of the value.
            floor: that of what is there without light.
            seed: of the noise.

        Returns:
            A function of rows and columns, which gives `(n, h, w, 3)`; each texel has its own noise.
        """
        return Camera(self, lights, noise, floor, seed)

    def stack(self, lights: Array, noise: float = 0.01, floor: float = 0.001, seed: int = 0) -> Array:
        """All that such a camera sees, `(n, H, W, 3)`, float32."""
        return self.camera(lights, noise, floor, seed)(*(slice(0, side) for side in self.maps.size))


@dataclass(frozen=True)
class Camera:
    """A camera above a made-up surface, see `SyntheticSurface.camera`."""

    surface: SyntheticSurface
    lights: Array
    noise: float
    floor: float
    seed: int

    def __call__(self, rows: slice, columns: slice) -> Array:
        """What it sees of a part."""
        seen = self.without_noise(rows, columns)
        for k, row in enumerate(range(rows.start, rows.stop)):
            deviation = np.sqrt((self.noise * seen[:, k]) ** 2 + self.floor**2)
            seen[:, k] += deviation * self._noise(row, columns)
        return seen

    def without_noise(self, rows: slice, columns: slice) -> Array:
        """What is there to see."""
        own = self.surface
        return photograph(own.maps, self.lights, rows, columns, normals=own.normals)

    def true_errors(self, rows: slice, columns: slice, max_theta: float = 80.0) -> Array:
        """The errors of what it sees at the true parameters, as `CosineRMSLoss` has them, `(h, w)`."""
        normals = self.surface.normals[rows, columns]
        least = math.cos(math.radians(max_theta))
        counts = (np.einsum("nj,hwj->nhw", self.lights, normals) > least) & (normals[..., 2] > least)
        square = ((self(rows, columns) - self.without_noise(rows, columns)) ** 2).mean(-1)
        return np.sqrt((square * counts).sum(0) / counts.sum(0))

    def _noise(self, row: int, columns: slice) -> Array:
        """Of part of a row, `(n, w, 3)`: the same, however it is asked for."""
        first, last = columns.start // BLOCK, -(-columns.stop // BLOCK)
        shape = (len(self.lights), BLOCK, 3)
        blocks = [
            np.random.default_rng([self.seed, row, block]).standard_normal(shape, dtype=np.float32)
            for block in range(first, last)
        ]
        return np.concatenate(blocks, 1)[:, columns.start - first * BLOCK : columns.stop - first * BLOCK]


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
