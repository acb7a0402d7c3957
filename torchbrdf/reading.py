"""Reading files that may hold anything: whatever is wrong with one becomes a DataError that names it."""

import hashlib
import io
import json
import math
import os
import stat
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from torchbrdf.errors import DataError, TorchbrdfError, UsageError, shown
from torchbrdf.files import replacing

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")

# Bytes that one file may hold, or may become in memory; the variable of the environment raises it.
LARGEST = 2**30
LIMIT_VARIABLE = "TORCHBRDF_MAX_BYTES"
CHECKSUM = "sha256"


def largest() -> int:
    """How many bytes one file may become in memory: 1 GiB, or TORCHBRDF_MAX_BYTES.

    Raises:
        UsageError: That variable is no whole number above 0.
    """
    given = os.environ.get(LIMIT_VARIABLE)
    if given is None:
        return LARGEST
    if not (given.isascii() and given.isdecimal() and len(given) < 19 and int(given)):
        raise UsageError(f"{LIMIT_VARIABLE}: expected a number of bytes, found {shown(given)}")
    return int(given)


def check_unpacked(path: Path | str, size: int) -> None:
    """Refuse a file before it is unpacked, by what its header says.

    Args:
        path: The file.
        size: Bytes that it would become in memory.

    Raises:
        DataError: They are more than `largest()`.
    """
    if size > largest():
        raise DataError(
            f"{path}: expected at most {largest()} bytes unpacked, found {size}; {LIMIT_VARIABLE} raises the limit"
        )


@contextmanager
def reading(path: Path | str, expected: str) -> Iterator[None]:
    """Turn whatever is raised while a file is read into one line that names it.

    For readers that are not ours: libraries raise whatever comes up in a damaged file.

    Args:
        path: The file.
        expected: What it should hold, as in "expected {expected}, found ...".

    Raises:
        DataError: For everything that is raised within and is no error of torchbrdf's already.

    Example:
        >>> from torchbrdf.reading import reading
        >>> with reading("x.json", "a number"):
        ...     float("seven")
        Traceback (most recent call last):
        torchbrdf.errors.DataError: x.json: expected a number, found could not convert string to float: 'seven'
    """
    try:
        yield
    except TorchbrdfError:
        raise
    except OSError as error:
        raise DataError(f"{path}: expected {expected}, found {error.strerror or error}") from None
    except Exception as error:  # see above
        reason = str(error) if str(error) and not isinstance(error, KeyError) else f"{type(error).__name__}: {error}"
        raise DataError(f"{path}: expected {expected}, found {reason}") from error


def exists(path: Path | str) -> bool:
    """Whether something is there; nothing is at a path that no file can have, such as one with a NUL.

    Example:
        >>> from torchbrdf.reading import exists
        >>> exists(".")
        True
    """
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def read_bytes(path: Path | str, expected: str) -> bytes:
    """All bytes of a regular file.

    A FIFO or a device would be waited for, and has no end.

    Args:
        path: The file.
        expected: What it should hold.

    Raises:
        DataError: It is not there, no regular file, cannot be read, or is larger than `largest()`.
    """
    path = Path(path)
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise DataError(f"{path}: expected {expected}, found no regular file")
            check_unpacked(path, status.st_size)
            return file.read()
    except TorchbrdfError:
        raise
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise DataError(f"{path}: expected {expected}, found {reason}") from None
    except ValueError:  # a NUL in the path
        raise DataError(f"{path}: expected {expected}, found no such file") from None


def _open_at_once(path: str, flags: int) -> int:
    """An opener that does not wait for somebody to write into a FIFO."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_text(path: Path | str, expected: str) -> str:
    """All of a UTF-8 text file, without a byte order mark.

    Raises:
        DataError: As `read_bytes`, or it is no UTF-8.
    """
    data = read_bytes(path, expected)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: expected {expected} in UTF-8, found byte {error.start} that is none") from None


def read_json(path: Path | str, kind: type[T] | Any, expected: str) -> T:
    """A value of some type from a JSON file.

    Strict: no NaN, no true for 1, no text for a number; an object's unknown keys are passed over where `kind` is a
    dataclass or a `msgspec.Struct`.

    Args:
        path: The file.
        kind: The type: of builtins, dataclasses, `msgspec.Struct`, and containers and unions of them.
        expected: What it should hold.

    Raises:
        DataError: As `read_bytes`, or it is no JSON of that type; says where.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from torchbrdf.reading import read_json
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "numbers.json"
        ...     _ = path.write_text("[1, 2.5]")
        ...     read_json(path, list[float], "numbers")
        [1.0, 2.5]
    """
    import msgspec  # late: not everything reads JSON

    data = read_bytes(path, expected)
    try:
        return msgspec.json.decode(data.removeprefix(b"\xef\xbb\xbf"), type=kind)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        reason = "JSON that is nested too deep" if isinstance(error, RecursionError) else _reason(error, data)
        raise DataError(f"{path}: expected {expected}, found {reason}") from None


def _reason(error: Exception, data: bytes) -> str:
    """msgspec's message, such as "Expected `str`, got `null` - at `$[0].material`", as a part of ours."""
    text = str(error)
    if ("malformed" in text or "out of range" in text) and (place := _first_not_finite(data)):
        return place
    return text if text.startswith("JSON") else text[:1].lower() + text[1:]


def _first_not_finite(data: bytes) -> str:
    """Where a file has NaN or a number beyond all floats, which other programs write; "" if nowhere."""
    try:
        pending = [("$", json.loads(data))]
    except (ValueError, RecursionError):  # not even that
        return ""
    while pending:
        place, value = pending.pop()
        if isinstance(value, dict):
            pending += [(f"{place}.{key[:40]}", item) for key, item in reversed(value.items())]
        elif isinstance(value, list):
            pending += [(f"{place}[{k}]", value[k]) for k in range(len(value) - 1, -1, -1)]
        elif isinstance(value, int | float) and not abs(value) <= sys.float_info.max:
            return f"{shown(value, 30)} at `{place}`, where a finite number has to be"
    return ""


def write_npz(path: Path | str, arrays: Mapping[str, "np.ndarray"], *, compressed: bool = False) -> None:
    """Write arrays as `.npz` with a checksum of them all, whole or not at all; `read_npz` holds them against it.

    Args:
        path: The file.
        arrays: By name.
        compressed: Whether to spend time for a smaller file.
    """
    import numpy as np

    found = {**arrays, CHECKSUM: np.frombuffer(_digest(arrays), np.uint8)}
    with replacing(path) as temporary, temporary.open("wb") as file:
        (np.savez_compressed if compressed else np.savez)(file, allow_pickle=False, **found)


def read_npz(path: Path | str, expected: str, layout: Mapping[str, tuple[tuple[int | None, ...], str]] | None = None,
             *, checksum: bool = True) -> dict[str, "np.ndarray"]:  # fmt: skip
    """The arrays of an `.npz`.

    Args:
        path: The file.
        expected: What it should hold.
        layout: Shape (None: any size) and kind ("f", "i", "u", "b" or "U", as of `numpy.dtype.kind`) of each array
            that is needed; numbers of kind "f" must be finite.
        checksum: Whether `write_npz` wrote it, whose checksum is held against the arrays.

    Raises:
        DataError: It cannot be read, would unpack to more than `largest()`, is damaged, or lacks an array or has one
            of another shape or kind.
    """
    found = npz_arrays(path, read_bytes(path, expected), expected)
    if checksum:
        stored = found.pop(CHECKSUM, None)
        if stored is None or stored.tobytes() != _digest(found):
            raise DataError(f"{path}: expected {expected} as it was written, found one that was changed or damaged")
    for name, (shape, kind) in (layout or {}).items():
        _check_array(path, found, name, shape, kind)
    return found


def npz_arrays(path: Path | str, data: bytes, expected: str) -> dict[str, "np.ndarray"]:
    """The arrays of an `.npz` that was read; without a checksum but those of zip files.

    Args:
        path: The file, for errors.
        data: Its bytes.
        expected: What it should hold.

    Raises:
        DataError: As `read_npz`.
    """
    import numpy as np

    with reading(path, expected), zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        check_unpacked(path, sum(member.file_size for member in members))
        found = {one.filename.removesuffix(".npy"): _array(_member(archive, data, one)) for one in members}
    for name, value in found.items():
        if not isinstance(value, np.ndarray):
            raise DataError(f"{path}: expected {expected}, found {name} that is no array")
    return found


def _member(archive: zipfile.ZipFile, data: bytes, member: zipfile.ZipInfo) -> bytes:
    """The bytes of a member of a zip file; those that are stored as they are without zipfile's streams."""
    at, name = member.header_offset, member.orig_filename.encode()
    start = at + 30 + len(name) + int.from_bytes(data[at + 28 : at + 30], "little")  # behind name and extra fields
    body = data[start : start + member.file_size]
    if (
        (member.compress_type, member.flag_bits & ~0x800) == (zipfile.ZIP_STORED, 0)  # 0x800: the name is UTF-8
        and data[at : at + 4] == b"PK\x03\x04"
        and data[at + 26 : at + 28] == len(name).to_bytes(2, "little")
        and data[at + 30 : at + 30 + len(name)] == name
        and len(body) == member.file_size == member.compress_size
        and zlib.crc32(body) == member.CRC
    ):
        return body
    return archive.read(member)  # which also has the words for what is wrong


def _array(data: bytes) -> Any:
    """An array of the bytes of an `.npy`, or these, if they are none; as numpy reads it, whose reader is slow.

    Its head is a text of Python, which takes longer to parse than a small array to read, and is the same again in
    every other file of a kind.
    """
    import numpy as np

    if not data.startswith(np.lib.format.MAGIC_PREFIX):
        return data
    size = 10 + int.from_bytes(data[8:10], "little")
    shape, by_columns, dtype = _head(data[:size])
    if dtype is None or by_columns or dtype.kind not in "biuf" or min(shape, default=0) < 0:
        return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    return np.frombuffer(data, dtype, math.prod(shape), size).reshape(shape).copy()


@lru_cache(64)
def _head(start: bytes) -> "tuple[tuple[int, ...], bool, np.dtype[Any] | None]":
    """Shape, order and type of an `.npy` of version 1.0, by its head; no type of another version."""
    import numpy as np

    file = io.BytesIO(start)
    if np.lib.format.read_magic(file) != (1, 0):
        return (), False, None
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(file)
    return shape, by_columns, dtype


def _check_array(path: Path | str, found: Mapping[str, "np.ndarray"], name: str, shape: tuple[int | None, ...],
                 kind: str) -> None:  # fmt: skip
    import numpy as np

    wanted = f"{name} of shape ({', '.join('n' if size is None else str(size) for size in shape)}) and kind {kind}"
    if name not in found:
        raise DataError(f"{path}: expected {wanted}, found {', '.join(found) or 'nothing'}")
    value = found[name]
    fits = len(value.shape) == len(shape) and all(
        want in (None, have) for have, want in zip(value.shape, shape, strict=True)
    )
    if not fits or value.dtype.kind != kind:
        raise DataError(f"{path}: expected {wanted}, found shape {value.shape} and kind {value.dtype.kind}")
    if kind == "f" and not np.isfinite(value).all():
        raise DataError(f"{path}: expected {wanted}, found {int((~np.isfinite(value)).sum())} numbers not finite")


def _digest(arrays: Mapping[str, "np.ndarray"]) -> bytes:
    found = hashlib.sha256()
    for name, value in sorted(arrays.items()):
        found.update(repr((name, value.shape, value.dtype.str)).encode())
        found.update(value.tobytes())  # not .data, which dates have none of
    return found.digest()
