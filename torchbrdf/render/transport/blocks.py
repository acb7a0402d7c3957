"""Entries of a transport for some pixels, in the forms that fit where they come from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

AT_ONCE = 32
"""Columns of a product at a time: a visit of an entry costs the same for one column and for these many."""
# What is added to an int16 to make all of its values columns.
_HALF_WAY = 2**15
# Columns that matrix products work on at a time, or a multiple of them.
_WHOLE = 16


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

    def products(self, tables: Sequence[Tensor]) -> list[Tensor]:
        """As those of the other kinds of blocks."""
        return [self.channel(k).times(table)[0] for k, table in enumerate(tables)]

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.column.nbytes + self.value.nbytes

    def channel(self, k: int) -> "Block":
        """The block with the values of one channel only."""
        return Block(self.rows, self.start, self.column, self.value[k : k + 1])

    def to(self, device: torch.device | str) -> "Block":
        """The block on another device."""
        return Block(*(part.to(device) for part in (self.rows, self.start, self.column, self.value)))

    def packed(self, columns: int) -> "Block":
        """The block itself."""
        return self

    def compressed(self, first: int) -> "Block":
        """The block with columns counted from `first`."""
        return Block(self.rows, self.start, self.column + first, self.value)

    def select(self, own: Tensor, rows: Tensor) -> "Block":
        """Only some rows `own`, by their place in the block, in this order, and what they are then called."""
        lengths = (self.start[1:] - self.start[:-1])[own].long()
        end = lengths.cumsum(0)
        entry = torch.arange(int(end[-1]) if len(end) else 0, dtype=torch.int64, device=end.device) + (
            self.start[:-1][own] - end + lengths
        ).repeat_interleave(lengths)
        return Block(rows, F.pad(end, (1, 0)).int(), self.column[entry], self.value[:, entry])

    def transposed(self, columns: int) -> "Block":
        """The transposed block: entries column by column, with the rows in the place of columns."""
        from scipy import sparse  # late, as it takes long to import

        # scipy turns the pattern round in linear time; what it carries along says where each entry went.
        shape = (len(self.start) - 1, columns)
        order = np.arange(len(self.column), dtype=np.int32)
        turned = sparse.csr_matrix((order, self.column.numpy(), self.start.numpy()), shape).tocsc()
        rows, start, entry = (torch.from_numpy(part) for part in (turned.indices, turned.indptr, turned.data))
        value = torch.stack([one[entry.long()] for one in self.value])
        every = torch.arange(columns, dtype=torch.int64, device="cpu")
        return Block(every, start.to(torch.int32), self.rows.to(torch.int32)[rows.long()], value)


@dataclass(frozen=True)
class LightBlock:
    """Entries of some pixels for the same lights: one number each, and each light's colour.

    rows: `(p,)`; column: `(p, L)`, int32; weight: `(p, L)`, float32, 0 where the light is below the horizon; color:
    `(3, L)`. In a packed one columns are int16, counted from -2^15, if there are not too many, and weights are float16.
    """

    rows: Tensor
    column: Tensor
    weight: Tensor
    color: Tensor

    def products(self, tables: Sequence[Tensor]) -> list[Tensor]:
        """Products with columns of numbers, `(N, K)` of each channel: `(p, K)` of each."""
        column = self.column if self.column.dtype == torch.int32 else self.column.to(torch.int32).add_(_HALF_WAY)
        weight, lights = self.weight.float(), column.shape[1]
        flat, weighted = column.flatten(), torch.empty_like(weight)
        starts = torch.arange(0, len(flat), lights, dtype=torch.int32, device=flat.device)
        found = []
        for table, color in zip(tables, self.color, strict=True):
            own = torch.mul(weight, color, out=weighted).flatten()
            # What F.embedding_bag calls, without its checks, which take as long as a tenth of the work.
            found.append(torch.embedding_bag(table, flat, starts, False, 0, False, own)[0])
        return found

    def packed(self, columns: int) -> "LightBlock":
        """In half of the bytes, if there are so many columns. Pictures are 80 dB and more from those of float32."""
        column = (self.column - _HALF_WAY).to(torch.int16) if columns <= 2 * _HALF_WAY else self.column
        return LightBlock(self.rows, column, self.weight.half(), self.color)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.column.nbytes + self.weight.nbytes

    def compressed(self, first: int) -> Block:
        """What is not 0, row after row, with columns counted from `first`."""
        used = self.weight > 0
        start = F.pad(used.sum(1).cumsum(0), (1, 0)).to(torch.int32)
        light = torch.arange(used.shape[1], dtype=torch.int64, device="cpu").expand_as(used)[used]
        return Block(self.rows, start, self.column[used] + first, self.weight[used] * self.color[:, light])


@dataclass(frozen=True)
class NodeBlock:
    """Entries of pixels that see the same pairs, each in light of its own: a dense matrix for each channel.

    rows: `(p,)`; column: `(n,)`, int64; weight: `(3, p, n)`, float32.
    """

    rows: Tensor
    column: Tensor
    weight: Tensor

    def products(self, tables: Sequence[Tensor]) -> list[Tensor]:
        """Products with columns of numbers, `(N, K)` of each channel: `(p, K)` of each."""
        found = []
        for weight, table in zip(self.weight, tables, strict=True):
            columns = table.shape[1]
            # Matrix products round the last columns otherwise than others: equal columns shall give equal ones.
            whole = F.pad(table[self.column], (0, -columns % _WHOLE))
            found.append((weight @ whole)[:, :columns])
        return found

    def packed(self, columns: int) -> "NodeBlock":
        """The block itself: radiance may be more than float16 can hold."""
        return self

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.weight.nbytes

    def compressed(self, first: int) -> Block:
        """What is not 0, row after row, with columns counted from `first`."""
        used = (self.weight > 0).any(0)
        start = F.pad(used.sum(1).cumsum(0), (1, 0)).to(torch.int32)
        column = (self.column + first).to(torch.int32).expand_as(used)[used]
        return Block(self.rows, start, column, self.weight[:, used])


Entries = Block | LightBlock | NodeBlock
