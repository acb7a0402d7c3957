"""Transports on disk, by a hash of what made them."""

import hashlib
import logging
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch

from torchbrdf import __version__
from torchbrdf.errors import DataError
from torchbrdf.pairs import Pairs
from torchbrdf.reading import check_unpacked, read_npz, write_npz
from torchbrdf.render.transport.blocks import Block
from torchbrdf.render.transport.compact import KNOWN

Made = tuple[Pairs, list[Block]]
# Arrays of a block, with their types.
_PARTS = {"rows": np.int64, "start": np.int32, "column": np.int32, "value": np.float32}
# A folder holds so many bytes; beyond that, what was used longest ago goes.
_ROOM = 2 * 2**30
_log = logging.getLogger("torchbrdf")


def cache_folder() -> Path | None:
    """Folder where the command line keeps transports.

    TORCHBRDF_CACHE, or `torchbrdf` in the user's folder of caches.

    Returns:
        The folder, which need not be there yet; None for a user without a home, which is said in the log.
    """
    given = os.environ.get("TORCHBRDF_CACHE")
    if given:
        return Path(given)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "torchbrdf"
    except RuntimeError:  # as in a container whose user is in no password file
        _log.warning("torchbrdf: transports are not kept: this user has no home folder; TORCHBRDF_CACHE names another")
        return None


def load_or_build(folder: Path, ingredients: list[object], rows: int, blocks: int, build: Callable[[], Made]) -> Made:
    """Transport from the cache's folder, or made by `build` of these ingredients and put there.

    A file that is damaged, was changed, or is no transport of so many rows and blocks is made anew, and a folder that
    cannot be written is passed over; either is said.
    """
    path = folder / f"transport-{digest(ingredients)}.npz"
    found = _kept(path, rows, blocks)
    if found is not None:
        return found
    made = build()
    try:
        _write(path, *made)
        _make_room(folder, path)
    except (DataError, OSError) as error:
        _log.warning("torchbrdf: the transport is not kept: %s", error)
    return made


def _kept(path: Path, rows: int, blocks: int) -> Made | None:
    """What a file holds; None if there is no file, or it is wrong, which is said."""
    if not os.path.lexists(path):
        return None
    try:
        found = _read(path, rows, blocks)
    except DataError as error:
        _log.warning("torchbrdf: %s; made anew", error)
        with suppress(OSError):  # a FIFO or a link is not to be written into; a folder stays, and nothing is kept
            path.unlink()
        return None
    with suppress(OSError):  # the file of another user is not ours to mark as used
        os.utime(path)
    return found


def digest(ingredients: list[object]) -> str:
    """A short hash of arrays, and of anything else by what it shows."""
    found = hashlib.sha256(__version__.encode())
    for one in ingredients:
        if isinstance(one, np.ndarray):
            found.update(repr((one.shape, one.dtype.str)).encode() + np.ascontiguousarray(one).tobytes())
        else:
            found.update(repr(one).encode())
    return found.hexdigest()[:24]


def _write(path: Path, pairs: Pairs, blocks: list[Block]) -> None:
    arrays = {f"pairs.{name}": getattr(pairs, name).numpy() for name in KNOWN}
    arrays |= {f"{k}.{name}": getattr(block, name).numpy() for k, block in enumerate(blocks) for name in _PARTS}
    check_unpacked(path, sum(array.nbytes for array in arrays.values()))  # it could not be read again
    write_npz(path, arrays)


def _read(path: Path, rows: int, blocks: int) -> Made:
    """The transport of a file, whatever that holds; a DataError if it is none."""
    expected = f"a transport of {rows} pixels"
    arrays = read_npz(path, expected, {f"pairs.{name}": ((1, None), "f") for name in KNOWN})
    count = arrays[f"pairs.{KNOWN[0]}"].shape[1]
    for name in KNOWN:
        value = arrays[f"pairs.{name}"]
        if value.shape != (1, count) or value.dtype != np.float32:
            raise DataError(f"{path}: expected {expected}, found pairs.{name} {value.shape} {value.dtype}")
    pairs = Pairs(**{name: torch.from_numpy(arrays[f"pairs.{name}"]) for name in KNOWN})
    return pairs, [_block(path, arrays, k, rows, count) for k in range(blocks)]


def _block(path: Path, arrays: Mapping[str, np.ndarray], k: int, rows: int, count: int) -> Block:
    """A block whose entries are all in place."""
    own = {name: arrays.get(f"{k}.{name}", np.zeros(0)) for name in _PARTS}
    start, column, value = own["start"], own["column"], own["value"]
    fits = (
        all(own[name].dtype == kind for name, kind in _PARTS.items())
        and np.array_equal(own["rows"], np.arange(rows))
        and start.shape == (rows + 1,)
        and start[0] == 0
        and bool((np.diff(start) >= 0).all())
        and column.shape == (start[-1],)
        and value.shape == (3, len(column))
        and bool(((column >= 0) & (column < count)).all())
        and bool(np.isfinite(value).all())
    )
    if not fits:
        raise DataError(f"{path}: expected block {k} with {rows} rows of entries for {count} pairs, found another")
    return Block(*(torch.from_numpy(array) for array in own.values()))


def _make_room(folder: Path, newest: Path) -> None:
    found = {path: path.stat() for path in folder.glob("transport-*.npz") if path != newest}
    used = newest.stat().st_size
    for path, status in sorted(found.items(), key=lambda item: item[1].st_mtime, reverse=True):
        used += status.st_size
        if used > _ROOM:
            path.unlink(missing_ok=True)
