"""Changes of files that hold arrays: .npz, .mat and the container of RGL's files."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from helpers.measured_files import read_bsdf, tensor_file

from fuzzing.changes import Change

Arrays = dict[str, np.ndarray]

LARGEST = 1 << 26
"""Bytes of members that are changed once more."""


def _values(source: Random, array: np.ndarray) -> np.ndarray:
    """Some entries, or all, are others."""
    found = np.array(array)
    numbers = (np.nan, np.inf, -np.inf, -1, 0, 1e30, -1e30, 1e300, 1e-300, 2**31, -(2**31), 0.5)
    with np.errstate(all="ignore"):
        new = np.array(source.choice(numbers)).astype(found.dtype)
    if not found.size:
        raise ValueError("no entry")
    if source.random() < 0.3:
        found[...] = new
    else:
        found.reshape(-1)[[source.randrange(found.size) for _ in range(source.choice((1, 1, 5)))]] = new
    return found


def _shape(source: Random, array: np.ndarray) -> np.ndarray:
    """Another shape."""
    found = np.array(array)
    made: tuple[Callable[[], np.ndarray], ...] = (
        lambda: found[:0],
        lambda: found[:-1],
        lambda: found[:1],
        lambda: np.concatenate([found, found]),
        lambda: found[None],
        lambda: found.reshape(-1),
        lambda: found.T,
        lambda: found[..., :1],
        lambda: found.reshape(-1)[0],
        lambda: np.zeros((0, 3)),
        lambda: found[::-1],
    )
    try:
        return np.asarray(source.choice(made)())
    except (IndexError, ValueError) as error:
        raise ValueError("no such shape") from error


def _dtype(source: Random, array: np.ndarray) -> np.ndarray:
    """Another type."""
    kind = source.choice(
        ("f2", "f4", "f8", ">f4", ">f8", "i1", "i4", "i8", "u8", "c16", "?", "U8", "S8", "O", "M8[s]", "V")
    )
    if kind == "O":
        return np.array([{"a": 1}, None], dtype=object)
    if kind == "V":
        return np.zeros(2, [("a", "f4"), ("b", "U3")])
    with np.errstate(all="ignore"):
        return np.asarray(array).astype(kind) if kind != "M8[s]" else np.zeros(np.shape(array), kind)


def changed_arrays(source: Random, arrays: Arrays) -> Arrays:
    """One array is gone, called otherwise, of other values, shape or type; or there is one more."""
    found = dict(arrays)
    if not found:
        raise ValueError("no array")
    name = source.choice(list(found))
    kind = source.randrange(10)
    if found[name].dtype.kind not in "fiub":  # changed before
        kind = 0
    if kind == 0:
        del found[name]
    elif kind == 1:
        found[source.choice(("x", "", "a/b", "../x", "é", "x" * 300, *found))] = found.pop(name)
    elif kind == 2:
        found[source.choice(("more", "999.column", "pairs.more", "curve2"))] = found[name]
    elif kind < 6:
        found[name] = _values(source, found[name])
    elif kind < 8:
        found[name] = _shape(source, found[name])
    else:
        found[name] = _dtype(source, found[name])
    return found


def npz(source: Random, data: bytes) -> bytes:
    """Other arrays, with sums that are right."""
    return npz_of(changed_arrays(source, arrays_of(data)), compressed=source.random() < 0.3)


def members(source: Random, data: bytes) -> bytes:
    """Other bytes within a member, with a sum that is right; or a member that lies about its size."""
    from fuzzing.changes.byte import BYTES

    found = members_of(data)
    name = source.choice(list(found) or _refuse())
    kind = source.randrange(5)
    if kind == 0:
        found[name] = _huge_header(source)
    elif kind == 1:
        found[f"{name}.txt"] = b"no array"
    elif kind == 2:
        return zip_of(found).replace(struct.pack("<I", len(found[name])), struct.pack("<I", 2**32 - 2))
    else:
        found[name] = source.choice(BYTES)(source, found[name][:200]) + found[name][200:]
    return zip_of(found)


def bomb(source: Random, data: bytes) -> bytes:
    """A member that would unpack to 2 GiB of zeros, of an array of that size."""
    name = source.choice(list(members_of(data)) or _refuse())
    return _bomb(name)


NPZ: tuple[Change, ...] = (npz, npz, npz, npz, npz, members, members, bomb)


def arrays_of(data: bytes) -> Arrays:
    """The arrays of an .npz; a ValueError if it is none any more."""
    members_of(data)
    try:
        with np.load(io.BytesIO(data), allow_pickle=True) as found:
            return {name: found[name] for name in found.files if isinstance(found[name], np.ndarray)}
    except Exception as error:  # of a file that was changed before
        raise ValueError("no arrays") from error


def npz_of(arrays: Arrays, *, compressed: bool = False) -> bytes:
    """The bytes of an .npz."""
    return zip_of({f"{name}.npy": _npy(array) for name, array in arrays.items()}, compressed=compressed)


def members_of(data: bytes) -> dict[str, bytes]:
    """The members of a zip file; a ValueError if it is none any more."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as found:
            if sum(member.file_size for member in found.infolist()) > LARGEST:
                raise ValueError("a bomb already")
            return {name: found.read(name) for name in found.namelist()}
    except Exception as error:
        raise ValueError("no zip file") from error


def zip_of(found: dict[str, bytes], *, compressed: bool = False) -> bytes:
    """The bytes of a zip file."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED) as made:
        for name, content in found.items():
            info = zipfile.ZipInfo(name)  # which has one date always
            made.writestr(info, content, made.compression)
    return stream.getvalue()


def _npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=True)
    return stream.getvalue()


def _huge_header(source: Random) -> bytes:
    """An array whose header says more than there is."""
    shape = source.choice(("(100000000000,)", "(-1,)", "(3, 100000, 100000)", "()", "('a',)", "(" * 60, "(1,)*9**9"))
    text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + b"\0" * 100


@cache
def _bomb(name: str, blocks: int = 128, size: int = 16 << 20) -> bytes:
    """A zip file of some kilobytes, whose member is an array of 2 GiB: the same compressed block over and over."""
    text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({blocks * size // 4},), }}".encode()
    head = b"\x93NUMPY\x01\x00" + struct.pack("<H", 118) + text.ljust(117) + b"\n"
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    first = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(size)) + packer.flush(zlib.Z_FULL_FLUSH)
    stream = first + block * blocks + packer.flush(zlib.Z_FINISH)
    total = len(head) + blocks * size
    raw = name.encode()
    local = struct.pack("<4s5H3I2H", b"PK\3\4", 20, 0, 8, 0, 0, 0, len(stream), total, len(raw), 0) + raw
    entry = struct.pack("<4s6H3I5H2I", b"PK\1\2", 20, 20, 0, 8, 0, 0, 0, len(stream), total, len(raw), *(0,) * 6)
    start = len(local) + len(stream)
    end = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, len(entry) + len(raw), start, 0)
    return local + stream + entry + raw + end


def bsdf(source: Random, data: bytes) -> bytes:
    """Other fields of an RGL file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.bsdf"
        path.write_bytes(data)
        try:
            found = changed_arrays(source, read_bsdf(path))
        except Exception as error:  # of a file that was changed before
            raise ValueError("no tensor file") from error
    try:
        return tensor_file({name: np.ascontiguousarray(array) for name, array in found.items()})
    except (KeyError, ValueError, struct.error) as error:
        raise ValueError("nothing that the container can say") from error


def mat(source: Random, data: bytes) -> bytes:
    """Other matrices of a MAT file; not those of `data`, which might crash the library that reads them."""
    from scipy.io import savemat
    from scipy.sparse import csc_matrix

    if not data.startswith(b"MATLAB"):
        raise ValueError("no MAT file")
    names = ("rms", "rms_cos", "rms_cos_cube", "dist_L2_lab", "dist_L4_lab")
    found: dict[str, Any] = {name: 1 - np.eye(4) for name in names}
    if source.random() < 0.3:
        odd = (csc_matrix(np.eye(4)), {"a": 1}, "text", np.array([[1, "a"]], object), [], 1j)
        found[source.choice(names)] = source.choice(odd)
    else:
        found = {key: what for key, what in changed_arrays(source, found).items() if key.isidentifier()}
    stream = io.BytesIO()
    try:
        savemat(stream, found, do_compression=source.random() < 0.5)
    except Exception as error:
        raise ValueError("nothing that a MAT file can say") from error
    return b"MATLAB 5.0 MAT-file".ljust(116) + stream.getvalue()[116:]  # where it says when it was made


def _refuse() -> list[str]:
    raise ValueError("nothing there")
