"""Chunks of OpenEXR files: whether all are there, before the library looks for them and prints what it misses.

Source: https://openexr.com/en/latest/OpenEXRFileLayout.html.
"""

from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError
from torchbrdf.images.exr_header import Header, Tiles

# Lines in a chunk, by the number of the compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K256
# and HTJ2K32.
_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32)
_ONE_LEVEL, _MIPMAP = 0, 1


def check_chunks(path: Path, data: bytes, header: Header) -> None:
    """Refuse a file that is cut off, or that was never finished.

    Raises:
        DataError: A chunk is missing or goes past the end of the file, or the compression is none that there is.
    """
    if not 0 <= header.compression < len(_LINES):
        raise DataError(f"{path}: expected a compression of OpenEXR, found number {header.compression}")
    count = (
        _tiles(header, header.tiles)
        if header.tiles
        else -(-header.data_window.shape()[0] // _LINES[header.compression])
    )
    table_end = header.end + 8 * count
    missing = count
    if table_end <= len(data):
        offsets = np.frombuffer(data, "<u8", count, header.end)
        # What stands before the size of a chunk: its part, and its first line or the place of its tile.
        before = 4 * header.in_parts + (16 if header.tiles else 4)
        there = (offsets >= table_end) & (offsets <= max(len(data) - before - 4, 0))
        at = np.where(there, offsets, 0).astype(np.int64) + before
        sizes = np.frombuffer(data, np.uint8)[at[:, None] + np.arange(4)].view("<i4")[:, 0]
        there &= (sizes >= 0) & (at + 4 + sizes <= len(data))
        missing = count - int(there.sum())
    if missing:
        raise DataError(
            f"{path}: expected a whole OpenEXR picture, found {missing} of {count} chunks missing or cut off"
        )


def _tiles(header: Header, tiles: Tiles) -> int:
    """How many tiles there are, of all levels."""
    height, width = header.data_window.shape()
    down, across, mode = tiles.down, tiles.across, tiles.levels
    if mode == _ONE_LEVEL:
        return -(-width // across) * -(-height // down)
    longest = max(width, height)
    wide = [-(-side // across) for side in _sides(width, longest if mode == _MIPMAP else width, tiles.is_up)]
    high = [-(-side // down) for side in _sides(height, longest if mode == _MIPMAP else height, tiles.is_up)]
    return sum(x * y for x, y in zip(wide, high, strict=True)) if mode == _MIPMAP else sum(wide) * sum(high)


def _sides(side: int, longest: int, is_up: bool) -> list[int]:
    """A side at every level: half of the one before, rounded, as long as the longest side is above 1."""
    if is_up:
        return [-(-side // 2**level) for level in range((longest - 1).bit_length() + 1)]
    return [max(side >> level, 1) for level in range(longest.bit_length())]
