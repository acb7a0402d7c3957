r"""Files of `tensor_file` version 1, the container of the RGL database: named arrays behind a table of contents.

    magic  "tensor_file\\0"      12 bytes
    version 1, 0                 2 bytes
    number of fields             uint32
    for each field: length of its name uint16, the name, number of dimensions uint16, type uint8, offset uint64,
                    size of each dimension uint64

Source: W. Jakob and J. Dupuy, https://github.com/rgl-epfl/brdf-loader. All numbers are little-endian.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.files import replacing
from torchbrdf.reading import check_unpacked, read_bytes

MAGIC = b"tensor_file\0"
TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "u8", 8: "i8", 9: "f2", 10: "f4", 11: "f8"}

# What a file begins with, and what follows the name of a field.
_START, _PLACE = struct.Struct("<12sBBI"), struct.Struct("<HBQ")


class Field(NamedTuple):
    """Field of a tensor file: where an array lies, and of what type it is."""

    dtype: np.dtype
    offset: int
    shape: tuple[int, ...]


def _size(field: Field) -> int:
    """Bytes of a field."""
    return math.prod(field.shape) * field.dtype.itemsize


class TensorFile:
    """Tensor file of RGL: `fields` says what there is, `array` copies one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._bytes = read_bytes(path, "a tensor_file")
        try:
            self.fields = dict(self._contents())
        except struct.error:
            size = len(self._bytes)
            raise DataError(f"{path}: truncated: the file ends inside its table of contents, at {size} bytes") from None

    def _contents(self) -> list[tuple[str, Field]]:
        where, end = 0, len(self._bytes)

        def take(layout: str) -> tuple:
            nonlocal where
            found = struct.unpack_from(f"<{layout}", self._bytes, where)
            where += struct.calcsize(f"<{layout}")
            return found

        magic, major, minor, count = take("12sBBI")
        if magic != MAGIC or (major, minor) != (1, 0):
            found = f"{magic!r} version {major}.{minor}"
            raise DataError(f"{self.path}: expected an RGL file, {MAGIC!r} version 1.0, found {found}")
        fields: dict[str, Field] = {}
        for _ in range(count):
            (length,) = take("H")
            name = take(f"{length}s")[0].decode("ascii", "backslashreplace")
            dims, kind, offset = take("HBQ")
            if kind not in TYPES or dims > 8 or name in fields:
                raise DataError(
                    f"{self.path}: field {shown(name)}: unknown type {kind}, {dims} dimensions, or named twice"
                )
            field = Field(np.dtype(f"<{TYPES[kind]}"), offset, take(f"{dims}Q"))
            stop = offset + _size(field)
            if stop > end:
                raise DataError(f"{self.path}: truncated: field {shown(name)} ends at byte {stop}, the file at {end}")
            fields[name] = field
        stop = max((field.offset + _size(field) for field in fields.values()), default=end)
        if stop < end:
            raise DataError(f"{self.path}: expected {stop} bytes, where the last field ends, found {end}")
        return list(fields.items())

    def array(self, name: str, shape: Sequence[int | None], kind: str = "f") -> np.ndarray:
        """A copy of a field, as float64 if its type is of the kind "f"; None in `shape` is any size above 0."""
        if name not in self.fields:
            raise DataError(f"{self.path}: expected a field {name!r}, found {', '.join(map(shown, self.fields))}")
        field = self.fields[name]
        fits = len(field.shape) == len(shape) and all(
            have == want if want is not None else have > 0 for have, want in zip(field.shape, shape, strict=False)
        )
        if not fits or field.dtype.kind != kind:
            wanted = ", ".join("n" if want is None else str(want) for want in shape)
            found = f"{field.shape} of {field.dtype}"
            raise DataError(f"{self.path}: field {name!r}: expected ({wanted}) of kind {kind!r}, found {found}")
        check_unpacked(self.path, 8 * math.prod(field.shape))
        flat = np.frombuffer(self._bytes, field.dtype, math.prod(field.shape), field.offset)
        with np.errstate(invalid="ignore"):  # a signalling nan becomes a quiet one
            return flat.reshape(field.shape).astype(np.float64 if kind == "f" else field.dtype)


def write_tensor_file(path: str | Path, fields: Mapping[str, np.ndarray]) -> None:
    """Write named arrays as a tensor file, whole or not at all.

    Args:
        path: The file, which appears when it is complete.
        fields: Arrays by name, of up to 8 dimensions, of the integer and floating-point types that `TYPES` lists.

    Raises:
        DataError: The file cannot be written.

    Example:
        >>> from torchbrdf.measured.tensor_file import TensorFile, write_tensor_file
        >>> write_tensor_file("angles.bsdf", {"theta_i": np.array([0.0, 0.5], dtype="f4")})
        >>> TensorFile(Path("angles.bsdf")).array("theta_i", [2])
        array([0. , 0.5])
    """
    kinds = {name: number for number, name in TYPES.items()}
    arrays = {name: np.ascontiguousarray(array, array.dtype.newbyteorder("<")) for name, array in fields.items()}
    offset = _START.size + sum(2 + len(name) + _PLACE.size + 8 * array.ndim for name, array in arrays.items())
    with replacing(path) as part, part.open("wb") as file:
        file.write(_START.pack(MAGIC, 1, 0, len(arrays)))
        for name, array in arrays.items():
            file.write(struct.pack("<H", len(name)) + name.encode("ascii"))
            file.write(_PLACE.pack(array.ndim, kinds[array.dtype.str[1:]], offset))
            file.write(struct.pack(f"<{array.ndim}Q", *array.shape))
            offset += array.nbytes
        for array in arrays.values():
            file.write(array.data)
