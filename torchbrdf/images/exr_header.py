"""Headers of OpenEXR files: what a reader has to know before it believes the rest, and what it must not pass over.

Source: https://openexr.com/en/latest/OpenEXRFileLayout.html, https://openexr.com/en/latest/StandardAttributes.html.
"""

import logging
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from torchbrdf.errors import DataError, shown
from torchbrdf.images.primaries import AP0, REC709

_TILED, _DEEP, _PARTS = 0x200, 0x800, 0x1000
_KINDS = (("uint", 4), ("half", 2), ("float", 4))
_LONGEST_NAME = 255
# A tile may be larger than its picture; the library makes room for all of it.
_LARGEST_TILE = 4096**2
# The sides of a picture; the library multiplies some of them in 32 bits.
_LARGEST_SIDE = 2**20

# Color Interop Forum, An ID for Color Interop: those of linear colours.
_ACES_WHITE = AP0[6:]
_COLOR_SPACES: dict[str, tuple[float, ...]] = {
    "lin_rec709_scene": REC709,
    "lin_ap0_scene": AP0,
    "lin_ap1_scene": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *_ACES_WHITE),
    "lin_p3d65_scene": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *REC709[6:]),
    "lin_rec2020_scene": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *REC709[6:]),
    "lin_adobergb_scene": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *REC709[6:]),
}

Attributes = dict[str, bytes]


class Channel(NamedTuple):
    """A channel: what it holds, its bytes for a value, and for how many pixels across and down there is one."""

    name: str
    kind: str
    size: int
    step: tuple[int, int]


class Window(NamedTuple):
    """A rectangle of pixels, with its last ones."""

    left: int
    top: int
    right: int
    bottom: int

    def shape(self, step: tuple[int, int] = (1, 1)) -> tuple[int, int]:
        """How many samples it has down and across, with one in so many pixels across and down."""
        return (self.bottom - self.top) // step[1] + 1, (self.right - self.left) // step[0] + 1

    def __str__(self) -> str:
        return f"({self.left}, {self.top}) to ({self.right}, {self.bottom})"


@dataclass(frozen=True)
class Header:
    """What the header of a file with one picture says.

    Attributes:
        channels: All that there are.
        data_window: The pixels that are stored.
        display_window: The picture.
        primaries: CIE x and y of red, green, blue and white.
        neutral: CIE x and y of what is to look white, if that is given.
    """

    channels: tuple[Channel, ...]
    data_window: Window
    display_window: Window
    primaries: tuple[float, ...]
    neutral: tuple[float, ...] | None

    @property
    def unpacked(self) -> int:
        """Bytes of all channels, or of the picture that is returned, whichever are more."""
        stored = sum(channel.size * math.prod(self.data_window.shape(channel.step)) for channel in self.channels)
        returned = 12 * max(math.prod(self.data_window.shape()), math.prod(self.display_window.shape()))
        return max(stored, returned)


def read_header(path: Path, data: bytes) -> Header:
    """The header of a file.

    Raises:
        DataError: It is damaged, or says something of the pixels that is not understood.
    """
    try:
        parts, flags = _parts(data)
        if len(parts) != 1:
            names = [part.get("name", b"").decode("utf-8", "replace") for part in parts]
            raise DataError(f"{path}: expected one picture, found {len(parts)} parts: {shown(names, 120)}")
        return _understood(path, parts[0], flags)
    except (ValueError, struct.error, IndexError, KeyError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{path}: expected an OpenEXR picture, found a damaged header: {error}") from None


def _parts(data: bytes) -> tuple[list[Attributes], int]:
    """The attributes of each part as bytes, by name, and the flags of the file."""
    flags = struct.unpack_from("<I", data, 4)[0]
    parts, at = [], 8
    while True:
        part: Attributes = {}
        while True:
            name, at = _text(data, at)
            if not name:
                break
            _, at = _text(data, at)
            size = struct.unpack_from("<i", data, at)[0]
            at += 4
            if name in part or not 0 <= size <= len(data) - at:
                raise ValueError(f"attribute {shown(name)} of {size} bytes")
            part[name] = data[at : at + size]
            at += size
        if part:
            parts.append(part)
        if not (part and flags & _PARTS):
            return parts, flags


def _text(data: bytes, at: int) -> tuple[str, int]:
    """The text that ends with a zero, and where the next thing starts."""
    end = data.index(b"\0", at, at + _LONGEST_NAME + 1)
    return data[at:end].decode("utf-8"), end + 1


def _understood(path: Path, part: Attributes, flags: int) -> Header:
    kind = part.get("type", b"tiledimage" if flags & _TILED else b"scanlineimage").decode()
    if flags & _DEEP or kind not in ("scanlineimage", "tiledimage"):
        raise DataError(f"{path}: expected one value for a pixel, found a picture of type {shown(kind)}")
    aspect = struct.unpack("<f", part["pixelAspectRatio"])[0]
    if not abs(aspect - 1) <= 1e-3:
        raise DataError(f"{path}: expected square pixels, found pixelAspectRatio {aspect:g}")
    if part.get("envmap", b"\0") != b"\0":
        raise DataError(f"{path}: expected a flat picture or one of latitude and longitude, found a cube (envmap)")
    views = _texts(part.get("multiView", b""))
    if len(views) > 1:
        raise DataError(f"{path}: expected one view, found multiView {shown(views)}")
    windows = [Window(*struct.unpack("<4i", part[f"{name}Window"])) for name in ("data", "display")]
    for window in windows:
        if not all(0 < side <= _LARGEST_SIDE for side in window.shape()):
            raise DataError(f"{path}: expected sides of 1 to {_LARGEST_SIDE} pixels, found the window {window}")
    if "tiles" in part or flags & _TILED or kind == "tiledimage":
        across, down = struct.unpack_from("<2I", part["tiles"])
        if not 0 < across * down <= max(_LARGEST_TILE, math.prod(windows[0].shape())):
            raise DataError(f"{path}: expected tiles of at most {_LARGEST_TILE} pixels, found {across} x {down}")
    if "whiteLuminance" in part:
        message = "torchbrdf: %s: whiteLuminance, %g cd/m2 for 1, is not applied; values stay as they are"
        logging.getLogger("torchbrdf").warning(message, path, *struct.unpack("<f", part["whiteLuminance"]))
    neutral = struct.unpack("<2f", part["adoptedNeutral"]) if "adoptedNeutral" in part else None
    return Header(tuple(_channels(part["channels"])), windows[0], windows[1], _primaries(path, part), neutral)


def _channels(data: bytes) -> list[Channel]:
    found: list[Channel] = []
    at = 0
    while True:
        name, at = _text(data, at)
        if not name:
            return found
        kind, across, down = struct.unpack_from("<i4x2i", data, at)
        at += 16
        if not 0 <= kind < len(_KINDS) or across < 1 or down < 1:
            raise ValueError(f"channel {shown(name)} of kind {kind} and sampling {across}, {down}")
        found.append(Channel(name, *_KINDS[kind], (across, down)))


def _texts(data: bytes) -> list[str]:
    """A list of texts, each behind its length."""
    found, at = [], 0
    while at < len(data):
        size = struct.unpack_from("<i", data, at)[0]
        if not 0 <= size <= len(data):
            raise ValueError(f"a text of {size} bytes")
        found.append(data[at + 4 : at + 4 + size].decode("utf-8", "replace"))
        at += 4 + size
    return found


def _primaries(path: Path, part: Attributes) -> tuple[float, ...]:
    """Those of `chromaticities`, of `colorInteropID`, or of the ACES container; without any, of ITU-R BT.709."""
    named = None
    if "colorInteropID" in part:
        space = part["colorInteropID"].decode("utf-8", "replace")
        if space not in ("", "unknown", *_COLOR_SPACES):
            known = ", ".join(_COLOR_SPACES)
            raise DataError(f"{path}: expected linear colours (colorInteropID {known}), found {shown(space)}")
        named = _COLOR_SPACES.get(space)
    elif part.get("acesImageContainerFlag") == b"\1\0\0\0":
        named = AP0
    if "chromaticities" not in part:
        return named or REC709
    given = struct.unpack("<8f", part["chromaticities"])
    if named and max(abs(a - b) for a, b in zip(given, named, strict=True)) > 1e-3:
        raise DataError(f"{path}: expected one colour space, found chromaticities of another than colorInteropID names")
    return given
