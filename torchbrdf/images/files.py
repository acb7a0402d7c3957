"""Pictures in files: OpenEXR and Radiance in, OpenEXR and PNG out."""

import io
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from torchbrdf.errors import DataError, ShapeError, shown
from torchbrdf.files import write_bytes
from torchbrdf.images.exr import exr_bytes, read_exr
from torchbrdf.images.radiance import read_radiance
from torchbrdf.images.tone_mapping import to_bytes
from torchbrdf.reading import read_bytes

_EXPECTED = "an OpenEXR or a Radiance picture"
# Of PNG: at Pillow's own level, 6, a rendered picture takes twice as long, and a twentieth less room.
_COMPRESSION = 4


def read_image(path: str | Path) -> Tensor:
    """Read a linear picture from an OpenEXR or a Radiance file, as red, green and blue of ITU-R BT.709.

    What a header says of the pixels is followed, or refused by its name.

    OpenEXR: one part of channels R, G, B; X, Y, Z; Y, RY, BY; or Y, made grey, half or float. The picture is the
    display window, black where nothing is stored. Colours are converted by `chromaticities` or `colorInteropID`; a
    white other than D65, or `adoptedNeutral`, is adapted to it (Bradford). Colours count as multiplied by alpha
    already. Refused: several parts or views, deep pixels, pixels that are not square, cubes (`envmap`), other colour
    spaces than linear ones. `whiteLuminance` changes nothing, and the log says so.

    Radiance: RGBE or XYZE, in all eight orientations, flat, with repeated pixels, or run-length encoded, divided by
    EXPOSURE and COLORCORR and converted by PRIMARIES; without them they are taken for those of BT.709. A mantissa m
    stands for m 2^(e - 136). XYZ are tristimulus values, of which D65 is white. Refused: GAMMA and PIXASPECT other
    than 1.

    Args:
        path: The file; its content says which it is.

    Returns:
        Linear values, `(H, W, 3)`, float32, top row first; OpenEXR may hold infinite values and NaN.

    Raises:
        DataError: The file is anything else, damaged, or would be larger in memory than 1 GiB or the variable
            TORCHBRDF_MAX_BYTES says.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_exr(f"{folder}/white.exr", torch.ones(2, 3, 3))
        ...     read_image(f"{folder}/white.exr").shape
        torch.Size([2, 3, 3])
    """
    path = Path(path)
    data = read_bytes(path, _EXPECTED)
    if data[:4] == b"v/1\x01":
        return torch.from_numpy(read_exr(path, data))
    if data[:2] == b"#?":
        return torch.from_numpy(read_radiance(path, data))
    raise DataError(f"{path}: expected {_EXPECTED}, found a file that starts with {shown(data[:8])}")


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
    # In memory first: the library has its own exceptions for a full disk.
    write_bytes(path, exr_bytes(np.ascontiguousarray(_picture(image).to(precision).numpy())))


def write_png(path: str | Path, image: Tensor) -> None:
    """Write display values as an 8-bit PNG.

    Args:
        path: The file, which appears when it is complete.
        image: Display values, `(H, W, 3)`, as `to_bytes` takes them: clamped to [0, 1], NaN is magenta.

    Raises:
        ShapeError: The picture has another shape.
        DataError: The file cannot be written.
    """
    data = io.BytesIO()
    Image.fromarray(to_bytes(_picture(image))).save(data, format="PNG", compress_level=_COMPRESSION)
    write_bytes(path, data.getvalue())


def _picture(image: Tensor) -> Tensor:
    if image.dim() != 3 or image.shape[-1] != 3 or 0 in image.shape:
        raise ShapeError(f"picture: expected (H, W, 3), found {(*image.shape,)}")
    return image.detach().cpu()
