"""The quadratures of a scene on their compact pairs: the products of many pictures, and the entries themselves."""

from collections.abc import Callable, Iterator, Sequence
from itertools import accumulate

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import thread_map
from torchbrdf.render.transport.blocks import AT_ONCE, Block, Entries
from torchbrdf.render.transport.quadrature import Compact, Quadrature

# What is known of the pairs.
KNOWN = ("cos_i", "cos_o", "cos_d", "cos_h", "tan2_h", "theta_h", "theta_d", "phi_d")
# Groups of pixels that a thread takes at a time.
_JOBS = 4


class CompactScene:
    """What makes pictures of values on the compact pairs of all quadratures, and keeps it if there is room.

    Args:
        quadratures: Of the scene.
        count: P, its pixels.
        room: Bytes; entries that have been worked out are kept for the next product if they take no more.

    Raises:
        DataError: No light reaches what is seen.
    """

    def __init__(self, quadratures: Sequence[Quadrature], count: int, room: int) -> None:
        self.parts: list[Compact] = [one.compact() for one in quadratures]
        self.count, self.room = count, room
        self._kept: list[list[Entries]] | None = None
        if not any(len(part.pairs) for part in self.parts):
            raise DataError("scene: no light reaches what is seen of the object")
        whole = {name: torch.cat([getattr(one.pairs, name) for one in self.parts], 1) for name in KNOWN}
        self.pairs = Pairs(**{name: value.to(torch.float32) for name, value in whole.items()})

    @property
    def firsts(self) -> list[int]:
        """Where the pairs of each part begin."""
        return [sum(len(part.pairs) for part in self.parts[:k]) for k in range(len(self.parts))]

    @torch.no_grad()
    def pixels(self, values: Tensor, advance: Callable[[int], None] = lambda rows: None) -> Tensor:
        """The pixels of values on the pairs, `(M, N, 3)` to `(M, P, 3)`; `advance` is told how many rows are done."""
        found = values.new_zeros(3, self.count, len(values))
        kept: list[list[Entries]] = []
        used = 0
        for k, (part, first) in enumerate(zip(self.parts, self.firsts, strict=True)):
            items = part.groups if self._kept is None else self._kept[k]
            blocks: list[Entries] = []
            for block in self._products(part, items, values[:, first : first + len(part.pairs)], found):
                used += block.nbytes
                blocks.append(block)
                if used > self.room:
                    blocks.clear()
                    kept.clear()
                advance(len(block.rows))
            kept.append(blocks)
        self._kept = kept if used <= self.room else None
        return found.permute(2, 1, 0)

    def _products(
        self, part: Compact, items: Sequence[Tensor | Entries], values: Tensor, found: Tensor
    ) -> Iterator[Entries]:
        """Add what one quadrature makes of values `(M, n, 3)` to pixels `(3, P, M)`; its blocks."""
        tables = [[some[..., channel].T.contiguous() for channel in range(3)] for some in values.split(AT_ONCE)]
        own = torch.empty_like(found)  # in the order of the groups, so that each has a place of its own
        starts = [0, *accumulate(map(len, part.groups))]

        def work(jobs: Sequence[tuple[int, Tensor | Entries]]) -> list[Entries]:
            blocks = []
            for first, item in jobs:
                block = part.block(item).packed(len(part.pairs)) if isinstance(item, Tensor) else item
                for at, some in enumerate(tables):
                    for channel, product in enumerate(block.products(some)):
                        columns = slice(at * AT_ONCE, at * AT_ONCE + product.shape[1])
                        own[channel, first : first + len(product), columns] = product
                blocks.append(block)
            return blocks

        jobs = list(zip(starts, items, strict=False))
        for blocks in thread_map(work, [jobs[n : n + _JOBS] for n in range(0, len(jobs), _JOBS)]):
            yield from blocks
        if part.groups:
            found += own.index_select(1, torch.cat(part.groups).argsort())

    def forget(self) -> None:
        """Give the memory of kept entries back."""
        self._kept = None

    def blocks(self) -> Iterator[Block]:
        """All entries, part after part, with columns that count all pairs."""
        for part, first in zip(self.parts, self.firsts, strict=True):
            for block in thread_map(part.block, part.groups):
                yield block.compressed(first)

    def merged(self) -> list[Block]:
        """The same as one block a part, of all rows in their order."""
        found = []
        for part, first in zip(self.parts, self.firsts, strict=True):

            def work(rows: Tensor, part: Compact = part, first: int = first) -> Block:
                return part.block(rows).compressed(first)

            found.append(_in_order(list(thread_map(work, part.groups)), self.count))
        return found


def _in_order(blocks: Sequence[Block], count: int) -> Block:
    """Blocks as one, with all rows."""
    every = torch.arange(count, dtype=torch.int64, device="cpu")
    if not blocks:
        nothing = torch.zeros(count + 1, dtype=torch.int32, device="cpu")
        return Block(every, nothing, nothing[:0], torch.zeros(3, 0, dtype=torch.float32, device="cpu"))
    starts, first = [torch.zeros(1, dtype=torch.int32, device="cpu")], 0
    for block in blocks:
        starts.append(block.start[1:] + first)
        first += len(block.column)
    whole = Block(
        torch.cat([block.rows for block in blocks]),
        torch.cat(starts),
        torch.cat([block.column for block in blocks]),
        torch.cat([block.value for block in blocks], 1),
    )
    return whole if torch.equal(whole.rows, every) else whole.select(whole.rows.argsort(), every)
