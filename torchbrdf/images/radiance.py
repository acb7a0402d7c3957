"""Radiance pictures (.hdr, .pic): RGBE or XYZE, in all orientations and encodings of the format.

Source: Greg Ward, Radiance file formats, https://radsite.lbl.gov/radiance/refer/filefmts.pdf, and Radiance's own
reader, color.c.
"""

import logging
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.images.primaries import REC709, XYZ, converted, to_rec709
from torchbrdf.reading import check_unpacked

_LONGEST_HEADER = 65536
_RESOLUTION = re.compile(rb"([-+])([XY]) (\d{1,9}) ([-+])([XY]) (\d{1,9})\r?")
# Of scan lines that may be run-length encoded channel by channel.
_SHORTEST, _LONGEST = 8, 32767
_LARGEST_SIDE = 32768
# Of a pixel that is returned.
_PIXEL = 12


@dataclass
class _Header:
    """What a header says of the pixels; factors are products of all that it gives."""

    xyz: bool = False
    factors: tuple[float, ...] = (1.0, 1.0, 1.0)
    primaries: tuple[float, ...] = REC709


def read_radiance(path: Path, data: bytes) -> np.ndarray:
    """The picture in a Radiance file, `(H, W, 3)`, float32; see `read_image`."""
    header, start = _header(path, data)
    end = data.find(b"\n", start, start + 256)
    match = _RESOLUTION.fullmatch(data[start : max(end, start)])
    if match is None or match[2] == match[5]:
        found = shown(data[start : start + 48])
        raise DataError(f"{path}: expected a resolution like '-Y 512 +X 1024', found {found}")
    count, length = int(match[3]), int(match[6])
    if not (0 < count <= _LARGEST_SIDE and 0 < length <= _LARGEST_SIDE):
        raise DataError(f"{path}: expected sides of 1 to {_LARGEST_SIDE} pixels, found {count} x {length}")
    check_unpacked(path, _PIXEL * count * length)
    rgbe = _scan_lines(path, data, end + 1, count, length)
    if match[2] == b"X":
        rgbe = rgbe.transpose(1, 0, 2)
    signs = {match[2]: match[1], match[5]: match[4]}
    rgbe = rgbe[:: 1 if signs[b"Y"] == b"-" else -1, :: 1 if signs[b"X"] == b"+" else -1]
    return np.ascontiguousarray(_values(path, rgbe, header))


def _values(path: Path, rgbe: np.ndarray, header: _Header) -> np.ndarray:
    """Linear values; a mantissa m stands for m 2^(e - 136)."""
    scale = np.ldexp(np.float32(1), rgbe[..., 3].astype(np.int32) - 136)
    scale[rgbe[..., 3] == 0] = 0
    picture = rgbe[..., :3] * scale[..., None]
    with np.errstate(over="ignore"):
        if header.factors != (1.0, 1.0, 1.0):
            picture /= np.array(header.factors, dtype=np.float32)
        picture = converted(picture, to_rec709(path, XYZ if header.xyz else header.primaries))
    if not np.isfinite(picture).all():
        raise DataError(f"{path}: expected values that float32 holds, found larger ones divided by {header.factors}")
    return picture


def _header(path: Path, data: bytes) -> tuple[_Header, int]:
    """What the header says, and where the line with the resolution starts.

    Variables stand at the start of a line; those of pictures that this one was made of are indented.
    """
    header, start = _Header(), 0
    while True:
        end = data.find(b"\n", start, _LONGEST_HEADER)
        if end < 0:
            raise DataError(f"{path}: expected a Radiance picture, found a header without an end")
        line = data[start:end].rstrip(b"\r")
        start = end + 1
        if not line:
            return header, start
        key, _, value = line.partition(b"=")
        key = key.rstrip().upper()  # not all writers are strict; what is indented is of a picture that this was made of
        if key == b"FORMAT":
            if value.strip() not in (b"32-bit_rle_rgbe", b"32-bit_rle_xyze"):
                raise DataError(f"{path}: expected FORMAT=32-bit_rle_rgbe or _xyze, found {shown(value.strip())}")
            header.xyz = value.strip().endswith(b"xyze")
        elif key in (b"EXPOSURE", b"COLORCORR"):
            given = _numbers(path, key, value, 1 if key == b"EXPOSURE" else 3)
            header.factors = tuple(
                old * new for old, new in zip(header.factors, given * (3 // len(given)), strict=True)
            )
            if not all(1e-12 < factor < 1e12 for factor in header.factors):
                raise DataError(f"{path}: expected a positive {key.decode()}, found {shown(value.strip())}")
        elif key == b"PRIMARIES":
            header.primaries = _numbers(path, key, value, 8)
        elif key in (b"PIXASPECT", b"GAMMA") and abs(_numbers(path, key, value, 1)[0] - 1) > 1e-3:
            raise DataError(f"{path}: expected {key.decode()}=1, found {shown(value.strip())}")


def _numbers(path: Path, key: bytes, text: bytes, count: int) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise DataError(f"{path}: expected {key.decode()} with {count} numbers, found {shown(text.strip())}")
    return values


def _scan_lines(path: Path, data: bytes, start: int, count: int, length: int) -> np.ndarray:
    """The bytes of all pixels, `(count, length, 4)`. Nothing is made that the length of the file does not vouch for."""
    is_flat = len(data) - start == 4 * count * length
    try:
        lines, end = _encoded_lines(path, data, start, count, length)
    except DataError:
        if not is_flat:
            raise
        end = start
    if is_flat and end != len(data):  # some pixels look like an encoding
        return np.frombuffer(data, np.uint8, offset=start).reshape(count, length, 4)
    if end != len(data):
        left = len(data) - end
        logging.getLogger("torchbrdf").warning("torchbrdf: %s: %d bytes behind the picture mean nothing", path, left)
    return np.stack(lines)


def _encoded_lines(path: Path, data: bytes, start: int, count: int, length: int) -> tuple[list[np.ndarray], int]:
    """Lines of which each says for itself how it is encoded, and where they end."""
    marker = bytes((2, 2, length >> 8 & 127, length & 255)) if _SHORTEST <= length <= _LONGEST else None
    lines = []
    for number in range(count):
        where = f"{path}: scan line {number} of {count}"
        decode, at = (_channels, start + 4) if data[start : start + 4] == marker else (_pixels, start)
        line, start = decode(where, data, at, length)
        lines.append(line)
    return lines, start


def _channels(where: str, data: bytes, start: int, length: int) -> tuple[np.ndarray, int]:
    """A line of four channels in run lengths, `(length, 4)`, and where the next one starts."""
    line = bytearray()
    for channel in range(1, 5):
        full = channel * length
        while len(line) < full and start + 1 < len(data) and data[start]:
            count = data[start]
            if count > 128:
                line += data[start + 1 : start + 2] * (count - 128)
                start += 2
            else:
                line += data[start + 1 : start + 1 + count]
                start += 1 + count
        if len(line) != full or start > len(data):
            raise DataError(f"{where}: run lengths do not add up to {length} at byte {min(start, len(data))}")
    return np.frombuffer(line, np.uint8).reshape(4, length).T, start


def _pixels(where: str, data: bytes, start: int, length: int) -> tuple[np.ndarray, int]:
    """A line of whole pixels, `(length, 4)`, and where the next one starts.

    Bytes 1, 1, 1, n repeat the pixel before n times; of such that follow each other, the second counts 256 times
    as much, and so on.
    """
    pixels = np.frombuffer(data, np.uint8, count=min(length, (len(data) - start) // 4) * 4, offset=start)
    pixels = pixels.reshape(-1, 4)
    repeats = (pixels[:, :3] == 1).all(-1)
    if not repeats.any():
        if len(pixels) < length:
            raise DataError(f"{where}: expected {length} pixels, found {len(pixels)}")
        return pixels, start + 4 * length
    place = np.arange(len(pixels))
    last = np.maximum.accumulate(np.where(repeats, -1, place))  # the pixel that each repeats, itself for one
    shift = np.minimum(8 * (place - last - 1), 32)
    times = np.where(repeats, pixels[:, 3].astype(np.int64) << np.where(repeats, shift, 0), 1)
    used = int(np.searchsorted(np.cumsum(times), length)) + 1
    if last[0] < 0 or times[:used].sum() != length:
        raise DataError(f"{where}: repeated pixels do not add up to {length} at byte {start}")
    return np.repeat(pixels[last[:used]], times[:used], axis=0), start + 4 * used
