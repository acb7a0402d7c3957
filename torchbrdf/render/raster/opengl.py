"""Which triangle each pixel shows: drawn by OpenGL, through pyrender, without a window.

Run as a program, this file draws two triangles, checks them, and prints the renderer's name or why it failed. Nothing
of torchbrdf is imported, so that this is quick.
"""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

# Faces in 24 bits of colour, 0 being none; pyrender takes vertex numbers through float32.
MOST_TRIANGLES = 2**24 - 1

# pyrender's own shaders know an object's colour only. Vertices come projected in double precision, divided by depth;
# every face comes twice, wound one way and the other, because pyrender culls the backs; one of them is seen.
_SHADERS = Path(__file__).parent / "shaders"

# Contexts of one display do not outlive each other: the first that is deleted ends them all.
_ALONE = threading.Lock()
# The process that has used OpenGL. One that is forked from it would wait for threads that it does not have.
_user: list[int] = []


def nearest_triangles(points: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """The id of the nearest triangle at each pixel's centre, `(size, size)`, -1 where there is none.

    points: `(3, V)`, column, row and closeness as `Camera.project` gives them; faces: `(F, 3)`, at most MOST_TRIANGLES.
    Raises whatever comes up where OpenGL is not complete. It is only used from the calling thread.
    """
    if _user and os.getpid() not in _user:
        raise RuntimeError("this process was forked from one that has used OpenGL")
    _user[:] = [os.getpid()]
    column, row, closeness = points
    least, most = closeness.min(), closeness.max()
    # Of the depths -1 to 1 not the ends, where rounding would clip. GL counts rows from below.
    depth = 0.99 - 1.98 * (closeness - least) / max(most - least, 1e-30)
    corners = np.stack([(2 * column + 1) / size - 1, 1 - (2 * row + 1) / size, depth], 1).astype(np.float32)
    twice = np.stack([faces, faces[:, ::-1]], 1).reshape(-1, 3)
    with _ALONE, _renderer(size) as (pyrender, renderer):
        scene = pyrender.Scene()
        scene.add(pyrender.PerspectiveCamera(yfov=1.0))  # unused, but it insists
        node = scene.add(pyrender.Mesh([pyrender.Primitive(corners, indices=twice)]))
        # Drawn as a segmentation, nothing is blended or smoothed, and multisampling is off: ids stay whole.
        color, _ = renderer.render(scene, pyrender.RenderFlags.SEG, {node: 0})
    bytes_ = color.astype(np.int64)
    return bytes_[..., 0] + (bytes_[..., 1] << 8) + (bytes_[..., 2] << 16) - 1


@contextmanager
def _renderer(size: int) -> Iterator[tuple[Any, Any]]:
    """pyrender and a renderer of `size` x `size` pixels with the shaders above, deleted afterwards."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")  # before the first import
    import pyrender
    from pyrender.shader_program import ShaderProgramCache

    renderer = pyrender.OffscreenRenderer(size, size)
    try:
        renderer._renderer._program_cache = ShaderProgramCache(str(_SHADERS))
        yield pyrender, renderer
    finally:
        renderer.delete()


def _check() -> str:
    """The renderer's name, if it draws two triangles as it should: the nearer one, wound the other way, in a corner."""
    column, row = [-1, -1, 7.5, -1, 13.5, -1], [-1, 7.5, -1, -1, -1, 13.5]
    points = np.array([column, row, [1.0] * 3 + [0.5] * 3])
    found = nearest_triangles(points, np.arange(6).reshape(2, 3), 8)
    away = np.add.outer(np.arange(8), np.arange(8))
    if not np.array_equal(found, np.where(away < 7, 0, np.where(away < 13, 1, -1))):
        raise RuntimeError("it draws a wrong picture")
    with _renderer(1):
        from OpenGL.GL import GL_RENDERER, glGetString

        return str(glGetString(GL_RENDERER).decode())


if __name__ == "__main__":
    try:
        print(_check())
    except BaseException as error:
        print(f"{type(error).__name__}: {' '.join(str(error).split())}")
        sys.exit(1)
