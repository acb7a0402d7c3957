"""A picture as a linear function of BRDF values on a compact set of pairs: one sparse product."""

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.render.transport.blocks import AT_ONCE, Block

if TYPE_CHECKING:
    from scipy import sparse


class Transport:
    """Light transport matrix: what makes the picture of BRDF values on a scene's pairs, `transport @ values`.

    Args:
        count: N, the pairs.
        index: Where each of the P rows of the matrix is in the picture, `(P,)`, row by row.
        size: Pixels of a side of the picture.
        blocks: The entries, each row in one or several blocks: kept in memory, or, where that would be too much, a
            function that makes them anew for each product.
    """

    def __init__(self, count: int, index: Tensor, size: int, blocks: Sequence[Block] | Callable[[], Iterator[Block]]):
        self.count, self.index, self.size = count, index, size
        self._blocks = blocks
        self._turned: list[Block] | None = None

    @property
    def in_memory(self) -> bool:
        """Whether the entries are in memory."""
        return not callable(self._blocks)

    @property
    def blocks(self) -> Iterator[Block]:
        """Blocks of entries."""
        return self._blocks() if callable(self._blocks) else iter(self._blocks)

    @property
    def entries(self) -> int:
        """How many entries there are."""
        return sum(len(block.column) for block in self.blocks)

    def __matmul__(self, values: Tensor) -> Tensor:
        """The linear picture `(M, size, size, 3)` of values `(M, N, 3)` in 1/sr, 0 where nothing is; differentiable.

        Raises:
            ShapeError: The values are not on the scene's pairs.
        """
        return self.picture(self.pixels(values))

    def picture(self, pixels: Tensor) -> Tensor:
        """`(M, P, 3)` in their places in the picture, `(M, size, size, 3)`."""
        return in_places(pixels, self.index, self.size)

    def pixels(self, values: Tensor) -> Tensor:
        """The rows of the picture that show something, `(M, P, 3)`, of values `(M, N, 3)`; differentiable."""
        if values.dim() != 3 or values.shape[1:] != (self.count, 3):
            raise ShapeError(f"transport: expected values (M, {self.count}, 3), found {(*values.shape,)}")
        return _Product.apply(values, self)

    def columns(self, shapes: Tensor) -> Tensor:
        """What scalar functions look like, `(K, N)` to `(K, 3, P)`: as seen by each channel of the light."""
        if shapes.dim() != 2 or shapes.shape[1] != self.count:
            raise ShapeError(f"transport: expected functions (K, {self.count}), found {(*shapes.shape,)}")
        found = shapes.new_zeros(3, len(self.index), len(shapes))
        for block in self.blocks:
            for first in range(0, len(shapes), AT_ONCE):
                some = slice(first, first + AT_ONCE)
                part = block.times(shapes[some].T.contiguous())
                if len(block.rows) == len(self.index):  # blocks of all rows have them in order
                    found[..., some] += part
                else:
                    found[..., some] = found[..., some].index_add(1, block.rows, part)
        return found.permute(2, 0, 1)

    def matrices(self) -> "list[sparse.csr_matrix]":
        """The matrix of each channel, `(P, N)`, on the CPU."""
        from scipy import sparse  # late, as it takes long to import

        parts = [(block.rows.repeat_interleave(block.start.diff()), block.column, block.value) for block in self.blocks]
        rows, columns, values = (torch.cat(one, -1).cpu().numpy() for one in zip(*parts, strict=True))
        return [sparse.csr_matrix((own, (rows, columns)), (len(self.index), self.count)) for own in values]

    def select_rows(self, rows: Tensor) -> tuple["Transport", Tensor]:
        """Only some rows, and only the pairs that these need: the new transport, and which of the pairs it keeps."""
        wanted = torch.full((len(self.index),), -1, dtype=torch.int64, device=self.index.device)
        wanted[rows] = torch.arange(len(rows), dtype=torch.int64, device=self.index.device)
        parts = []
        for block in self.blocks:
            own = (wanted[block.rows] >= 0).nonzero()[:, 0]
            parts.append(block.select(own, wanted[block.rows[own]]))
        kept = torch.zeros(self.count, dtype=torch.bool, device=self.index.device)
        for part in parts:
            kept[part.column.long()] = True
        place = (kept.cumsum(0) - 1).to(torch.int32)
        parts = [Block(part.rows, part.start, place[part.column.long()], part.value) for part in parts]
        return Transport(int(kept.sum()), self.index[rows], self.size, parts), kept.nonzero()[:, 0]

    def to(self, device: torch.device | str) -> "Transport":
        """The transport on another device."""
        if callable(self._blocks):
            make = self._blocks
            return Transport(self.count, self.index.to(device), self.size, lambda: (one.to(device) for one in make()))
        return Transport(self.count, self.index.to(device), self.size, [block.to(device) for block in self._blocks])

    def backward(self, gradient: Tensor) -> Tensor:
        """The transposed product, `(M, P, 3)` to `(M, N, 3)`."""
        if self.in_memory and self._turned is None and gradient.device.type == "cpu":
            self._turned = [block.transposed(self.count) for block in self.blocks]
        found = gradient.new_zeros(3, self.count, len(gradient))
        if self._turned is not None:
            for block in self._turned:
                for channel in range(3):
                    found[channel] += block.channel(channel).times(gradient[..., channel].T.contiguous())[0]
        else:
            for block in self.blocks:
                row = block.rows.repeat_interleave((block.start[1:] - block.start[:-1]).long())
                for channel in range(3):
                    weighted = gradient[..., channel].T[row] * block.value[channel].to(gradient.dtype)[:, None]
                    found[channel].index_add_(0, block.column, weighted)
        return found.permute(2, 1, 0)


class _Product(torch.autograd.Function):
    """transport.pixels: torch's own derivatives of sparse products take a hundred times as long."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, transport: Transport) -> Tensor:
        ctx.transport = transport
        found = values.new_zeros(3, len(transport.index), len(values))
        groups = [slice(first, first + AT_ONCE) for first in range(0, len(values), AT_ONCE)]
        tables = [[values[some, :, channel].T.contiguous() for some in groups] for channel in range(3)]
        for block in transport.blocks:
            for channel in range(3):
                own = block.channel(channel)
                for some, table in zip(groups, tables[channel], strict=True):
                    found[channel, :, some].index_add_(0, block.rows, own.times(table)[0])
        return found.permute(2, 1, 0)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return ctx.transport.backward(gradient), None


def in_places(pixels: Tensor, index: Tensor, size: int) -> Tensor:
    """`(M, P, 3)` where `index` says in pictures `(M, size, size, 3)`, which are 0 elsewhere."""
    whole = pixels.new_zeros(len(pixels), size**2, 3)
    return whole.index_copy(1, index.to(pixels.device), pixels).unflatten(1, (size, size))
