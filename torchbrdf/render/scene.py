"""A scene is pairs of directions for every pixel, and how much each counts; a picture is their weighted sum."""

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchbrdf import memory
from torchbrdf.errors import UsageError
from torchbrdf.pairs import Pairs
from torchbrdf.precision import undisturbed
from torchbrdf.render.light.environment import Environment
from torchbrdf.render.light.punctual import PunctualLight
from torchbrdf.render.raster.camera import Camera
from torchbrdf.render.raster.mesh import Mesh, blob
from torchbrdf.render.raster.pixels import rasterize_pixels
from torchbrdf.render.transport.blocks import Block
from torchbrdf.render.transport.cache import digest, load_or_build
from torchbrdf.render.transport.compact import CompactScene
from torchbrdf.render.transport.oriented import every_pair
from torchbrdf.render.transport.quadrature import (
    CHUNK,
    HalfVectorQuadrature,
    LightQuadrature,
    PunctualQuadrature,
    Quadrature,
    turned,
)
from torchbrdf.render.transport.transport import Transport, in_places

if TYPE_CHECKING:
    from torchbrdf.render.transport.shadows import Occluder

Chunk = tuple[Tensor, Pairs, Tensor]

# Of an entry of a transport, which is not kept if it could take more than half of the memory.
_BYTES_PER_ENTRY = 16


class Scene:
    """An object in light, seen by a camera: all that a picture needs beside the BRDF.

    A picture is linear in the BRDF's values on `scene.pairs`: `scene.transport @ values`. There is no interreflection.

    Args:
        mesh: The object.
        camera: From where it is seen; by default `Camera()`.
        environment: Light from all around; by default the bundled grove, or none if there are `punctual_lights`.
        size: Pixels of a side.
        nodes: Half vectors around each pixel's mirror direction, so that lobes of any sharpness are drawn with the
            same few light samples; at least 8.
        light_samples: Directional lights that stand for the environment elsewhere.
        punctual_lights: Point and directional lights.
        shadows: Whether the object casts shadows on itself (a convex one has none); needs embreex.
        backend: What finds the triangle of each pixel: "software", "pyrender", or "auto", the faster one here.
        resolution: Bins of theta_h, theta_d and phi_d of the compact pairs, 4 to 1024 each.
        cache: A folder where the transport is kept.
        oriented: Pairs are every pixel's own, with directions in the frame of the mesh's tangents, as lobes with a
            grain need them: many more than the compact ones, so that scenes for fits have to be small.

    Raises:
        UsageError: A number is out of its range, or the backend does not work here.
        DataError: The mesh covers no pixel.

    Example:
        >>> from torchbrdf.render import sphere
        >>> scene = Scene(sphere(2), size=8, nodes=8, light_samples=4)
        >>> picture = scene.transport @ torch.ones(1, len(scene.pairs), 3)  # a BRDF that is 1 / sr everywhere
        >>> picture.shape
        torch.Size([1, 8, 8, 3])
    """

    @undisturbed()
    def __init__(
        self,
        mesh: Mesh,
        camera: Camera | None = None,
        environment: Environment | None = None,
        size: int = 400,
        nodes: int = 256,
        light_samples: int = 1024,
        *,
        punctual_lights: Sequence[PunctualLight] = (),
        shadows: bool = False,
        backend: str = "software",
        resolution: tuple[int, int, int] = (90, 36, 27),
        cache: Path | str | None = None,
        oriented: bool = False,
    ) -> None:
        if size < 1 or nodes < 8:
            raise UsageError(f"Scene: expected size >= 1 and nodes >= 8, found size {size}, nodes {nodes}")
        if min(resolution) < 4 or max(resolution) > 1024:
            raise UsageError(f"Scene: expected 4 to 1024 bins of each angle, found resolution {resolution}")
        self.mesh = mesh
        self.camera = camera or Camera()
        self.environment = Environment.default() if environment is None and not punctual_lights else environment
        self.size, self.nodes, self.light_samples = size, nodes, light_samples
        self.punctual_lights = tuple(punctual_lights)
        self.shadows, self.backend, self.resolution = shadows, backend, resolution
        self.cache = None if cache is None or oriented else Path(cache)  # the pairs of oriented scenes are soon made
        self.oriented = oriented
        self._pixels = rasterize_pixels(mesh, self.camera, size, backend)
        occluder = _occluder(mesh) if shadows else None
        self._quadratures: list[Quadrature] = []
        if self.environment is not None:
            self._quadratures.append(HalfVectorQuadrature(self._pixels, self.environment, nodes, occluder))
            samples = self.environment.light_samples(light_samples)
            self._quadratures.append(LightQuadrature(self._pixels, samples, resolution, occluder))
        if punctual_lights:
            self._quadratures.append(PunctualQuadrature(self._pixels, punctual_lights, occluder))

    @property
    def coverage(self) -> Tensor:
        """Coverage: the share of each pixel that the object covers, `(size, size)`."""
        return self._pixels.coverage

    @property
    @undisturbed()
    def mask(self) -> Tensor:
        """Mask of the pixels that show the object, `(size, size)`."""
        return self.coverage > 0

    @property
    @undisturbed()
    def view_cosine(self) -> Tensor:
        """Cosine between the normal and the way to the viewer in each pixel, `(size, size)`, 0 where there is none."""
        found = torch.zeros(self.size**2, dtype=torch.float32, device="cpu")
        found[self._pixels.index] = self._pixels.outgoing[2]
        return found.unflatten(0, (self.size, self.size))

    def jobs(self, oriented: bool = False) -> list[Callable[[], Chunk]]:
        """Functions that make the parts of the quadrature: pixels `(p,)`, Pairs `(1, p L)`, weights `(p, L, 3)`.

        Pixels count row by row. Each comes up once in every part of the quadrature. oriented: with directions in the
        frame of the mesh's tangents, which anisotropic materials need.
        """

        def job(part: Quadrature, rows: Tensor) -> Chunk:
            pairs, weight = part.samples(rows)
            return self._pixels.index[rows], turned(pairs, self._pixels.azimuth[rows]) if oriented else pairs, weight

        return [partial(job, part, rows) for part, rows in self._jobs]

    @property
    def _jobs(self) -> list[tuple[Quadrature, Tensor]]:
        whole = torch.arange(len(self._pixels), dtype=torch.int64, device="cpu")
        return [(part, rows) for part in self._quadratures for rows in whole.split(max(CHUNK // part.length, 1))]

    @property
    def is_compact(self) -> bool:
        """Whether pairs have been taken for one already."""
        return "compact" in vars(self)

    def picture(self, pixels: Tensor) -> Tensor:
        """`(M, P, 3)` of the pixels that show something in their places, `(M, size, size, 3)`."""
        return in_places(pixels, self._pixels.index, self.size)

    @cached_property
    @undisturbed()
    def compact(self) -> CompactScene:
        """The quadratures on the compact pairs: what draws many pictures, without gradients."""
        return CompactScene(self._quadratures, len(self._pixels), memory.limit() // 2)

    @cached_property
    @undisturbed()
    def _whole(self) -> tuple[Pairs, Transport]:
        index = self._pixels.index
        if self.oriented:
            pairs, blocks = every_pair(self._jobs, self._pixels.azimuth, memory.limit() // 2)
            return pairs, Transport(len(pairs), index, self.size, blocks)
        if len(index) * sum(part.length for part in self._quadratures) * _BYTES_PER_ENTRY > memory.limit() // 2:
            pairs = self.compact.pairs
            return pairs, Transport(len(pairs), index, self.size, self.compact.blocks)

        def build() -> tuple[Pairs, list[Block]]:
            return self.compact.pairs, self.compact.merged()

        if self.cache is None:
            pairs, blocks = build()
        else:
            pairs, blocks = load_or_build(self.cache, self._ingredients(), len(index), len(self._quadratures), build)
        return pairs, Transport(len(pairs), index, self.size, blocks)

    def _ingredients(self) -> list[object]:
        """All that the transport is made of."""
        mesh = [self.mesh.vertices, self.mesh.faces, self.mesh.normals]
        if self.mesh.tangents is not None:
            mesh.append(self.mesh.tangents)
        light = [self.environment.texels.numpy(), self.environment.rotation] if self.environment else []
        numbers = (self.size, self.nodes, self.light_samples, self.shadows, self.resolution)
        return [
            *mesh,
            *light,
            repr((self.camera, self.punctual_lights, *numbers, *(["oriented"] if self.oriented else []))),
            self._pixels.index.numpy(),
            self._pixels.frame.numpy(),
        ]

    @property
    def summary(self) -> str:
        """What a picture of it is made of, in words, and a hash of all of that."""
        parts = [f"{self.size} x {self.size} pixels"]
        if self.environment:
            parts.append(f"{self.nodes} directions around the mirror's and {self.light_samples} lights a pixel")
        if self.punctual_lights:
            parts.append(f"{len(self.punctual_lights)} punctual lights")
        return ", ".join([*parts, digest(self._ingredients())])

    @property
    def pairs(self) -> Pairs:
        """The compact pairs, `(1, N)`: those of all pixels, with those that are nearly equal taken for one.

        BRDFs are taken for reciprocal, as MERL's tables are: pairs that only exchange light and viewer are one, too. Of
        an oriented scene all pairs that light falls on.
        """
        return self._whole[0] if self.cache or self.oriented else self.compact.pairs

    @property
    def transport(self) -> Transport:
        """Light transport matrix, which makes the picture of values on `pairs`."""
        return self._whole[1]


def small_scene(
    mesh: Mesh | None = None,
    environment: Environment | None = None,
    *,
    size: int = 24,
    light_samples: int = 1024,
    cache: Path | str | None = None,
    oriented: bool = False,
) -> Scene:
    """A scene whose picture costs a fit no more than the samples of a table, for `CombinedLoss`.

    Few pixels, fewer half vectors around each, and a sixth of the pairs that a `Scene` of that size has: compared with
    other pictures of the same scene, none is far off.

    Args:
        mesh: The object; by default `blob()`.
        environment: As of `Scene`, as what follows.
        size: Pixels of a side.
        light_samples: Directional lights.
        cache: A folder where the transport is kept.
        oriented: As of `Scene`.

    Returns:
        The scene.

    Example:
        >>> from torchbrdf.losses import CombinedLoss, CompressedLoss
        >>> from torchbrdf.render import RenderedLoss
        >>> CombinedLoss(CompressedLoss(), RenderedLoss(small_scene(size=8))).registered_name
        'compressed+rendered_delta_e76'
    """
    return Scene(
        blob() if mesh is None else mesh,
        None,
        environment,
        size=size,
        nodes=64,
        light_samples=light_samples,
        resolution=(24, 16, 12),
        cache=cache,
        oriented=oriented,
    )


def _occluder(mesh: Mesh) -> "Occluder":
    from torchbrdf.render.transport.shadows import Occluder  # late, because only shadows need a ray caster

    return Occluder(mesh)
