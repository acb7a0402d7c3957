"""Surroundings unlike the grove: a dim studio with a few large lamps."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

# Lamps: direction, width and height as tangents, radiance (red, green, blue).
_LAMPS = (
    ((-0.8, 0.7, 0.6), (0.55, 0.4), (9.0, 8.6, 8.0)),  # a soft box, the key
    ((1.0, 0.25, 0.35), (0.12, 0.8), (5.0, 5.6, 6.5)),  # a strip
    ((0.2, 0.9, -0.8), (0.35, 0.15), (14.0, 12.5, 10.0)),  # behind, for the rim
)
_FLOOR, _WALL, _CEILING = (0.10, 0.09, 0.08), (0.16, 0.17, 0.19), (0.07, 0.07, 0.08)
_EDGE = 0.04


def make_studio(height: int = 256) -> Tensor:
    """A latitude-longitude picture `(height, 2 height, 3)`, linear: three lamps with soft edges in a plain room."""
    polar = (torch.arange(height, dtype=torch.float64, device="cpu") + 0.5) * (math.pi / height)
    azimuth = (torch.arange(2 * height, dtype=torch.float64, device="cpu") + 0.5) * (math.pi / height) - math.pi
    polar, azimuth = torch.meshgrid(polar, azimuth, indexing="ij")
    directions = torch.stack([polar.sin() * azimuth.sin(), polar.cos(), -polar.sin() * azimuth.cos()], -1)
    up = directions[..., 1:2]
    floor, wall, ceiling = (directions.new_tensor(color) for color in (_FLOOR, _WALL, _CEILING))
    picture = torch.lerp(wall, floor, torch.sigmoid(-(up + 0.35) / 0.02))
    picture = torch.lerp(picture, ceiling, torch.sigmoid((up - 0.75) / 0.02))
    for toward, (width, tall), radiance in _LAMPS:
        axis = F.normalize(directions.new_tensor(toward), dim=0)
        side = F.normalize(torch.linalg.cross(directions.new_tensor([0.0, 1.0, 0.0]), axis), dim=0)
        ahead = (directions @ axis).clamp_min(1e-6)
        across, along = (directions @ side) / ahead, (directions @ torch.linalg.cross(axis, side)) / ahead
        inside = torch.sigmoid((width - across.abs()) / _EDGE * 4) * torch.sigmoid((tall - along.abs()) / _EDGE * 4)
        share = torch.where(directions @ axis > 0, inside, 0)[..., None]
        picture = torch.lerp(picture, directions.new_tensor(radiance), share)
    return picture.to(torch.float32)
