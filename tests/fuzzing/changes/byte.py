"""Changes of bytes, whatever they mean; and of numbers and words in text."""

import re
import struct
from random import Random

# Places where fixed headers lie.
HEADER = 512
LENGTHS = (0, 1, 2, 3, 127, 128, 255, 256, 32767, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
NUMBERS = (
    "nan", "NaN", "inf", "-inf", "Infinity", "1e308", "-1e308", "1e999", "1e-300", "-1e-7", "-0.0", "0", "-1", "1.5",
    "65536", str(2**31), str(2**32), str(2**63), str(2**64), "1" + "0" * 23, "9" * 5000, "1_000", "0x10", "1,25", "",
    "true", "null", "1e", "--1", "٣", "1.0", "1e400", "3.4e38", "1e39",
)  # fmt: skip
WORDS = (
    "", " ", "a\nb", "a\r\nb", "nul\0", "\x1b[31mred\x1b]0;pwned\x07", "\ud800", "x" * 200, "x" * 10_000, "..", ".",
    "/",
    "../../escaped", "/tmp/escaped", "a/b", "a\\b", "C:\\x", "~", "-rf", "$\\bad{", "$x$", "=1+1", "@SUM(A1)", "+1",
    "%s%n",
    "{0}", "<img src=x>", "\u202egnp", "\u200b", "\u2028", "é" * 50, "日本", "\U0001f600", "a" + "\u0301" * 60,
    "\ufeff",
    "null", "nan", "None", "con", "aux.txt", "'; DROP TABLE x", "\t", "a\x85b", "\x7f", "measured", "1", "2",
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9-]*")


def encoded(text: str) -> bytes:
    """Text as UTF-8, half of a surrogate pair as what it would be."""
    return text.encode("utf-8", "surrogatepass")


def flip(source: Random, data: bytes) -> bytes:
    """Other bits."""
    found = bytearray(_some(data))
    for _ in range(source.choice((1, 1, 2, 8, 64))):
        found[source.randrange(len(found))] ^= 1 << source.randrange(8)
    return bytes(found)


def overwrite(source: Random, data: bytes) -> bytes:
    """Other bytes in one place."""
    start, end = _part(source, _some(data))
    filler = source.choice((b"\0", b"\xff", b"\x80", b" ", b"\n", b"9", None))
    new = source.randbytes(end - start) if filler is None else filler * (end - start)
    return data[:start] + new + data[end:]


def cut(source: Random, data: bytes) -> bytes:
    """The end is missing."""
    return data[: source.randrange(len(_some(data)))]


def leave_out(source: Random, data: bytes) -> bytes:
    """A part is missing."""
    start, end = _part(source, _some(data))
    return data[:start] + data[end:]


def insert(source: Random, data: bytes) -> bytes:
    """Something new between."""
    place = source.randrange(len(data) + 1)
    return data[:place] + source.choice((b"\0", b"\xff", b"\n", b"\xef\xbb\xbf", source.randbytes(9))) + data[place:]


def append(source: Random, data: bytes) -> bytes:
    """Something behind the end, or in front."""
    more = source.choice((b"\0", b"\n", b"\0" * 4096, source.randbytes(100), data))
    return source.choice((data + more, more + data))


def repeat(source: Random, data: bytes) -> bytes:
    """A part comes again and again."""
    start, end = _part(source, _some(data))
    return data[:end] + data[start:end] * source.choice((1, 2, 50)) + data[end:]


def swap(source: Random, data: bytes) -> bytes:
    """Two parts change places."""
    a, b, c = sorted(source.randrange(len(_some(data)) + 1) for _ in range(3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


def empty(source: Random, data: bytes) -> bytes:
    """Nothing, or nearly so."""
    return source.choice((b"", b"\n", b"\0", b" ", data[:1], data[:4], data[:64]))


def other_encoding(source: Random, data: bytes) -> bytes:
    """The same text as other programs store it."""
    text = data.decode("latin-1")
    return text.encode(source.choice(("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "utf-7")))


def line_ends(source: Random, data: bytes) -> bytes:
    """Lines that end otherwise."""
    return data.replace(b"\n", source.choice((b"\r\n", b"\r", b"\n\n", b"\x0b", b" ")))


def length(source: Random, data: bytes) -> bytes:
    """A whole number in the header is another."""
    found = bytearray(_some(data))
    size, code = source.choice(((1, "B"), (2, "H"), (4, "I"), (4, "I"), (8, "Q")))
    place = source.randrange(max(min(len(found), HEADER) - size, 0) + 1)
    order = source.choice("<>")
    number = struct.pack(order + code, source.choice(LENGTHS) % 256**size)
    found[place : place + size] = number[: len(found) - place]
    return bytes(found)


def number(source: Random, data: bytes) -> bytes:
    """A number in text is another."""
    return _exchange(source, data, _NUMBER, encoded(source.choice(NUMBERS)))


def word(source: Random, data: bytes) -> bytes:
    """A word in text is another."""
    return _exchange(source, data, _WORD, encoded(source.choice(WORDS)))


def line(source: Random, data: bytes) -> bytes:
    """A line of text is gone, comes twice, elsewhere, very long, or in halves."""
    lines = data.split(b"\n")
    place = source.randrange(len(lines))
    kind = source.randrange(5)
    if kind == 0:
        del lines[place]
    elif kind == 1:
        lines.insert(place, lines[place])
    elif kind == 2:
        lines.insert(source.randrange(len(lines)), lines.pop(place))
    elif kind == 3:
        lines[place] += b" " + lines[place].split(b" ")[-1] * source.choice((3, 3000))
    else:
        lines[place] = lines[place][: len(lines[place]) // 2]
    return b"\n".join(lines)


BYTES = (flip, overwrite, cut, leave_out, insert, append, repeat, swap, empty, length)
TEXT = (number, number, word, line, line_ends, other_encoding)


def splice(source: Random, data: bytes, other: bytes) -> bytes:
    """The beginning of one file and the end of another."""
    return data[: source.randrange(len(data) + 1)] + other[source.randrange(len(other) + 1) :]


def _some(data: bytes) -> bytes:
    if not data:
        raise ValueError("nothing to change")
    return data


def _part(source: Random, data: bytes) -> tuple[int, int]:
    start = source.randrange(min(len(data), source.choice((HEADER, len(data)))))
    return start, min(len(data), start + source.choice((1, 2, 4, 8, 64, 1000)))


def _exchange(source: Random, data: bytes, pattern: re.Pattern[bytes], new: bytes) -> bytes:
    places = [match.span() for match in pattern.finditer(data, 0, 1 << 20)]
    if not places:
        raise ValueError("nothing to change")
    # What stands in front is changed as often as all that follows.
    start, end = source.choice(places[: source.choice((8, len(places)))])
    return data[:start] + new + data[end:]
