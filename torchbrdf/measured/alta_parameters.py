"""The coordinates that ALTA's files have directions in, and what light and viewer they stand for.

V is the direction to the viewer, L that to the light, H = (L + V) / 2 and B = (L - V) / 2, not normalized; of angles
the indices are the directions'. Where coordinates leave an angle open, one is taken, and `left_open` says which.

Source: L. Belcour, R. Pacanowski, P. Barla, ALTA: Analysis of BRDFs, https://github.com/belcour/alta, the documentation
of its class `params`; P. Barla, L. Belcour, R. Pacanowski, In Praise of an Alternative BRDF Parametrization, 2015.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

Directions = tuple[np.ndarray, np.ndarray]
"""Vectors to the light and to the viewer, `(N, 3)`; nan where coordinates are none."""

_PHI_D = "the azimuth about the half vector is not given; taken as 90 degrees"
_AT_NORMAL = "the direction of the light is not given; taken as the normal"


class Parameters(NamedTuple):
    """A set of coordinates.

    Attributes:
        size: How many there are.
        polar: Which of them are angles from the normal, or as large at most.
        azimuth: Which are other angles.
        directions: Makes light and viewer of columns `(size, N)`, angles in radians.
        left_open: What they do not say, and what is taken; "" where they say all.
        has_grain: Whether they say how the surface is turned; without, azimuths are those from the light.
    """

    size: int
    polar: tuple[int, ...]
    azimuth: tuple[int, ...]
    directions: Callable[[np.ndarray], Directions]
    left_open: str = ""
    has_grain: bool = False


def _spherical(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1)


def _disk(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A direction, of its angle from the normal as the length of a vector in the plane."""
    return _spherical(np.hypot(x, y), np.arctan2(y, x))


def _mirrored(direction: np.ndarray, at: np.ndarray) -> np.ndarray:
    """A direction, mirrored at another."""
    found: np.ndarray = 2 * (direction * at).sum(-1, keepdims=True) * at - direction
    return found


def _rusinkiewicz(theta_h: np.ndarray, phi_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> Directions:
    """The difference angles are the viewer's."""
    x, y, z = _spherical(theta_d, phi_d).T
    x, z = np.cos(theta_h) * x + np.sin(theta_h) * z, np.cos(theta_h) * z - np.sin(theta_h) * x
    viewer = np.stack([np.cos(phi_h) * x - np.sin(phi_h) * y, np.sin(phi_h) * x + np.cos(phi_h) * y, z], -1)
    return _mirrored(viewer, _spherical(theta_h, phi_h)), viewer


def _across(theta_h: np.ndarray, theta_d: np.ndarray) -> Directions:
    """Half and difference angles without the azimuths."""
    return _rusinkiewicz(theta_h, 0 * theta_h, theta_d, np.full_like(theta_h, np.pi / 2))


def _same(half: np.ndarray) -> Directions:
    return half, half


def _half_and_back(x: np.ndarray, z: np.ndarray, back: np.ndarray) -> Directions:
    half = np.stack([x, 0 * x, z], -1)
    return half + back, half - back


def _stark(h: np.ndarray, b: np.ndarray, phi: np.ndarray) -> Directions:
    """The lengths of H along the surface and of B, and the azimuth between them. H is perpendicular to B."""
    z = np.sqrt(1 - b * b - h * h)
    theta = np.arctan2(-z, h * np.cos(phi))  # with the next line B_x h + B_z z = 0
    return _half_and_back(h, z, b[:, None] * _spherical(theta, phi))


def _neumann(h: np.ndarray, b: np.ndarray, phi: np.ndarray) -> Directions:
    """The lengths of H and of B along the surface, and the azimuth between them."""
    x, y = b * np.cos(phi), b * np.sin(phi)
    light, viewer = (np.stack([h + side * x, side * y], -1) for side in (1, -1))
    lengths = [np.sqrt(1 - np.square(one).sum(-1, keepdims=True)) for one in (light, viewer)]
    return np.concatenate([light, lengths[0]], -1), np.concatenate([viewer, lengths[1]], -1)


def _retro(theta_l: np.ndarray, x: np.ndarray, y: np.ndarray) -> Directions:
    """The angle between viewer and light as the length of a vector about the light, x towards the normal.

    With cos(theta_v) = cos(theta_l) cos(theta_vl) + sin(theta_l) sin(theta_vl) x / theta_vl.
    """
    theta, phi = np.hypot(x, y), np.arctan2(y, x)
    light = _spherical(theta_l, 0 * theta_l)
    towards = np.stack([-np.cos(theta_l), 0 * theta_l, np.sin(theta_l)], -1)
    across = np.stack([0 * theta_l, 1 + 0 * theta_l, 0 * theta_l], -1)
    turned = towards * np.cos(phi)[:, None] + across * np.sin(phi)[:, None]
    return light, light * np.cos(theta)[:, None] + turned * np.sin(theta)[:, None]


def _schlick(theta_l: np.ndarray, x: np.ndarray, y: np.ndarray) -> Directions:
    """The direction that is half between viewer and the mirrored light, by its angle from the normal."""
    light = _spherical(theta_l, 0 * theta_l)
    return light, _mirrored(light * np.array([-1, -1, 1]), _disk(x, y))


def _stereographic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    square = x * x + y * y
    found: np.ndarray = np.stack([2 * x, 2 * y, 1 - square], -1) / (1 + square)[:, None]
    return found


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.where(np.abs(length - 1) < _NOT_UNIT, vector / np.where(length > 0, length, 1), np.nan)


# How far lengths of unit vectors in a file may be off, by their digits.
_NOT_UNIT = 0.01


def _up(like: np.ndarray) -> np.ndarray:
    return np.stack([0 * like, 0 * like, 1 + 0 * like], -1)


def _with_right_angle(make: Callable[..., Directions]) -> Callable[[np.ndarray], Directions]:
    return lambda c: make(c[0], c[1], np.full_like(c[0], np.pi / 2))


PARAMETERS: Mapping[str, Parameters] = {
    "CARTESIAN": Parameters(6, (), (), lambda c: (_unit(c[3:].T), _unit(c[:3].T)), has_grain=True),
    "SPHERICAL_TL_PL_TV_PV": Parameters(
        4, (0, 2), (1, 3), lambda c: (_spherical(c[0], c[1]), _spherical(c[2], c[3])), has_grain=True
    ),
    "STEREOGRAPHIC": Parameters(
        4, (), (), lambda c: (_stereographic(c[2], c[3]), _stereographic(c[0], c[1])), has_grain=True
    ),
    "RUSIN_TH_PH_TD_PD": Parameters(4, (0, 2), (1, 3), lambda c: _rusinkiewicz(*c), has_grain=True),
    "RUSIN_TH_TD_PD": Parameters(3, (0, 1), (2,), lambda c: _rusinkiewicz(c[0], 0 * c[0], c[1], c[2])),
    "ISOTROPIC_TV_TL_DPHI": Parameters(3, (0, 1), (2,), lambda c: (_spherical(c[1], c[2]), _spherical(c[0], 0 * c[0]))),
    "ISOTROPIC_TL_TV_PROJ_DPHI": Parameters(
        3, (0, 1, 2), (), lambda c: (_spherical(c[0], 0 * c[0]), _disk(c[1], c[2]))
    ),
    "RETRO_TL_TVL_PROJ_DPHI": Parameters(3, (0, 1, 2), (), lambda c: _retro(*c)),
    "SCHLICK_TL_TK_PROJ_DPHI": Parameters(3, (0, 1, 2), (), lambda c: _schlick(*c)),
    "STARK_3D": Parameters(3, (), (2,), lambda c: _stark(*c)),
    "NEUMANN_3D": Parameters(3, (), (2,), lambda c: _neumann(*c)),
    "RUSIN_TH_PH_TD": Parameters(
        3,
        (0, 2),
        (1,),
        lambda c: _rusinkiewicz(c[0], c[1], c[2], np.full_like(c[0], np.pi / 2)),
        _PHI_D,
        has_grain=True,
    ),
    "RUSIN_TH_TD": Parameters(2, (0, 1), (), lambda c: _across(c[0], c[1]), _PHI_D),
    "COS_TH_TD": Parameters(2, (), (), lambda c: _across(np.arccos(c[0]), np.arccos(c[1])), _PHI_D),
    "STARK_2D": Parameters(2, (), (), _with_right_angle(_stark), _PHI_D),
    "NEUMANN_2D": Parameters(2, (), (), _with_right_angle(_neumann), _PHI_D),
    "RUSIN_VH": Parameters(
        3,
        (),
        (),
        lambda c: _same(_unit(c.T)),
        "only the half vector is given; light and viewer are both taken there",
        has_grain=True,
    ),
    "COS_TH": Parameters(
        1,
        (),
        (),
        lambda c: _same(_spherical(np.arccos(c[0]), 0 * c[0])),
        "only the half vector's angle is given; light and viewer are both taken there, theta_d = 0",
    ),
    "ISOTROPIC_TV_PROJ_DPHI": Parameters(2, (0, 1), (), lambda c: (_up(c[0]), _disk(c[0], c[1])), _AT_NORMAL),
    "COS_TLV": Parameters(1, (), (), lambda c: (_up(c[0]), _spherical(np.arccos(c[0]), 0 * c[0])), _AT_NORMAL),
    "COS_TLR": Parameters(1, (), (), lambda c: (_up(c[0]), _spherical(np.arccos(c[0]), 0 * c[0])), _AT_NORMAL),
}
"""By the names that files have."""
