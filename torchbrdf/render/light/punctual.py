"""Light that comes from one direction at every point: point and directional lights."""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import UsageError

Triple = tuple[float, float, float]

# Nearer than this a point light grows no brighter, so that one that touches the surface gives finite numbers; of
# positions about 1 away from the origin float32 tells no closer ones apart.
NEAREST = 1e-6
# Beyond these, squares of distances, and what arrives at NEAREST, would not fit into float32.
FARTHEST = 1e9
BRIGHTEST = 1e15


@dataclass(frozen=True)
class DirectionalLight:
    """Directional light: parallel, as of the sun. The vertical axis is +y.

    Args:
        direction: Toward the light, of any length, kept as a unit vector.
        irradiance: W/m^2 on a surface that faces the light, red, green and blue, or one number for all three.

    Raises:
        UsageError: The direction is 0 or not finite, or an irradiance not from 0 to 1e15.

    Example:
        >>> DirectionalLight((0, 2, 0), 3.0)
        DirectionalLight(direction=(0.0, 1.0, 0.0), irradiance=(3.0, 3.0, 3.0))
    """

    direction: Triple
    irradiance: Triple | float = 1.0

    def __post_init__(self) -> None:
        direction = _triple("DirectionalLight.direction", self.direction)
        largest = max(abs(x) for x in direction)
        if not largest:
            raise UsageError(f"DirectionalLight.direction: expected a vector other than 0, found {self.direction}")
        shrunk = [x / largest for x in direction]  # squares of very long or short ones would not fit
        length = math.hypot(*shrunk)
        object.__setattr__(self, "direction", tuple(x / length for x in shrunk))
        object.__setattr__(self, "irradiance", _color("DirectionalLight.irradiance", self.irradiance))

    def at(self, position: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What reaches points `(p, 3)`: unit directions to the light, irradiances, and distances.

        `(p, 3)`, `(p, 3)`, and `(p,)`, all infinite.
        """
        direction, irradiance = (position.new_tensor(x).expand_as(position) for x in (self.direction, self.irradiance))
        return direction, irradiance, torch.full_like(position[:, 0], math.inf)


@dataclass(frozen=True)
class PointLight:
    """Point light: sends light out equally in all directions. The vertical axis is +y.

    At distance r the irradiance on a surface that faces the light is intensity / r^2, where r counts as at least 1e-6.
    A light exactly at a point of the surface has no direction, `at` gives 0 for it, and so it adds nothing there.

    Args:
        position: In the units of the mesh.
        intensity: W/sr, red, green and blue, or one number for all three.

    Raises:
        UsageError: A coordinate is not finite or beyond 1e9, or an intensity not from 0 to 1e15.

    Example:
        >>> _, irradiance, distance = PointLight((0, 2, 0), 8.0).at(torch.zeros(1, 3))
        >>> irradiance, distance
        (tensor([[2., 2., 2.]]), tensor([2.]))
    """

    position: Triple
    intensity: Triple | float = 1.0

    def __post_init__(self) -> None:
        position = _triple("PointLight.position", self.position)
        if max(map(abs, position)) > FARTHEST:
            raise UsageError(f"PointLight.position: expected at most {FARTHEST:g} from 0, found {self.position!r}")
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "intensity", _color("PointLight.intensity", self.intensity))

    def at(self, position: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What reaches points `(p, 3)`: unit directions to the light, irradiances, and distances.

        `(p, 3)`, `(p, 3)` and `(p,)`.
        """
        way = position.new_tensor(self.position) - position
        distance = way.norm(dim=-1)
        counted = distance.clamp_min(NEAREST)[:, None]
        direction = way / torch.where(distance > 0, distance, 1)[:, None]
        return direction, position.new_tensor(self.intensity) / counted.square(), distance


PunctualLight = DirectionalLight | PointLight

_KINDS: dict[str, type[PunctualLight]] = {"directional": DirectionalLight, "point": PointLight}


def parse_light(text: str) -> PunctualLight:
    """Punctual light from `KIND:X,Y,Z:COLOR`, as a command line gives it.

    Args:
        text: `directional:` with a direction and an irradiance, or `point:` with a position and an intensity. COLOR
            is `R,G,B` or one number, 1 if it is left out.

    Raises:
        UsageError: The text says no light.

    Example:
        >>> parse_light("point:1,2,3:5,5,4")
        PointLight(position=(1.0, 2.0, 3.0), intensity=(5.0, 5.0, 4.0))
    """
    kind, *rest = text.split(":")
    if kind not in _KINDS or len(rest) not in (1, 2):
        raise UsageError(
            f"light: expected directional:X,Y,Z:COLOR or point:X,Y,Z:COLOR (COLOR is R,G,B or one number), found {text}"
        )
    try:
        place, *color = [tuple(float(x) for x in part.split(",")) for part in rest]
    except ValueError:
        raise UsageError(f"light {text}: expected numbers with commas between them behind {kind}:") from None
    values: list[Any] = [place, *(one[0] if len(one) == 1 else one for one in color)]
    try:
        return _KINDS[kind](*values)
    except UsageError as error:
        raise UsageError(f"light {text}: {error}") from None


def _triple(where: str, values: object) -> Triple:
    """Three finite numbers."""
    if not isinstance(values, Sequence) or len(values) != 3 or not all(_is_finite(x) for x in values):
        raise UsageError(f"{where}: expected three finite numbers, found {values!r}")
    return tuple(float(x) for x in values)  # type: ignore[return-value]


def _color(where: str, values: object) -> Triple:
    """Three numbers from 0 to BRIGHTEST, of three or of one."""
    channels = (values,) * 3 if _is_finite(values) else values
    three = isinstance(channels, Sequence) and len(channels) == 3
    if not three or not all(_is_finite(x) and 0 <= x <= BRIGHTEST for x in channels):  # type: ignore[attr-defined]
        raise UsageError(f"{where}: expected one or three finite numbers from 0 to {BRIGHTEST:g}, found {values!r}")
    return _triple(where, channels)


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= sys.float_info.max
