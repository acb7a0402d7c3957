"""A picture as a linear function of BRDF values on a compact set of pairs: one sparse product."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from scipy import sparse
from torch import Tensor

from torchbrdf.errors import DataError, ShapeError
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import thread_map
from torchbrdf.render.transport.quadrature import Quadrature

# What is known of the pairs.
KNOWN = ("cos_i", "cos_o", "cos_d", "cos_h", "tan2_h", "theta_h", "theta_d", "phi_d")
# Columns of a product at a time: more of them no longer fit the processor's cache.
_AT_ONCE = 8


@dataclass(frozen=True)
class Block:
    """Entries of some rows of a sparse matrix with three values each, for red, green and blue light.

    rows: `(p,)`, the rows; start: `(p + 1,)`, where each row's entries begin and end; column: `(E,)`, int32; value:
    `(3, E)`, float32.
    """

    rows: Tensor
    start: Tensor
    column: Tensor
    value: Tensor

    def times(self, table: Tensor) -> Tensor:
        """Product of the block with columns of numbers `(N, K)`, `(3, p, K)`."""
        # embedding_bag is torch's fastest sparse product: both cores, no copy of the gathered rows.
        found = [
            F.embedding_bag(
                self.column, table, self.start, mode="sum", per_sample_weights=value, include_last_offset=True
            )
            for value in self.value.to(table.dtype)
        ]
        return torch.stack(found)

    def channel(self, k: int) -> "Block":
        """The block with the values of one channel only."""
        return Block(self.rows, self.start, self.column, self.value[k : k + 1])

    def to(self, device: torch.device | str) -> "Block":
        """The block on another device."""
        return Block(*(part.to(device) for part in (self.rows, self.start, self.column, self.value)))

    def transposed(self, columns: int) -> "Block":
        """The transposed block: entries column by column, with the rows in the place of columns."""
        # scipy turns the pattern round in linear time; what it carries along says where each entry went.
        shape = (len(self.start) - 1, columns)
        order = np.arange(len(self.column), dtype=np.int32)
        turned = sparse.csr_matrix((order, self.column.numpy(), self.start.numpy()), shape).tocsc()
        rows, start, entry = (torch.from_numpy(part) for part in (turned.indices, turned.indptr, turned.data))
        value = torch.stack([one[entry.long()] for one in self.value])
        every = torch.arange(columns, dtype=torch.int64, device="cpu")
        return Block(every, start.to(torch.int32), self.rows.to(torch.int32)[rows.long()], value)


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
        whole = pixels.new_zeros(len(pixels), self.size**2, 3)
        return whole.index_copy(1, self.index.to(pixels.device), pixels).unflatten(1, (self.size, self.size))

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
            for first in range(0, len(shapes), _AT_ONCE):
                some = slice(first, first + _AT_ONCE)
                part = block.times(shapes[some].T.contiguous())
                if len(block.rows) == len(self.index):  # blocks of all rows have them in order
                    found[..., some] += part
                else:
                    found[..., some] = found[..., some].index_add(1, block.rows, part)
        return found.permute(2, 0, 1)

    def matrices(self) -> list[sparse.csr_matrix]:
        """The matrix of each channel, `(P, N)`, on the CPU."""
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
            lengths = (block.start[1:] - block.start[:-1])[own].long()
            end = lengths.cumsum(0)
            entry = torch.arange(int(end[-1]) if len(end) else 0, dtype=torch.int64, device=end.device) + (
                block.start[:-1][own] - end + lengths
            ).repeat_interleave(lengths)
            parts.append(
                Block(wanted[block.rows[own]], F.pad(end, (1, 0)).int(), block.column[entry], block.value[:, entry])
            )
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
        groups = [slice(first, first + _AT_ONCE) for first in range(0, len(values), _AT_ONCE)]
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


Job = tuple[Quadrature, Tensor]


def build_transport(jobs: Sequence[Job], parts: Sequence[Quadrature]) -> tuple[Pairs, Callable[[], Iterator[Block]]]:
    """Build a transport: compact pairs `(1, N)`, float32, and what gives the blocks, job after job.

    Pairs of directions that fall into one bin are taken for one, at their weighted mean place.
    """
    sums = [np.zeros((1 + part.dimensions, part.bins)) for part in parts]

    def bin_sums(job: Job) -> tuple[int, np.ndarray, list[np.ndarray]]:
        part, rows = job
        pairs, weight = part.samples(rows)
        bins, place = part.bin(rows, pairs)
        heavy = weight.sum(-1).flatten()
        used = heavy > 0
        found, inverse = np.unique(bins[used].numpy(), return_inverse=True)
        counted = heavy[used].numpy()
        own = [np.bincount(inverse, counted), *(np.bincount(inverse, counted * one) for one in place[:, used].numpy())]
        return parts.index(part), found, own

    for k, there, own in thread_map(bin_sums, jobs):
        sums[k][:, there] += np.stack(own)
    columns, known, first = [], [], 0
    for part, total in zip(parts, sums, strict=True):
        filled = np.flatnonzero(total[0])
        column = torch.full((part.bins,), -1, dtype=torch.int32, device="cpu")
        column[torch.from_numpy(filled)] = torch.arange(first, first + len(filled), dtype=torch.int32, device="cpu")
        columns.append(column)
        first += len(filled)
        mean = torch.from_numpy(total[1:, filled] / total[0, filled])
        known.append(part.representatives(torch.from_numpy(filled), mean))
    if not first:
        raise DataError("scene: no light reaches what is seen of the object")
    whole = {name: torch.cat([getattr(one, name) for one in known], 1).to(torch.float32) for name in KNOWN}

    def block(job: Job) -> Block:
        part, rows = job
        pairs, weight = part.samples(rows)
        bins, _ = part.bin(rows, pairs)
        used = (weight > 0).any(-1)
        start = F.pad(used.sum(1).cumsum(0), (1, 0)).to(torch.int32)
        used = used.flatten()
        column = columns[parts.index(part)][bins[used]]
        return Block(rows, start, column, weight.reshape(-1, 3)[used].T.contiguous())

    return Pairs(**whole), lambda: thread_map(block, jobs)


def merge_blocks(blocks: Iterator[Block], jobs: Sequence[Job], parts: Sequence[Quadrature]) -> list[Block]:
    """Merge the blocks of each quadrature into one with all rows."""
    own: list[list[Block]] = [[] for _ in parts]
    for (part, _), block in zip(jobs, blocks, strict=True):
        own[parts.index(part)].append(block)
    found = []
    for several in own:
        starts, first = [torch.zeros(1, dtype=torch.int32, device="cpu")], 0
        for block in several:
            starts.append(block.start[1:] + first)
            first += len(block.column)
        found.append(
            Block(
                torch.cat([block.rows for block in several]),
                torch.cat(starts),
                torch.cat([block.column for block in several]),
                torch.cat([block.value for block in several], 1),
            )
        )
    return found
