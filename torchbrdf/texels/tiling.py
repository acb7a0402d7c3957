"""Which texels are worked on together."""

from collections.abc import Iterator
from dataclasses import dataclass

from torchbrdf.errors import UsageError


@dataclass(frozen=True)
class Tile:
    """A rectangle of texels.

    Args:
        row: which it is, counted in tiles from the top.
        column: the same from the left.
        rows: of the texels.
        columns: of the texels.

    Example:
        >>> Tile(0, 1, slice(0, 64), slice(64, 100)).shape
        (64, 36)
    """

    row: int
    column: int
    rows: slice
    columns: slice

    @property
    def name(self) -> str:
        """What its file is called, without the suffix."""
        return f"{self.row:05d}-{self.column:05d}"

    @property
    def shape(self) -> tuple[int, int]:
        """How many rows and columns."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    def grown(self, margin: int, size: tuple[int, int]) -> "Tile":
        """With so many texels more on every side, as far as the surface of this size goes."""
        rows, columns = (
            slice(max(part.start - margin, 0), min(part.stop + margin, whole))
            for part, whole in zip((self.rows, self.columns), size, strict=True)
        )
        return Tile(self.row, self.column, rows, columns)

    def common(self, other: "Tile") -> "Tile":
        """The texels that both have, if they have any."""
        rows, columns = (
            slice(max(one.start, two.start), min(one.stop, two.stop))
            for one, two in ((self.rows, other.rows), (self.columns, other.columns))
        )
        return Tile(self.row, self.column, rows, columns)

    def within(self, other: "Tile") -> tuple[slice, slice]:
        """Where it lies in a larger one."""
        return (
            slice(self.rows.start - other.rows.start, self.rows.stop - other.rows.start),
            slice(self.columns.start - other.columns.start, self.columns.stop - other.columns.start),
        )


@dataclass(frozen=True)
class Tiling:
    """A surface of `size` rows and columns in tiles of `side` each way, the last of a row or column smaller."""

    size: tuple[int, int]
    side: int

    def __post_init__(self) -> None:
        if not isinstance(self.side, int) or not 8 <= self.side <= 512:
            raise UsageError(f"tile: expected 8 to 512 texels of a side, found {self.side}")

    def __len__(self) -> int:
        return -(-self.size[0] // self.side) * -(-self.size[1] // self.side)

    def __iter__(self) -> Iterator[Tile]:
        yield from self.meeting(Tile(0, 0, slice(0, self.size[0]), slice(0, self.size[1])))

    def meeting(self, part: Tile) -> Iterator[Tile]:
        """The tiles that have texels of a part."""
        for row in range(part.rows.start // self.side, -(-part.rows.stop // self.side)):
            for column in range(part.columns.start // self.side, -(-part.columns.stop // self.side)):
                parts = (
                    slice(k * self.side, min((k + 1) * self.side, whole))
                    for k, whole in zip((row, column), self.size, strict=True)
                )
                yield Tile(row, column, *parts)
