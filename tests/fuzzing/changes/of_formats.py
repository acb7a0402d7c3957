"""Changes of what particular formats say: tables of MERL's, pictures, meshes, a study's database."""

import json
import sqlite3
import struct
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import numpy as np

from fuzzing.changes import Change
from fuzzing.changes.byte import NUMBERS, WORDS, encoded
from fuzzing.changes.of_json import JSON

_MERL_HEADERS = (
    struct.pack("<3i", 90, 90, 360),
    struct.pack("<3i", 180, 90, 90),
    struct.pack(">3i", 90, 90, 180),
    struct.pack("<3i", -90, 90, 180),
    struct.pack("<3i", 2**31 - 1, 2**31 - 1, 2**31 - 1),
    bytes(12),
)


def merl(source: Random, data: bytes) -> bytes:
    """A MERL table with another header, another length, or runs of other entries."""
    kind = source.randrange(6)
    if kind == 0:
        return source.choice(_MERL_HEADERS) + data[12:]
    if kind == 1:
        return data[: source.choice((0, 11, 12, 13, len(data) // 2, len(data) - 1, len(data) - 8))]
    if kind == 2:
        return data + bytes(source.choice((1, 8, 4096)))
    if kind == 3:  # as another kind of machine writes it
        return data[:12] + np.frombuffer(data, "<f8", offset=12).byteswap().tobytes()
    entries = np.frombuffer(data, "<f8", offset=12).copy()
    start = source.choice((0, source.randrange(len(entries))))
    length = source.choice((1, 1000, 500_000, len(entries)))
    entries[start : start + length] = source.choice((np.nan, np.inf, -np.inf, -1, 0, 1e300, -1e-300, 5e-324, 1e30))
    return data[:12] + entries.tobytes()


def exr(source: Random, data: bytes) -> bytes:
    """An attribute of an EXR file: a window elsewhere or huge, or of another name or type."""
    windows = [place for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0") if (place := _after(data, name))]
    if not windows:
        raise ValueError("no window")
    found = bytearray(data)
    kind = source.randrange(4)
    if kind < 2:
        sides = (-(2**31), 2**31 - 1, -1, 0, 1, 7, 15, 16, 31, 32, 63, 100_000, 16_383, 30_000, 2**24)
        place = source.choice(windows) + 4
        for corner in source.sample(range(4), source.choice((1, 2, 4))):
            struct.pack_into("<i", found, place + 4 * corner, source.choice(sides))
    elif kind == 2:
        names = [name for name in (b"compression", b"lineOrder", b"pixelAspectRatio", b"channels") if name in data]
        place = data.index(source.choice(names)) + source.randrange(40)
        found[place : place + 1] = source.randbytes(1)
    else:
        new = b"chromaticities\0chromaticities\0" + struct.pack(
            "<I8f", 32, *(source.choice((0.3, 0, -1, 1e30)) for _ in "8" * 8)
        )
        place = data.index(b"compression\0")
        found[place:place] = new
    return bytes(found)


def _after(data: bytes, name: bytes) -> int:
    place = data.find(name)
    return 0 if place < 0 else place + len(name)


def hdr(source: Random, data: bytes) -> bytes:
    """A line of a Radiance header that is new or odd, or a resolution that says something else."""
    head, blank, rest = data.partition(b"\n\n")
    size, end, pixels = rest.partition(b"\n")
    if not blank or not end:
        raise ValueError("no header")
    numbers = [encoded(text) for text in NUMBERS]
    kind = source.randrange(3)
    if kind == 0:
        more = (
            b"EXPOSURE=%b",
            b"COLORCORR=%b 1 1",
            b"PRIMARIES=%b 0.3 0.3 0.6 0.1 0.1 0.3 0.3",
            b"PIXASPECT=%b",
            b"GAMMA=%b",
        )
        head += b"\n" + source.choice(more) % source.choice(numbers)
    elif kind == 1:
        side = source.choice((*numbers, b"4", b"32768", b"30000"))
        size = (
            source.choice((b"+Y 16 +X %b", b"-Y %b +X 32", b"+X %b -Y 16", b"-Y 16 +X %b", b"-Y 16 -X %b", b"%b"))
            % side
        )
    else:
        head = source.choice(
            (b"#?RGBE", b"#?RADIANCE\nFORMAT=32-bit_rle_xyze", b"#?", b"#?RADIANCE\nFORMAT=8", head.lower())
        )
    return head + blank + size + end + pixels


OBJ_LINES = (
    "f 1 2", "f 1", "f", "f 0 1 2", "f -1 -2 -3", "f 1/1 2/2 3/3", "f 1//1 2//2 3//3", "f 1/1/1 2/2/2 3/3/3",
    "f 1 2 3 4 5",
    "f 1 1 1", "f 999999 1 2", "f 1.5 2 3", "f a b c", "v 1 2", "v", "v nan 0 0", "v 1e308 1e308 1e308",
    "v 0 0 0 0 0 0 0",
    "v 1 2 3 0.5 0.5 0.5", "vn 0 0 0", "vn nan 1 0", "vn 1", "vt 0", "vt 1 2 3 4", "usemtl red", "usemtl", "g a b",
    "o x",
    "mtllib ../../../etc/passwd", "mtllib none.mtl", "s off", "l 1 2", "p 1", "call x", "\\", "f 1 2 \\", "#",
    "curv 1 2",
)  # fmt: skip


def obj(source: Random, data: bytes) -> bytes:
    """A line of an OBJ file that is new, in some place."""
    lines = data.split(b"\n")
    for _ in range(source.choice((1, 1, 3))):
        lines.insert(source.randrange(len(lines) + 1), encoded(source.choice(OBJ_LINES)))
    return b"\n".join(lines)


def glb(source: Random, data: bytes) -> bytes:
    """The JSON within a GLB says something else; its lengths are right."""
    if data[:4] != b"glTF" or len(data) < 20:
        raise ValueError("no GLB")
    (size,) = struct.unpack_from("<I", data, 12)
    new = source.choice(JSON)(source, data[20 : 20 + size].rstrip(b" \0"))
    new += b" " * (-len(new) % 4)
    rest = data[20 + size :]
    return data[:8] + struct.pack("<II", 20 + len(new) + len(rest), len(new)) + data[16:20] + new + rest


def bundled_values(source: Random, data: bytes) -> bytes:
    """Single precision numbers in a binary file, some of which are others."""
    found = bytearray(data)
    start = max(data.find(b"end_header\n") + 11, 84 if len(data) > 84 else 0)
    if start + 4 > len(found):
        raise ValueError("no numbers")
    for _ in range(source.choice((1, 3))):
        place = start + 4 * source.randrange((len(found) - start) // 4)
        struct.pack_into("<f", found, place, source.choice((np.nan, np.inf, 0, -1, 1e30, 3e38, 1e-40)))
    return bytes(found)


def database(source: Random, data: bytes) -> bytes:
    """A study's database in which something is missing, called otherwise, or impossible."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.sqlite"
        path.write_bytes(data)
        db = sqlite3.connect(path, isolation_level=None)
        try:
            db.execute("PRAGMA foreign_keys = OFF")
            db.execute("PRAGMA journal_mode = DELETE")
            tables = [name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()]
            table = source.choice(tables)
            columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})").fetchall()]
            column = source.choice(columns)
            odd = source.choice((*WORDS[:40], *NUMBERS[:25], None, -1, 10**18, b"\xff\xfe", 1.5, "[1]", "{", "null"))
            if isinstance(odd, str):
                odd = odd.encode("utf-8", "replace").decode()
            kind = source.randrange(8)
            if kind == 0:
                db.execute(f"DROP TABLE {table}")
            elif kind == 1:
                db.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO other")
            elif kind == 2:
                db.execute(f"DELETE FROM {table}")
            elif kind == 3:
                db.execute(f"CREATE TABLE {table}2 (a); DROP TABLE {table}".split(";")[0])
            else:
                db.execute("PRAGMA ignore_check_constraints = ON")
                db.execute(f"UPDATE {table} SET {column} = ?", (odd,))
        except (sqlite3.Error, IndexError) as error:
            raise ValueError("nothing that the database takes") from error
        finally:
            db.close()
        return path.read_bytes()


def settings(source: Random, data: bytes) -> bytes:
    """One setting of one recipe, which is another."""
    recipe, found = source.choice(json.loads(data))
    key = source.choice(list(found))
    new = source.choice((*NUMBERS, *NUMBERS, *WORDS, "1,2", ",", "none", "rms,rms", "ward", "1,2,3", "2,999999999"))
    odd = source.random() < 0.05
    return encoded(json.dumps([[recipe, {new if odd else key: "1" if odd else new}]]))


MESHES: dict[str, tuple[Change, ...]] = {
    "obj": (obj, obj, obj),
    "ply": (bundled_values,),
    "stl": (bundled_values,),
    "glb": (glb, glb, glb, bundled_values),
    "off": (),
}
