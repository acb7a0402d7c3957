"""What finds the triangle that each pixel shows: OpenGL where it works and is faster, else software."""

import functools
import logging
import subprocess
import sys
from dataclasses import dataclass

import numpy as np

from torchbrdf import kinds
from torchbrdf.errors import UsageError
from torchbrdf.registry import unknown
from torchbrdf.render.raster import opengl, zbuffer

BACKENDS = kinds.BACKENDS

# Seconds for OpenGL to show that it works; importing it from a cold disk takes a while.
_PATIENCE = 60.0
# Seconds of software for a face and for a pixel: within a factor of two those of spheres of 2,000 to 2,000,000 faces on
# 300 to 1920 pixels a side, on one core. And those that OpenGL takes before its first picture: 1.2 for the process that
# tries it and 1.5 to import it here, on the same machine. What a graphics card takes for the picture was not measured,
# and counts as nothing.
_FACE, _PIXEL, _START = 4e-7, 6e-8, 2.7
# OpenGL on the processor, by what is in its renderer's name: slower than our own.
_ON_CPU = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software", "basic render")
_INSTALL = "on Debian apt-get install libegl1 libgl1 libgl1-mesa-dri libxrender1"


@dataclass(frozen=True)
class OpenGL:
    """OpenGL as it was found: the renderer's name, or, if that is None, why it does not work."""

    renderer: str | None
    reason: str = ""


@functools.cache
def find_opengl() -> OpenGL:
    """Whether OpenGL draws, tried once.

    In another process: where it fails, it may crash, or hang, or leave PyOpenGL half imported.
    """
    try:
        done = subprocess.run(
            # -P, lest this folder's modules hide others by their names
            [sys.executable, "-P", opengl.__file__],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PATIENCE,
        )
    except subprocess.TimeoutExpired:
        return OpenGL(None, f"no picture within {_PATIENCE:.0f} s")
    except OSError as error:
        return OpenGL(None, f"could not be tried: {error}")
    said = (done.stdout.strip().splitlines() or [""])[-1].rstrip(".")
    if done.returncode == 0 and said:
        return OpenGL(said)
    return OpenGL(None, said or f"the trial ended with status {done.returncode}")


@functools.cache
def has_fast_opengl() -> bool:
    """Whether OpenGL works, and not on the processor; it is said once if not."""
    found = find_opengl()
    reason = found.reason
    if found.renderer and any(word in found.renderer.lower() for word in _ON_CPU):
        reason = f"{found.renderer} draws on the processor, which software does faster"
    if reason:
        logging.getLogger("torchbrdf").info("torchbrdf: rasterizing in software; OpenGL: %s", reason)
    return not reason


def is_opengl_faster(faces: int, size: int) -> bool:
    """Whether auto means OpenGL for so many faces on `size` x `size` pixels.

    Not where software is done before it starts. Both draw the same, but for pixels at edges, see `rasterize`.
    """
    return faces * _FACE + size**2 * _PIXEL > _START and has_fast_opengl()


def nearest_triangles(points: np.ndarray, faces: np.ndarray, size: int, backend: str) -> np.ndarray:
    """The id of the nearest triangle at each pixel's centre, `(size, size)`, -1 where there is none.

    points: `(3, V)`, column, row and closeness as `Camera.project` gives them; faces: `(F, 3)`.
    backend: software, pyrender, or auto, which is pyrender where that works and is faster.
    """
    if backend not in BACKENDS:
        raise unknown("backend", backend, BACKENDS)
    if backend == "software" or (backend == "auto" and not is_opengl_faster(len(faces), size)):
        return zbuffer.nearest_triangles(points, faces, size)
    try:
        return _by_opengl(points, faces, size)
    except UsageError as error:
        if backend == "pyrender":
            raise
        logging.getLogger("torchbrdf").info("torchbrdf: rasterizing in software; %s", error)
        return zbuffer.nearest_triangles(points, faces, size)


def _by_opengl(points: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """With a UsageError if it cannot be done."""
    most = max(len(faces), points.shape[1])
    if most > opengl.MOST_TRIANGLES:
        raise UsageError(
            f"backend 'pyrender': expected at most {opengl.MOST_TRIANGLES} faces and vertices, found {most}; "
            "use software"
        )
    found = find_opengl()
    if not found.renderer:
        raise UsageError(f"backend 'pyrender': OpenGL does not work here: {found.reason}; {_INSTALL}, or use software")
    try:
        return opengl.nearest_triangles(points, faces, size)
    except Exception as error:  # of many kinds, its own, the system's, and pyrender's
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise UsageError(f"backend 'pyrender': OpenGL could not draw {size} x {size} pixels: {reason}") from None
