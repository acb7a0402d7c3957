"""A scene is pairs of directions for every pixel, and how much each counts; a picture is their weighted sum."""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.pairs import Pairs
from torchbrdf.render.light.environment import Environment
from torchbrdf.render.light.punctual import Lamp
from torchbrdf.render.raster.camera import View
from torchbrdf.render.raster.mesh import Mesh
from torchbrdf.render.raster.pixels import see
from torchbrdf.render.transport.cache import digest, kept
from torchbrdf.render.transport.quadrature import Fixed, Lit, Mirror, Part
from torchbrdf.render.transport.transport import Block, Transport, compact, gathered

if TYPE_CHECKING:
    from torchbrdf.render.transport.shadows import Occluder

Chunk = tuple[Tensor, Pairs, Tensor]

# Pairs at a time: their quantities then stay in a processor's cache.
_CHUNK = 65536
# A transport whose entries could take more bytes is not kept, but made anew for each product.
LARGEST = 2**31
_BYTES_PER_ENTRY = 16


class Scene:
    """An object in an environment, seen by a camera: what a picture needs beside the BRDF.

    mesh, view: what is seen, and from where. environment: light from all around; the bundled grove, if there are no
    `lamps` either, which are point and directional lights. size: pixels of a side. nodes, lights: of the quadrature,
    see `render.transport.quadrature`: nodes around each pixel's mirror direction, so that lobes of any sharpness are
    drawn with the same few lights, and lights that stand for the environment elsewhere. shadows: whether the object
    casts shadows on itself (a convex one has none). There is no interreflection. backend: what finds the triangle of
    each pixel, software, pyrender, or auto. resolution: bins of theta_h, theta_d and phi_d of the compact pairs.
    cache: a folder where the transport is kept.
    """

    def __init__(
        self,
        mesh: Mesh,
        view: View | None = None,
        environment: Environment | None = None,
        size: int = 400,
        nodes: int = 256,
        lights: int = 1024,
        *,
        lamps: Sequence[Lamp] = (),
        shadows: bool = False,
        backend: str = "software",
        resolution: tuple[int, int, int] = (60, 45, 30),
        cache: Path | str | None = None,
    ) -> None:
        if size < 1 or nodes < 8:
            raise UsageError(f"Scene: expected size >= 1 and nodes >= 8, found size {size}, nodes {nodes}")
        if min(resolution) < 4 or max(resolution) > 1024:
            raise UsageError(f"Scene: expected 4 to 1024 bins of each angle, found resolution {resolution}")
        self.mesh = mesh
        self.view = view or View()
        self.environment = Environment.default() if environment is None and not lamps else environment
        self.size, self.nodes, self.lights, self.lamps = size, nodes, lights, tuple(lamps)
        self.shadows, self.backend, self.resolution = shadows, backend, resolution
        self.cache = None if cache is None else Path(cache)
        self._pixels = see(mesh, self.view, size, backend)
        occluder = _occluder(mesh) if shadows else None
        self._parts: list[Part] = []
        if self.environment is not None:
            self._parts.append(Mirror(self._pixels, self.environment, nodes, occluder))
            self._parts.append(Fixed(self._pixels, self.environment.lights(lights), resolution, occluder))
        if lamps:
            self._parts.append(Lit(self._pixels, lamps, occluder))

    @property
    def coverage(self) -> Tensor:
        """The share of each pixel that the object covers, `(size, size)`."""
        return self._pixels.coverage

    @property
    def mask(self) -> Tensor:
        """Where there is something to see, `(size, size)`."""
        return self.coverage > 0

    def chunks(self) -> Iterator[Chunk]:
        """The whole quadrature in parts: pixels `(p,)`, Pairs `(1, p L)`, weights `(p, L, 3)`.

        Pixels count row by row. Each comes up once in every part of the quadrature.
        """
        return (job() for job in self.jobs())

    def jobs(self) -> list[Callable[[], Chunk]]:
        """What makes each of the chunks, so that they can be made side by side."""

        def job(part: Part, rows: Tensor) -> Chunk:
            return self._pixels.index[rows], *part.make(rows)

        return [partial(job, part, rows) for part, rows in self._jobs]

    @property
    def _jobs(self) -> list[tuple[Part, Tensor]]:
        whole = torch.arange(len(self._pixels))
        return [(part, rows) for part in self._parts for rows in whole.split(max(_CHUNK // part.length, 1))]

    @cached_property
    def _compact(self) -> tuple[Pairs, Callable[[], Iterator[Block]]]:
        return compact(self._jobs, self._parts)

    @cached_property
    def _whole(self) -> tuple[Pairs, Transport]:
        index = self._pixels.index
        if len(index) * sum(part.length for part in self._parts) * _BYTES_PER_ENTRY > LARGEST:
            pairs, make = self._compact
            return pairs, Transport(len(pairs), index, self.size, make)

        def build() -> tuple[Pairs, list[Block]]:
            pairs, make = self._compact
            return pairs, gathered(make(), self._jobs, self._parts)

        pairs, blocks = build() if self.cache is None else kept(self.cache, self._ingredients(), build)
        return pairs, Transport(len(pairs), index, self.size, blocks)

    def _ingredients(self) -> list[object]:
        """All that the transport is made of."""
        mesh = [self.mesh.vertices, self.mesh.faces, self.mesh.normals]
        light = [self.environment.texels.numpy(), self.environment.rotation] if self.environment else []
        numbers = (self.view, self.size, self.nodes, self.lights, self.lamps, self.shadows, self.resolution)
        return [*mesh, *light, repr(numbers), self._pixels.index.numpy(), self._pixels.frame.numpy()]

    @property
    def summary(self) -> str:
        """What a picture of it is made of, in words, and a hash of all of that."""
        light = (
            f"{self.nodes} directions around the mirror's and {self.lights} lights a pixel" if self.environment else ""
        )
        lamps = f"{len(self.lamps)} lamps" if self.lamps else ""
        parts = [f"{self.size} x {self.size} pixels", light, lamps, digest(self._ingredients())]
        return ", ".join(part for part in parts if part)

    @property
    def pairs(self) -> Pairs:
        """The compact pairs, `(1, N)`: those of all pixels, with those that are nearly equal taken for one.

        BRDFs are taken for reciprocal, as MERL's tables are: pairs that only exchange light and viewer are one, too.
        """
        return self._whole[0]

    @property
    def transport(self) -> Transport:
        """What makes the picture of the values on `pairs`."""
        return self._whole[1]


def _occluder(mesh: Mesh) -> "Occluder":
    from torchbrdf.render.transport.shadows import Occluder  # late, because only shadows need a ray caster

    return Occluder(mesh)
