"""A scene's transport on all of its pairs, with directions in the frame of the surface's tangent."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import thread_map
from torchbrdf.render.transport.blocks import Block
from torchbrdf.render.transport.quadrature import Quadrature, turned

# Of a pair: what is known of it, an entry, and as much again while they are joined.
_BYTES = 256


def every_pair(jobs: Sequence[tuple[Quadrature, Tensor]], azimuth: Tensor, room: int) -> tuple[Pairs, list[Block]]:
    """All pairs that light falls on, `(1, N)`, and what makes pictures of values there.

    Args:
        jobs: Parts of the quadrature, and rows of pixels.
        azimuth: Of the surface's tangent in each pixel's frame, radians, `(P,)`.
        room: Bytes that they may take.

    Raises:
        UsageError: They would take more.
    """
    count = sum(part.length * len(rows) for part, rows in jobs)
    if count * _BYTES > room:
        raise UsageError(
            f"Scene: expected at most {room // _BYTES} pairs of an oriented scene in memory, found {count}; take fewer "
            "pixels, nodes or light_samples"
        )

    def work(job: tuple[Quadrature, Tensor]) -> tuple[Pairs, Block]:
        part, rows = job
        pairs, weight = part.samples(rows)
        lit = (weight > 0).any(-1) & pairs.above_horizon.reshape(weight.shape[:2])
        kept = lit.flatten().nonzero()[:, 0]
        start = F.pad(lit.sum(1).cumsum(0), (1, 0)).int()
        column = torch.arange(len(kept), dtype=torch.int32, device=kept.device)
        own = turned(pairs, azimuth[rows]).select(samples=kept).to(dtype=torch.float32)
        return own, Block(rows, start, column, weight.flatten(0, 1)[kept].T.contiguous())

    parts, blocks, first = [], [], 0
    for pairs, block in thread_map(work, list(jobs)):
        parts.append(pairs)
        blocks.append(block.compressed(first))
        first += len(pairs)
    return Pairs.joined(parts, oriented=True), blocks
