"""Pictures in files: OpenEXR and Radiance in, OpenEXR and PNG out."""

import re
from pathlib import Path

import numpy as np
import OpenEXR
import torch
from PIL import Image
from torch import Tensor

from torchbrdf.errors import DataError, ShapeError
from torchbrdf.files import replacing

# No picture needs more; a header that says more is damaged, and believing it would fill the memory.
LARGEST_SIDE = 32768
LARGEST_AREA = 2**27

_RESOLUTION = re.compile(rb"([-+][XY]) (\d{1,9}) ([-+][XY]) (\d{1,9})")


def read_image(path: str | Path) -> Tensor:
    """Read a linear picture from an OpenEXR or a Radiance file.

    OpenEXR: channels R, G, B or Y alone (made grey), half or float. Radiance: RGBE, flat or run-length encoded,
    divided by its EXPOSURE; a mantissa m stands for m 2^(e - 136).

    Args:
        path: The file; its content says which it is.

    Returns:
        Linear values, `(H, W, 3)`, float32, top row first.

    Raises:
        DataError: The file is anything else, damaged, or too large.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_exr(f"{folder}/white.exr", torch.ones(2, 3, 3))
        ...     read_image(f"{folder}/white.exr").shape
        torch.Size([2, 3, 3])
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(8)
            data = head + file.read() if head[:2] == b"#?" else head
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    if head[:4] == b"v/1\x01":
        return _read_exr(path)
    if head[:2] == b"#?":
        return torch.from_numpy(_read_radiance(path, data))
    raise DataError(f"{path}: expected an OpenEXR or a Radiance picture, found a file that starts with {head!r}")


def write_exr(path: str | Path, image: Tensor) -> None:
    """Write a linear picture as OpenEXR.

    Args:
        path: The file, which appears when it is complete.
        image: Linear, `(H, W, 3)`; 16 bits a value if it is float16, else 32.

    Raises:
        ShapeError: The picture has another shape.
        DataError: The file cannot be written.
    """
    precision = torch.float16 if image.dtype == torch.float16 else torch.float32
    pixels = np.ascontiguousarray(_picture(image).to(precision).numpy())
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with replacing(path) as temporary:
        OpenEXR.File(header, {"RGB": pixels}).write(str(temporary))


def write_png(path: str | Path, image: Tensor) -> None:
    """Write display values as an 8-bit PNG.

    Args:
        path: The file, which appears when it is complete.
        image: Display values, `(H, W, 3)`, clamped to [0, 1].

    Raises:
        ShapeError: The picture has another shape.
        DataError: The file cannot be written.
    """
    pixels = (_picture(image).to(torch.float32).clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    with replacing(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG")


def _picture(image: Tensor) -> Tensor:
    if image.dim() != 3 or image.shape[-1] != 3 or 0 in image.shape:
        raise ShapeError(f"picture: expected (H, W, 3), found {(*image.shape,)}")
    return image.detach().cpu()


def _check_size(path: Path, width: int, height: int) -> None:
    if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE and width * height <= LARGEST_AREA):
        raise DataError(f"{path}: a size of {width} x {height} pixels; expected at least 1 and at most 2^27 in all")


def _read_exr(path: Path) -> Tensor:
    try:
        with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
            (left, top), (right, bottom) = file.header()["dataWindow"]
        _check_size(path, int(right) - int(left) + 1, int(bottom) - int(top) + 1)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except DataError:
        raise
    except Exception as error:  # the library raises bare RuntimeErrors and worse for what it cannot read
        reason = " ".join(str(error).split())
        raise DataError(f"{path}: no whole OpenEXR picture: {reason}") from None
    names = ("Y", "Y", "Y") if "Y" in channels and "R" not in channels else ("R", "G", "B")
    missing = [name for name in names if name not in channels]
    if missing:
        raise DataError(f"{path}: expected channels R, G and B, or Y; found {', '.join(sorted(channels))}")
    planes = [np.asarray(channels[name]) for name in names]
    if any(plane.dtype.kind != "f" or plane.shape != planes[0].shape for plane in planes):
        found = ", ".join(f"{plane.dtype} {plane.shape}" for plane in planes)
        raise DataError(f"{path}: expected half or float channels of one size, found {found}")
    return torch.from_numpy(np.stack(planes, -1).astype(np.float32))


def _read_radiance(path: Path, data: bytes) -> np.ndarray:
    end = data.find(b"\n\n", 0, 65536)
    line_end = data.find(b"\n", end + 2, end + 256)
    if end < 0 or line_end < 0:
        raise DataError(f"{path}: a Radiance header without an end")
    exposure = 1.0
    for line in data[:end].split(b"\n"):
        key, _, value = line.partition(b"=")
        if key == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            raise DataError(f"{path}: expected FORMAT=32-bit_rle_rgbe, found {value.strip()[:32]!r}")
        if key == b"EXPOSURE":
            exposure *= _exposure(path, value)
    resolution = data[end + 2 : line_end]
    match = _RESOLUTION.fullmatch(resolution)
    if match is None or (match[1], match[3]) != (b"-Y", b"+X"):
        raise DataError(f"{path}: expected a resolution like '-Y 512 +X 1024', found {resolution[:48]!r}")
    height, width = int(match[2]), int(match[4])
    _check_size(path, width, height)
    rgbe = _scanlines(path, data, line_end + 1, width, height)
    scale = np.ldexp(np.float32(1 / exposure), rgbe[..., 3].astype(np.int32) - 136)
    return rgbe[..., :3] * np.where(rgbe[..., 3:] > 0, scale[..., None], np.float32(0))


def _exposure(path: Path, text: bytes) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1e-12 < value < 1e12:
        raise DataError(f"{path}: expected a positive EXPOSURE, found {text.strip()[:32]!r}")
    return value


def _scanlines(path: Path, data: bytes, start: int, width: int, height: int) -> np.ndarray:
    """The bytes of all pixels, `(H, W, 4)`. Nothing is allocated that the length of the file does not vouch for."""
    marker = bytes((2, 2, width >> 8, width & 255))
    if not (8 <= width < 32768 and data[start : start + 4] == marker):
        if len(data) - start != 4 * width * height:
            found = f"found {len(data) - start} for {width} x {height} pixels"
            raise DataError(f"{path}: expected 4 bytes a pixel or new-style run lengths, {found}")
        return np.frombuffer(data, np.uint8, offset=start).reshape(height, width, 4)
    rows = bytearray()
    for row in range(height):
        if data[start : start + 4] != marker:
            raise DataError(f"{path}: row {row} of {height}: expected the start of a row at byte {start}")
        start = _decode(path, data, start + 4, 4 * width, rows, row)
    if start != len(data):
        raise DataError(f"{path}: {len(data) - start} bytes left over behind the last row")
    return np.frombuffer(rows, np.uint8).reshape(height, 4, width).transpose(0, 2, 1)


def _decode(path: Path, data: bytes, start: int, size: int, rows: bytearray, row: int) -> int:
    """Append the `size` bytes of one row to `rows`; gives where the next row starts. A channel ends with a run."""
    width = size // 4
    for channel in range(4):
        full = (row * 4 + channel + 1) * width
        while len(rows) < full and start + 1 < len(data):
            count = data[start]
            if count > 128:
                count -= 128
                rows += data[start + 1 : start + 2] * count
                start += 2
            else:
                rows += data[start + 1 : start + 1 + count]
                start += 1 + count
            if count == 0:
                break
        if len(rows) != full:
            raise DataError(
                f"{path}: row {row}, channel {channel}: run lengths do not add up to {width} at byte {start}"
            )
    return start
