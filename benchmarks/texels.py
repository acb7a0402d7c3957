"""Texels a second, how good their fits are, and how much memory they take.

    python benchmarks/texels.py [--size 512] [--lights 64] [--held f0] [--smoothness 0] [--large 4096]

A made-up surface (`synthetic_surface`) with noise of 1 %, one GGX lobe and diffuse. CPU seconds are of this process and
its workers, without those of making photographs; processes are counted until they end. With --large: the peak memory of
this process and its workers while a surface of so many texels a side is fitted for its first tiles, and while maps of
so many are written, all of whose tiles are the same.
"""

import argparse
import contextlib
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import torch

from torchbrdf.lobes import make_model
from torchbrdf.texels import TexelMaps, api, dome, fit_texels, synthetic_surface
from torchbrdf.texels.tiling import Tiling
from torchbrdf.texels.writing import write_maps


def cpu_seconds() -> float:
    """Of this process and its children that still are."""
    own = psutil.Process()
    used = [own.cpu_times(), *(child.cpu_times() for child in own.children(recursive=True))]
    return sum(one.user + one.system for one in used)


class Peak:
    """The largest sum of resident memory of this process and its workers, looked at ten times a second."""

    def __enter__(self) -> "Peak":
        self.bytes, self._going = 0, True
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._going = False
        self._thread.join()

    def _watch(self) -> None:
        own = psutil.Process()
        while self._going:
            total = 0
            for process in [own, *own.children(recursive=True)]:
                with contextlib.suppress(psutil.NoSuchProcess):
                    total += process.memory_info().rss
            self.bytes = max(self.bytes, total)
            time.sleep(0.1)


class Photographs:
    """Observations that say how many CPU seconds it took to make them."""

    def __init__(self, camera: object) -> None:
        self.camera, self.seconds = camera, 0.0

    def __call__(self, rows: slice, columns: slice) -> np.ndarray:
        before = time.thread_time()
        found = self.camera(rows, columns)
        self.seconds += time.thread_time() - before
        return found


def fitted(size: int, lights: np.ndarray, **options: object) -> None:
    """Print speed and errors of one surface."""
    surface = synthetic_surface(size)
    camera = surface.camera(lights)
    photographs, began, before = Photographs(camera), time.perf_counter(), cpu_seconds()
    with Peak() as peak:
        maps = fit_texels(photographs, lights, normals=surface.normals, size=(size, size), **options)
        used, wall = cpu_seconds() - before - photographs.seconds, time.perf_counter() - began
    true = np.concatenate([camera.true_errors(one.rows, one.columns).ravel() for one in maps.tiling])
    found = np.concatenate([maps.tile("error", one).ravel() for one in maps.tiling])
    ratio, count = found / true, size * size
    print(
        f"{size} x {size} texels, {len(lights)} lights, {options or 'as by default'}, {torch.get_num_threads()} threads"
    )
    print(
        f"CPU s {used:.1f}, wall s {wall:.1f}: {1e6 * used / count:.0f} us a texel, 2 cores: {2 * count / used:.0f}/s"
    )
    print(f"within 1.01 of the truth's error: {100 * (ratio <= 1.01).mean():.3f} %, the largest {np.nanmax(ratio):.3f}")
    print(f"status {maps.counts()}; peak {peak.bytes / 2**30:.2f} GiB", flush=True)


class EnoughError(Exception):
    """Raised when so much is done that memory no longer grows."""


def large(side: int, lights: np.ndarray) -> None:
    """Print the memory that a large surface takes: while it is fitted, and while its maps are written."""
    surface = synthetic_surface(512)
    camera = surface.camera(lights)

    def repeated(rows: slice, columns: slice) -> np.ndarray:
        row, column = rows.start % 512, columns.start % 512
        return camera(slice(row, row + rows.stop - rows.start), slice(column, column + columns.stop - columns.start))

    def stop(done: int, total: int) -> None:
        if done >= 64**2 * 2 * api.AHEAD * torch.get_num_threads():
            raise EnoughError

    tiles = side // 512
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "normals.npy"
        normals = np.lib.format.open_memmap(path, "w+", np.float32, (side, side, 3))
        for row in range(tiles):
            normals[row * 512 : row * 512 + 512] = np.tile(surface.normals, (1, tiles, 1))
        normals = np.load(path, mmap_mode="r")
        with Peak() as peak, contextlib.suppress(EnoughError):
            fit_texels(repeated, lights, normals=normals, size=(side, side), out=f"{folder}/out", progress=stop)
        print(
            f"{side} x {side}, {len(lights)} lights: fitting, peak {peak.bytes / 2**30:.2f} GiB with workers",
            flush=True,
        )
        first = next(one for one in (Path(folder) / "out" / "tiles").iterdir())
        with np.load(first) as found:
            tile = {name: found[name] for name in found.files}
        maps = TexelMaps(make_model("ggx", 1), Tiling((side, side), 64), lambda _: tile)
        with Peak() as peak:
            began = time.process_time()
            write_maps(maps, Path(folder) / "maps")
            taken = time.process_time() - began
        print(f"writing EXR and PNG: peak {peak.bytes / 2**30:.2f} GiB with workers, {taken:.0f} CPU s", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--lights", type=int, default=64)
    parser.add_argument("--held", nargs="*", default=[])
    parser.add_argument("--smoothness", type=float, default=0.0)
    parser.add_argument("--large", type=int, default=0)
    asked = parser.parse_args()
    own_options = {"held": tuple(asked.held)} if asked.held else {}
    own_options |= {"smoothness": asked.smoothness} if asked.smoothness else {}
    if asked.large:
        large(asked.large, dome(asked.lights))
    else:
        fitted(asked.size, dome(asked.lights), **own_options)
