"""What lies in files of Ansys Speos: lines of text, or their binary kind, whose arrays are packed by LZ4."""

import struct
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.reading import check_unpacked

# Of a number while it is read: a text and a number of Python's.
_BYTES_A_NUMBER = 100
MOST_ANGLES = 10_000


class TextCursor:
    """The numbers of a text file, one line after the other.

    Args:
        path: The file, for errors.
        text: What it holds.
    """

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self._lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        self._at = 0

    def line(self) -> str:
        """The next line, which may be empty."""
        self._at += 1
        return self._lines[self._at - 1] if self._at <= len(self._lines) else ""

    def skip_text(self) -> None:
        """A line with a count of characters, and so many of them on the lines that follow; of none, an empty line."""
        said = self.line().strip()
        if not (said.isascii() and said.isdigit() and len(said) < 9):
            raise self.bad("a count of characters", said)
        left = int(said)
        if not left and self._lines[self._at : self._at + 1] != [""]:
            return
        while True:
            left -= len(self.line()) + 1
            if left < 0 or self._at > len(self._lines):
                return

    def numbers(self, count: int, what: str) -> np.ndarray:
        """So many numbers, on as many lines as they take."""
        check_unpacked(self.path, _BYTES_A_NUMBER * count)
        words: list[str] = []
        while len(words) < count:
            if self._at >= len(self._lines):
                raise self.bad(f"{count} numbers, {what}", f"the end behind {len(words)}")
            words += self.line().split()
        if len(words) != count:
            raise self.bad(f"{count} numbers, {what}", f"{len(words)}")
        try:
            if any("_" in word for word in words):  # which Python allows
                raise ValueError
            return np.array([float(word.replace(",", ".")) for word in words])
        except ValueError:
            raise self.bad(f"{count} numbers, {what}", shown(" ".join(words), 40)) from None

    def count(self, what: str) -> int:
        """A count of angles or wavelengths on a line of its own."""
        return self.counts(1, what)[0]

    def counts(self, size: int, what: str) -> list[int]:
        """Counts on a line of their own."""
        return _counts(self, self.numbers(size, what), what)

    def array(self, what: str) -> np.ndarray:
        """A count, and so many numbers behind."""
        count = self.count(what)
        return self.numbers(count, what) if count else np.empty(0)

    def table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """theta `(A,)`, phi `(B,)`, degrees, and values `(A, B)`."""
        rows, columns = self.counts(2, "of theta and phi")
        phi = self.numbers(columns, "phi")
        found = np.stack([self.numbers(columns + 1, "theta and values") for _ in range(rows)])
        return found[:, 0], phi, found[:, 1:]

    def spectrum(self) -> np.ndarray:
        """Rows of a wavelength and a reflectance, in percent, `(W, 2)`."""
        count = self.count("of wavelengths")
        return self.numbers(2 * count, "wavelengths and reflectances").reshape(count, 2)

    def left(self) -> str:
        """What is left of the file, in words; "" where nothing is."""
        count = sum(bool(line.strip()) for line in self._lines[self._at :])
        return f"{count} lines" if count else ""

    def bad(self, expected: str, found: str) -> DataError:
        """The error for what is not there."""
        return DataError(f"{self.path}: line {self._at}: expected {expected}, found {found or 'nothing'}")


class BinaryCursor:
    """The numbers of a binary file, one field after the other.

    Args:
        path: The file, for errors.
        data: What it holds.
        at: The byte behind its header.
    """

    def __init__(self, path: Path, data: bytes, at: int) -> None:
        self.path, self._data, self._at = path, data, at

    def fields(self, layout: str, what: str) -> tuple[float, ...]:
        """Numbers as `struct` names them."""
        layout = f"<{layout}"
        if self._at + struct.calcsize(layout) > len(self._data):
            raise self.bad(what, "the end")
        found = struct.unpack_from(layout, self._data, self._at)
        self._at += struct.calcsize(layout)
        return found

    def skip_text(self) -> None:
        """A count of characters, and so many of them."""
        (count,) = self.fields("i", "a count of characters")
        if not 0 <= count <= len(self._data) - self._at:
            raise self.bad("a count of characters", str(count))
        self._at += int(count)

    def numbers(self, count: int, what: str) -> np.ndarray:
        """So many numbers, as they are."""
        return np.array(self.fields(f"{count}d", what))

    def counts(self, size: int, what: str) -> list[int]:
        """Counts of angles or wavelengths."""
        return _counts(self, np.array(self.fields(f"{size}i", what), np.float64), what)

    def packed(self, count: int, what: str) -> np.ndarray:
        """So many numbers that are packed."""
        size, again, packed = (int(one) for one in self.fields("qii", what))
        if size != 8 * count or again != size or not 0 < packed <= len(self._data) - self._at:
            raise self.bad(f"{8 * count} bytes, {what}", f"{size}, {again} and {packed}")
        check_unpacked(self.path, size)
        found = unpack_lz4(self._data[self._at : self._at + packed], size)
        if found is None:
            raise self.bad(f"{size} bytes packed by LZ4, {what}", "damage")
        self._at += packed
        return np.frombuffer(found, "<f8")

    def array(self, what: str) -> np.ndarray:
        """A count, and so many numbers behind."""
        (count,) = self.counts(1, what)
        return self.packed(count, what)

    def table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """theta `(A,)`, phi `(B,)`, degrees, and values `(A, B)`."""
        rows, columns = self.counts(2, "of theta and phi")
        theta, phi = self.packed(rows, "theta"), self.packed(columns, "phi")
        return theta, phi, self.packed(rows * columns, "values").reshape(rows, columns)

    def spectrum(self) -> np.ndarray:
        """Rows of a wavelength and a reflectance, in percent, `(W, 2)`."""
        (count,) = self.counts(1, "of wavelengths")
        return self.numbers(2 * count, "wavelengths and reflectances").reshape(2, count).T

    def left(self) -> str:
        """What is left of the file, in words; "" where nothing is."""
        count = len(self._data) - self._at
        return f"{count} bytes" if count else ""

    def bad(self, expected: str, found: str) -> DataError:
        """The error for what is not there."""
        return DataError(f"{self.path}: byte {self._at}: expected {expected}, found {found}")


Cursor = TextCursor | BinaryCursor


def _counts(cursor: Cursor, found: np.ndarray, what: str) -> list[int]:
    if not all(one == np.floor(one) and 0 <= one <= MOST_ANGLES for one in found):
        raise cursor.bad(f"{'a count' if len(found) == 1 else 'counts'} {what}", shown(found.tolist()))
    return [int(one) for one in found]


def unpack_lz4(packed: bytes, size: int) -> bytes | None:
    r"""The bytes of one block that LZ4 packed; None where it is damaged or holds another count of bytes.

    Args:
        packed: The block, without a frame.
        size: How many bytes it becomes.

    Source: Y. Collet, LZ4 Block Format Description.

    Example:
        >>> from torchbrdf.measured.speos_file import unpack_lz4
        >>> unpack_lz4(b"\x14a\x01\x00\x30end", 12)
        b'aaaaaaaaaend'
    """
    found = bytearray()
    at = 0
    try:
        while len(found) <= size:
            token = packed[at]
            literals, at = _length(packed, at + 1, token >> 4)
            if at + literals > len(packed):
                return None
            found += packed[at : at + literals]
            at += literals
            if at == len(packed):
                return bytes(found) if len(found) == size else None
            back = packed[at] | packed[at + 1] << 8
            length, at = _length(packed, at + 2, token & 15)
            length += 4
            if not 0 < back <= len(found) or len(found) + length > size:
                return None
            piece = bytes(found[-back:])
            found += (piece * (length // back + 1))[:length]
    except IndexError:
        pass
    return None


def _length(packed: bytes, at: int, first: int) -> tuple[int, int]:
    """A length, which goes on in bytes of 255, and where it ends."""
    if first == 15:
        while True:
            first += packed[at]
            at += 1
            if packed[at - 1] != 255:
                break
    return first, at
