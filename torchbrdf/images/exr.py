"""OpenEXR pictures: their pixels by the OpenEXR library, and what their headers say of them.

The header is looked at before the library sees the file, which believes what it says of sizes.

Source: https://openexr.com/en/latest/OpenEXRFileLayout.html, https://openexr.com/en/latest/StandardAttributes.html.
"""

import contextlib
import io
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from torchbrdf.errors import DataError, shown
from torchbrdf.images.exr_chunks import check_chunks
from torchbrdf.images.exr_header import Header, Window, read_header
from torchbrdf.images.primaries import XYZ, converted, luminance_weights, to_rec709
from torchbrdf.reading import check_unpacked, reading

# Half of the filter that OpenEXR's own reader of luminance and chroma uses between two samples; its sum is 1 / 2.
_CHROMA_FILTER = (0.627123, -0.186077, 0.087929, -0.043159, 0.019597, -0.007540, 0.002128)


def read_exr(path: Path, data: bytes) -> np.ndarray:
    """The picture in an OpenEXR file, `(H, W, 3)`, float32; see `read_image`."""
    header = read_header(path, data)
    names = _colours(path, header)
    check_unpacked(path, header.unpacked)
    check_chunks(path, data, header)
    planes = _planes(path, data, header)
    with np.errstate(over="ignore", invalid="ignore"):  # a file may hold all that a float can be
        if names == ("Y",):
            picture = np.repeat(planes["Y"][..., None].astype(np.float32), 3, -1)  # grey in all primaries
        else:
            if names == ("Y", "RY", "BY"):
                picture = _from_chroma(path, planes, header.primaries)
            else:
                picture = np.stack([planes[name] for name in names], -1).astype(np.float32)
            primaries = XYZ if names == ("X", "Y", "Z") else header.primaries
            picture = converted(picture, to_rec709(path, primaries, header.neutral))
    return _placed(path, picture, header.data_window, header.display_window)


def exr_bytes(pixels: np.ndarray) -> bytes:
    """An OpenEXR file of pixels `(H, W, 3)`, half or float; with a channel Y of `(H, W, 1)`."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    data = io.BytesIO()
    channels = {"RGB": pixels} if pixels.shape[-1] == 3 else {"Y": np.ascontiguousarray(pixels[..., 0])}
    OpenEXR.File(header, channels).write(data)
    return data.getvalue()


def _colours(path: Path, header: Header) -> tuple[str, ...]:
    """The channels that make the picture."""
    found = {channel.name for channel in header.channels}
    for names in (("R", "G", "B"), ("X", "Y", "Z"), ("Y", "RY", "BY"), ("Y",)):
        if found.issuperset(names) and not (names == ("Y",) and found & {"R", "G", "B", "RY", "BY"}):
            break
    else:
        raise DataError(
            f"{path}: expected channels R, G and B; X, Y and Z; Y, RY and BY; or Y; found {shown(sorted(found))}"
        )
    for channel in header.channels:
        if channel.name in names:
            if channel.kind == "uint":
                raise DataError(f"{path}: expected half or float channels, found whole numbers in {channel.name}")
            across, down = channel.step
            if max(across, down) > (2 if channel.name in ("RY", "BY") else 1):
                raise DataError(f"{path}: expected {channel.name} in every pixel, found one in {across} x {down}")
    return names


def _planes(path: Path, data: bytes, header: Header) -> Mapping[str, np.ndarray]:
    """The pixels of every channel, by its name."""
    with (
        reading(path, "a whole OpenEXR picture"),
        _library_messages() as said,
        OpenEXR.File(io.BytesIO(data), separate_channels=True) as file,
    ):
        found = file.channels() if file.parts else {}
        planes = {name: np.asarray(channel.pixels) for name, channel in found.items()}
    for channel in header.channels:
        shape = header.data_window.shape(channel.step)
        if channel.name not in planes or planes[channel.name].shape != shape:
            raise DataError(f"{path}: expected a whole OpenEXR picture, found {said.reason or 'other sizes'}")
    return planes


_told = threading.Lock()


class _Messages(io.TextIOBase):
    """What this thread prints, kept; the others' goes where it should."""

    def __init__(self, beside: Any) -> None:
        self.thread, self.beside, self.text = threading.get_ident(), beside, ""

    @property
    def reason(self) -> str:
        """Without the sentence that the library puts before it."""
        return self.text.rpartition(" - ")[2]

    def write(self, text: str) -> int:
        if threading.get_ident() != self.thread:
            return self.beside.write(text)
        self.text += text
        return len(text)

    def flush(self) -> None:
        self.beside.flush()


@contextlib.contextmanager
def _library_messages() -> Iterator[_Messages]:
    """What the library says on sys.stdout where it should raise."""
    with _told:
        messages = _Messages(sys.stdout)
        with contextlib.redirect_stdout(messages):
            yield messages


def _from_chroma(path: Path, planes: Mapping[str, np.ndarray], primaries: tuple[float, ...]) -> np.ndarray:
    """RGB of luminance and chroma: RY = (R - Y) / Y, BY = (B - Y) / Y."""
    light = planes["Y"].astype(np.float32)
    red, blue = (light * (1 + _full(planes[name].astype(np.float32), light.shape)) for name in ("RY", "BY"))
    weights = luminance_weights(path, primaries).astype(np.float32)
    if not weights[1] > 1e-3:
        raise DataError(f"{path}: expected chromaticities with a green that has luminance, found {shown(primaries)}")
    green = (light - weights[0] * red - weights[2] * blue) / weights[1]
    return np.stack([red, green, blue], -1)


def _full(plane: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A plane that has a sample for every pixel, or for every second, with one for every pixel."""
    for axis, size in enumerate(shape):
        if plane.shape[axis] != size:
            plane = np.moveaxis(plane, axis, -1)
            fine = np.empty((*plane.shape[:-1], size), np.float32)
            fine[..., ::2] = plane
            reach = len(_CHROMA_FILTER)
            wide = np.pad(plane, ((0, 0), (reach - 1, reach)), mode="edge")
            between = sum(
                weight * (wide[:, reach - 1 - k :][:, : size // 2] + wide[:, reach + k :][:, : size // 2])
                for k, weight in enumerate(_CHROMA_FILTER)
            )
            fine[..., 1::2] = between
            plane = np.moveaxis(fine, -1, axis)
    return plane


def _placed(path: Path, picture: np.ndarray, data: Window, display: Window) -> np.ndarray:
    """The display window: black where nothing is stored, without what is stored outside."""
    if data == display:
        return picture
    left, top = max(data.left, display.left), max(data.top, display.top)
    right, bottom = min(data.right, display.right), min(data.bottom, display.bottom)
    if left > right or top > bottom:
        raise DataError(f"{path}: expected pixels in the display window {display}, found them in {data}")
    placed = np.zeros((*display.shape(), 3), np.float32)
    inside = picture[top - data.top : bottom + 1 - data.top, left - data.left : right + 1 - data.left]
    placed[top - display.top : bottom + 1 - display.top, left - display.left : right + 1 - display.left] = inside
    return placed
