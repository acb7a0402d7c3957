"""Several scenes side by side, as one picture that a loss compares."""

import math
from collections.abc import Sequence
from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.pairs import Pairs
from torchbrdf.precision import undisturbed
from torchbrdf.render.scene import Scene
from torchbrdf.render.transport.blocks import Block
from torchbrdf.render.transport.compact import KNOWN
from torchbrdf.render.transport.transport import Transport


class SideBySide:
    """Several scenes as one for a `RenderedLoss`: their pixels in one picture, each light as bright as the others.

    A fit that sees one scene is made to the directions which that shows most, and to its light; one that sees several
    is made to no one of them. Which pixel is whose neighbour has no meaning: it is for differences that are means over
    pixels.

    Args:
        scenes: What is drawn, with transports that are kept in memory.

    Raises:
        UsageError: There is no scene, or one is too large for memory.

    Example:
        >>> from torchbrdf.render import Camera, RenderedLoss, Scene, SideBySide, sphere
        >>> small = {"size": 8, "nodes": 8, "light_samples": 4}
        >>> both = SideBySide([Scene(sphere(2), **small), Scene(sphere(2), Camera(90), **small)])
        >>> RenderedLoss(both, "delta_e76").registered_name
        'rendered_delta_e76'
    """

    def __init__(self, scenes: Sequence[Scene]) -> None:
        if not scenes:
            raise UsageError("SideBySide: expected at least one scene, found none")
        self.scenes = tuple(scenes)

    @cached_property
    def size(self) -> int:
        """Pixels of a side of the picture that has all of theirs."""
        return math.ceil(sum(int(scene.mask.sum()) for scene in self.scenes) ** 0.5)

    @property
    def summary(self) -> str:
        """What they are made of, in words."""
        return f"{len(self.scenes)} scenes: {'; '.join(scene.summary for scene in self.scenes)}"

    @cached_property
    @undisturbed()
    def mask(self) -> Tensor:
        """Mask of the pixels that show something, `(size, size)`: the first ones."""
        place = torch.arange(self.size**2, dtype=torch.int64, device="cpu")
        return (place < sum(int(scene.mask.sum()) for scene in self.scenes)).unflatten(0, (self.size, self.size))

    @cached_property
    @undisturbed()
    def pairs(self) -> Pairs:
        """The compact pairs of all scenes, `(1, N)`; those of oriented ones."""
        parts = [scene.pairs for scene in self.scenes]
        if all(part.is_oriented for part in parts):
            return Pairs.joined(parts, oriented=True)
        return Pairs(**{name: torch.cat([getattr(one, name) for one in parts], 1) for name in KNOWN})

    @cached_property
    @undisturbed()
    def transport(self) -> Transport:
        """Light transport matrix of all scenes; a white diffuse object has a mean radiance of 1 in each."""
        blocks: list[Block] = []
        rows = columns = 0
        for scene in self.scenes:
            own = scene.transport
            if not own.in_memory:
                raise UsageError(f"SideBySide: expected scenes that fit into memory, found {scene.summary}")
            white = torch.full((1, own.count, 3), 1 / math.pi, dtype=torch.float32, device="cpu")
            unit = own.pixels(white).mean()
            blocks += [
                Block(block.rows + rows, block.start, block.column + columns, block.value / unit)
                for block in own.blocks
            ]
            rows, columns = rows + len(own.index), columns + own.count
        return Transport(columns, torch.arange(rows, dtype=torch.int64, device="cpu"), self.size, blocks)
