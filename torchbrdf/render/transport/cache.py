"""Transports on disk, by a hash of what made them."""

import hashlib
import logging
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from torchbrdf import __version__
from torchbrdf.errors import DataError
from torchbrdf.files import replacing
from torchbrdf.pairs import Pairs
from torchbrdf.render.transport.transport import Block

Made = tuple[Pairs, list[Block]]
_PARTS = ("rows", "start", "column", "value")
# A folder holds so many bytes; beyond that, what was used longest ago goes.
_ROOM = 2 * 2**30


def cache_folder() -> Path:
    """Folder where the command line keeps transports.

    TORCHBRDF_CACHE, or `torchbrdf` in the user's folder of caches.
    """
    given = os.environ.get("TORCHBRDF_CACHE")
    if given:
        return Path(given)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "torchbrdf"


def load_or_build(folder: Path, ingredients: list[object], build: Callable[[], Made]) -> Made:
    """Transport from the cache's folder, or made by `build` of these ingredients and put there.

    A file that cannot be read is made anew, and a folder that cannot be written is passed over; either is said.
    """
    path = folder / f"transport-{digest(ingredients)}.npz"
    log = logging.getLogger("torchbrdf")
    if path.exists():
        try:
            found = _read(path)
            os.utime(path)
            return found
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            log.warning("torchbrdf: %s: cannot be read (%s); made anew", path, " ".join(str(error).split()))
    made = build()
    try:
        _write(path, *made)
        _make_room(folder, path)
    except (DataError, OSError) as error:
        log.warning("torchbrdf: the transport is not kept: %s", error)
    return made


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
    arrays = {f"pairs.{name}": value.numpy() for name, value in pairs.items() if value.dtype.is_floating_point}
    arrays |= {f"{k}.{name}": getattr(block, name).numpy() for k, block in enumerate(blocks) for name in _PARTS}
    with replacing(path) as temporary:
        np.savez(temporary, allow_pickle=False, **arrays)


def _read(path: Path) -> Made:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        found = {name: torch.from_numpy(arrays[name]) for name in arrays.files}  # zip files check their sums
    pairs = Pairs(**{name.removeprefix("pairs."): value for name, value in found.items() if name.startswith("pairs.")})
    count = sum(name.endswith(".column") for name in found)
    if not count:
        raise ValueError("no transport")
    return pairs, [Block(*(found[f"{k}.{name}"] for name in _PARTS)) for k in range(count)]


def _make_room(folder: Path, newest: Path) -> None:
    files = sorted(folder.glob("transport-*.npz"), key=lambda path: path.stat().st_mtime, reverse=True)
    used = newest.stat().st_size
    for path in files:
        if path != newest:
            used += path.stat().st_size
            if used > _ROOM:
                path.unlink()
