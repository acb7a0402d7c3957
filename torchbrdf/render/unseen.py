"""Scenes to judge fits in: shapes, lights and views that no loss of pictures is given by default."""

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from torchbrdf.precision import undisturbed
from torchbrdf.render.light.environment import Environment
from torchbrdf.render.raster.camera import Camera
from torchbrdf.render.raster.mesh import Mesh, sphere
from torchbrdf.render.scene import Scene

NAMES = ("sphere, studio", "torus, evening", "knot, room")
# The sun of the evening, and the lamp of the room: towards what, half width in degrees, radiance.
_SUN = ((-0.6, 0.45, 0.75), 3.0, (220.0, 180.0, 120.0))
_LAMP = ((-0.8, 0.6, -0.1), 6.0, (60.0, 42.0, 22.0))
# The room's window: where its middle is and how far it reaches to the sides and up, and its bars, in radians.
_WINDOW, _HALF, _BAR, _DAY = (0.9, 0.25), (0.45, 0.35), (0.03, 0.025), (9.0, 11.0, 14.0)


def unseen_scenes(size: int = 128, cache: Path | str | None = None) -> dict[str, Scene]:
    """Three scenes unlike the blob in the grove, by name.

    Args:
        size: Pixels of a side.
        cache: A folder where the transports are kept.

    Returns:
        A sphere in the bundled studio, a torus in a low sun, and a knot in a dim room with a window.

    Example:
        >>> from torchbrdf.render import unseen_scenes
        >>> list(unseen_scenes(size=16))
        ['sphere, studio', 'torus, evening', 'knot, room']
    """
    made = (
        (sphere(), Camera(140, elevation=20), Environment.find("studio")),
        (torus(), Camera(0, elevation=35), Environment.from_image(evening())),
        (knot(), Camera(20, elevation=15), Environment.from_image(room())),
    )
    return {name: Scene(*parts, size=size, cache=cache) for name, parts in zip(NAMES, made, strict=True)}


def torus(thick: float = 0.42, around: int = 160, across: int = 80) -> Mesh:
    """A torus of radius 1 and thickness `thick`, lying flat; from above its inside is seen, too."""
    turn = np.arange(around) * 2 * np.pi / around
    out = np.stack([np.cos(turn), np.zeros_like(turn), np.sin(turn)], -1)
    return _tube(out, out, np.broadcast_to([0.0, 1.0, 0.0], out.shape), thick, across, "torus")


def knot(thick: float = 0.3, around: int = 320, across: int = 48) -> Mesh:
    """A trefoil knot of a round tube: bright and dark sides of it lie close together."""
    turn = np.arange(around) * 2 * np.pi / around
    middle = 0.4 * np.stack(
        [np.sin(turn) + 2 * np.sin(2 * turn), np.cos(turn) - 2 * np.cos(2 * turn), -np.sin(3 * turn)], -1
    )
    ahead = _unit(np.roll(middle, -1, 0) - np.roll(middle, 1, 0))
    inward = np.roll(middle, -1, 0) + np.roll(middle, 1, 0) - 2 * middle
    side = _unit(inward - (inward * ahead).sum(-1, keepdims=True) * ahead)
    return _tube(middle, side, np.cross(ahead, side), thick, across, "knot")


@undisturbed()
def evening(height: int = 256) -> Tensor:
    """A low sun in a clear sky over dark ground: a latitude-longitude picture `(height, 2 height, 3)`, linear."""
    toward = _directions(height)
    up = toward[..., 1:2]
    low, high, ground = (toward.new_tensor(c) for c in ((0.9, 0.75, 0.6), (0.2, 0.35, 0.7), (0.08, 0.07, 0.05)))
    sky = torch.lerp(low, high, up.clamp_min(0).sqrt())
    return torch.where(up > 0, sky, ground) + _disc(toward, *_SUN)


@undisturbed()
def room(height: int = 256) -> Tensor:
    """A dim, warm room with a window in four panes and a lamp: a latitude-longitude picture, linear."""
    toward = _directions(height)
    floor, ceiling = toward.new_tensor([0.10, 0.08, 0.06]), toward.new_tensor([0.22, 0.20, 0.18])
    walls = torch.lerp(floor, ceiling, (toward[..., 1:2] + 1) / 2)
    across = torch.atan2(toward[..., 0], toward[..., 2]) - _WINDOW[0]
    along = torch.asin(toward[..., 1].clamp(-1, 1)) - _WINDOW[1]
    pane = (across.abs() < _HALF[0]) & (along.abs() < _HALF[1])
    pane &= (across.abs() > _BAR[0]) & (along.abs() > _BAR[1])
    return walls + pane[..., None] * toward.new_tensor(_DAY) + _disc(toward, *_LAMP)


def _directions(height: int) -> Tensor:
    """Where the pixels of a latitude-longitude picture look, `(height, 2 height, 3)`."""
    polar = (torch.arange(height, dtype=torch.float32, device="cpu") + 0.5) * (torch.pi / height)
    turn = (torch.arange(2 * height, dtype=torch.float32, device="cpu") + 0.5) * (torch.pi / height) - torch.pi
    polar, turn = torch.meshgrid(polar, turn, indexing="ij")
    return torch.stack([polar.sin() * turn.sin(), polar.cos(), -polar.sin() * turn.cos()], -1)


def _disc(toward: Tensor, at: tuple[float, ...], degrees: float, radiance: tuple[float, ...]) -> Tensor:
    """A round light with a soft edge."""
    away = torch.rad2deg(torch.acos((toward @ F.normalize(toward.new_tensor(at), dim=0)).clamp(-1, 1)))
    return torch.sigmoid((degrees - away) * 2)[..., None] * toward.new_tensor(radiance)


def _tube(middle: np.ndarray, side: np.ndarray, up: np.ndarray, thick: float, across: int, name: str) -> Mesh:
    """A closed tube around a closed curve, whose sections lie between `side` and `up`, `(around, 3)` each."""
    around = len(middle)
    turn = (np.arange(across) * 2 * np.pi / across)[:, None]
    normals = np.cos(turn) * side[:, None] + np.sin(turn) * up[:, None]
    k = np.arange(around * across).reshape(around, across)
    a, b, c, d = (x.ravel() for x in (k, np.roll(k, -1, 0), np.roll(k, -1, (0, 1)), np.roll(k, -1, 1)))
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([a, d, c], -1)])
    vertices = middle[:, None] + thick * normals
    return Mesh(vertices.reshape(-1, 3), faces, normals.reshape(-1, 3), name=name)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
