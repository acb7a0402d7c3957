"""The folder of a fit of texels: what was asked for, and a file for each tile that is done."""

import hashlib
import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf import __version__
from torchbrdf.errors import DataError, shown
from torchbrdf.files import write_json
from torchbrdf.lobes import from_parameters
from torchbrdf.reading import read_json, read_npz, write_npz
from torchbrdf.texels.maps import TexelMaps
from torchbrdf.texels.solve import Maps, map_sizes
from torchbrdf.texels.tiling import Tile, Tiling

log = logging.getLogger("torchbrdf")

RECORD = "texels.json"
TILES = "tiles"
_EXPECTED_TILE = "a tile of fitted texels"
_SETTINGS = "settings"


class TexelFolder:
    """Tiles in files, whole or not at all, that belong to one record of settings.

    Args:
        path: The folder, which is there.
        settings: Everything that a texel's fit depends on, as JSON has it.

    Raises:
        DataError: It holds tiles of other settings, or of another stack.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        self.path, self.settings = path, json.loads(json.dumps(settings))
        self.digest = hashlib.sha256(json.dumps(self.settings, sort_keys=True).encode()).digest()
        self.sizes = map_sizes(_model_of(self.settings))
        record = path / RECORD
        if record.exists():
            self._check(record)
        else:
            write_json(record, {"settings": self.settings, "version": __version__})

    def _check(self, record: Path) -> None:
        before = _read_record(record)
        for key in (*self.settings, *before):
            if before.get(key) == self.settings.get(key):
                continue
            if key in ("stack", "irradiance"):  # digests say nothing to people
                raise DataError(f"{record}: expected the {key} that its tiles were fitted with, found another; "
                                "give another folder")  # fmt: skip
            had, wants = (shown(one.get(key), 40) for one in (before, self.settings))
            raise DataError(f"{record}: fitted with {key} {had}, not {wants}; give another folder")

    def file(self, tile: Tile) -> Path:
        """Where a tile is."""
        return self.path / TILES / f"{tile.name}.npz"

    def _mark(self, tile: Tile) -> bytes:
        """What only this tile by these settings has in it."""
        return hashlib.sha256(self.digest + tile.name.encode()).digest()

    def write(self, tile: Tile, maps: Maps) -> None:
        """Write a tile."""
        write_npz(self.file(tile), maps | {_SETTINGS: np.frombuffer(self._mark(tile), np.uint8)})

    def read(self, tile: Tile) -> Maps | None:
        """A tile's maps; None if they are not there.

        Raises:
            DataError: The file is damaged, or of other settings.
        """
        path = self.file(tile)
        if not path.exists():
            return None
        found = read_npz(path, _EXPECTED_TILE)
        if found.pop(_SETTINGS, np.zeros(0)).tobytes() != self._mark(tile):
            raise DataError(f"{path}: expected this tile by the settings in {RECORD}, found one of others")
        wanted = {name: (*tile.shape, size) for name, size in self.sizes.items()}
        if {name: value.shape for name, value in found.items()} != wanted:
            raise DataError(f"{path}: expected maps of {tile.shape} texels: {', '.join(wanted)}, found others")
        return found

    def finished(self, tile: Tile) -> bool:
        """Whether a tile need not be fitted; one that is damaged is said, and done again.

        Raises:
            DataError: It is whole, and of other settings.
        """
        try:
            return self.read(tile) is not None
        except DataError as error:
            if "by the settings" in str(error):
                raise
            log.warning("torchbrdf: %s; it is fitted again", error)
            return False


def open_texels(folder: Path | str) -> TexelMaps:
    """The maps in a folder that `fit_texels` wrote; texels of tiles that are not there have the status FAILED.

    Args:
        folder: Where.

    Returns:
        The maps, which are read tile by tile as they are asked for.

    Raises:
        DataError: It is none; or, when a map is asked for, a tile is damaged.

    Example:
        >>> import tempfile
        >>> from torchbrdf.texels import dome, fit_texels, open_texels, synthetic_surface
        >>> surface, lights = synthetic_surface(8), dome(16)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     fitted = fit_texels(surface.stack(lights), lights, normals=surface.normals, out=folder, formats=())
        ...     open_texels(folder)["roughness"].shape
        (8, 8, 1)
    """
    path = Path(folder)
    settings = _read_record(path / RECORD)
    own = TexelFolder(path, settings)
    return TexelMaps(_model_of(settings), Tiling(tuple(settings["size"]), settings["tile"]), own.read)


def _read_record(path: Path) -> dict[str, Any]:
    record: dict[str, Any] = read_json(path, dict[str, Any], "the record of a fit of texels")
    found = record.get("settings")
    try:
        if isinstance(found, dict) and len(found["size"]) == 2 and _model_of(found):
            Tiling((int(found["size"][0]), int(found["size"][1])), found["tile"])
            return found
    except (KeyError, TypeError, ValueError):
        pass
    raise DataError(f"{path}: expected the record of a fit of texels, found {shown(found)}")


def _model_of(settings: Mapping[str, Any]) -> Any:
    """The model that was fitted, at its start."""
    import torch

    return from_parameters(settings["model"], settings["start"], torch.float32)
