"""A photometric stack as people have it: a picture for each light, and a table of lights."""

import csv
import io
import logging
import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.images import read_image
from torchbrdf.progress import Progress, quiet
from torchbrdf.reading import read_text

log = logging.getLogger("torchbrdf")

COLUMNS = ("file", "x", "y", "z")
COLOR = ("r", "g", "b")
LEAST = 1e-12
"""Of a length or an irradiance: fits are in single precision, which has no squares of much smaller numbers."""
# Characters of a table: more than anybody has lights.
LARGEST = 1 << 24
_EXPECTED = "a table of lights"


@dataclass(frozen=True)
class Light:
    """A line of a table of lights.

    Args:
        file: The picture under it.
        direction: To it.
        irradiance: Of a surface that faces it, red, green, blue.
    """

    file: Path
    direction: tuple[float, float, float]
    irradiance: tuple[float, float, float]


def read_lights(path: Path | str) -> list[Light]:
    r"""Read a table of lights: CSV with the columns file, x, y, z; and irradiance, or r, g, b, if they are not 1.

    Args:
        path: The table; pictures that are no absolute paths lie beside it.

    Returns:
        A light a line.

    Raises:
        DataError: It is none, says where.

    Example:
        >>> import tempfile
        >>> from torchbrdf.texels.pictures import read_lights
        >>> with tempfile.NamedTemporaryFile("w", suffix=".csv") as file:
        ...     _ = file.write("file,x,y,z\n0.exr,0,0,1\n")
        ...     file.flush()
        ...     read_lights(file.name)[0].direction
        (0.0, 0.0, 1.0)
    """
    path = Path(path)
    text = read_text(path, _EXPECTED)
    if len(text) > LARGEST:
        raise DataError(f"{path}: expected {_EXPECTED} of at most {LARGEST} characters, found {len(text)}")
    try:
        reader = csv.DictReader(io.StringIO(text), strict=True, skipinitialspace=True)
        heads, rows = list(reader.fieldnames or ()), list(reader)
    except csv.Error as error:
        raise DataError(f"{path}: expected {_EXPECTED}, found {error}") from None
    if not set(COLUMNS) <= set(heads):
        raise DataError(f"{path}: expected columns {', '.join(COLUMNS)}, found {shown(heads)}")
    if not rows:
        raise DataError(f"{path}: expected a light a line, found none")
    own = COLOR if set(COLOR) <= set(heads) else ("irradiance",) * 3 if "irradiance" in heads else None
    found = []
    for number, row in enumerate(rows, 2):
        where = f"{path}: line {number}"
        if not row["file"] or "\0" in row["file"]:
            raise DataError(f"{where}: expected the name of a picture, found {shown(row['file'])}")
        x, y, z = (_number(where, name, row[name]) for name in COLUMNS[1:])
        red, green, blue = (1.0, 1.0, 1.0) if own is None else [_number(where, name, row[name]) for name in own]
        if min(red, green, blue) < LEAST or max(red, green, blue) > 1 / LEAST:
            expected = f"expected an irradiance from {LEAST:g} to {1 / LEAST:g}"
            raise DataError(f"{where}: {expected}, found {red:g} {green:g} {blue:g}")
        if not LEAST <= math.hypot(x, y, z) <= 1 / LEAST:
            raise DataError(f"{where}: expected the direction to a light, found {x:g} {y:g} {z:g}")
        found.append(Light(path.parent / row["file"], (x, y, z), (red, green, blue)))
    return found


def _number(where: str, name: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DataError(f"{where}: {name}: expected a finite number, found {shown(text, 40)}")
    return value


@contextmanager
def stacked(
    lights: Sequence[Light], folder: Path, progress: Progress = quiet
) -> Iterator[tuple[np.ndarray, list[str]]]:
    """The pictures of some lights as one memory-mapped array, in a nameless file that goes when the block ends.

    One picture at a time is held. One that cannot be read, or has another size than the first that can, is said and
    left out: it is NaN, which no fit counts.

    Args:
        lights: Whose.
        folder: Where there is room for all of them, 12 bytes a texel and light.
        progress: Called with the number of pictures read.

    Returns:
        `(n, H, W, 3)`, float32; and what was left out, a line each.

    Raises:
        DataError: None can be read, or there is no room.
    """
    with tempfile.TemporaryFile(dir=folder) as file:
        stack: np.ndarray | None = None
        problems: list[str] = []
        left: list[int] = []
        for k, light in enumerate(lights):
            try:
                picture = read_image(light.file).numpy()
                if stack is not None and picture.shape != stack.shape[1:]:
                    h, w = stack.shape[1:3]
                    found = f"{picture.shape[1]} x {picture.shape[0]}"
                    raise DataError(f"{light.file}: expected {w} x {h} pixels, as of the first, found {found}")
            except DataError as error:
                log.warning("torchbrdf: left out: %s", error)
                problems.append(str(error))
                left.append(k)
                continue
            if stack is None:
                stack = _room(file, (len(lights), *picture.shape), folder)
            stack[k] = picture
            progress(k + 1, len(lights))
        if stack is None:
            raise DataError(f"{problems[0]}; no picture of {len(lights)} could be read")
        for k in left:
            stack[k] = np.nan
        yield stack, problems


def _room(file: io.BufferedRandom, shape: tuple[int, ...], folder: Path) -> np.ndarray:
    """A memory-mapped array in a file, whose room is there: writing into a map on a full disk ends a process."""
    size = 4 * math.prod(shape)
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
        found: np.ndarray = np.memmap(file, np.float32, "r+", shape=shape)
    except OSError as error:
        raise DataError(
            f"{folder}: expected room for {size / 1e9:.1f} GB of pictures, found {error.strerror}"
        ) from None
    return found
