"""The pictures of a study: found, looked through, and stripped of what they say besides how they look."""

import io
import struct
from pathlib import Path

from torchbrdf.errors import DataError
from torchbrdf.reading import read_bytes, reading
from torchbrdf.study.plan import PLAN, Plan, inside

# The chunks of a PNG that say how it looks; all others, such as texts, could say what it is.
LOOKS = (b"IHDR", b"PLTE", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"sBIT", b"cICP", b"IDAT", b"IEND")
SIGNATURE = b"\x89PNG\r\n\x1a\n"


def find_pictures(plan: Plan, folder: Path) -> dict[tuple[str, str | None], tuple[Path, tuple[int, int]]]:
    """The file and the size of each material's reference, under None, and of its stimuli.

    A DataError if one is missing or damaged, so that no observer finds out.
    """
    found = {}
    sizes: dict[Path, tuple[int, int]] = {}
    for material in plan.materials:
        names = {None: material.reference} | {name: one.picture for name, one in material.stimuli.items()}
        for name, picture in names.items():
            path = inside(folder, picture, folder / PLAN)
            if path not in sizes:
                sizes[path] = checked_size(path)
            found[material.name, name] = (path, sizes[path])
    return found


def checked_size(path: Path) -> tuple[int, int]:
    """Width and height of a PNG whose parts are all there and have their checksums."""
    from PIL import Image  # late: nothing else of a study needs it

    data = read_bytes(path, "a PNG")
    if not data.startswith(SIGNATURE):
        raise DataError(f"{path}: expected a PNG, found something else")
    plain_png(data, path)
    with reading(path, "a whole PNG"):
        Image.open(io.BytesIO(data), formats=["PNG"]).verify()
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def plain_png(data: bytes, path: Path) -> bytes:
    """Strip a PNG of all that is not needed to show it."""
    kept, at = [data[:8]], 8
    while at + 12 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] in LOOKS:
            kept.append(data[at:end])
        at = end
    if not data.startswith(SIGNATURE) or at != len(data) or kept[-1][4:8] != b"IEND":
        raise DataError(f"{path}: expected a whole PNG, found something else")
    return b"".join(kept)
