"""Absolute luminance, encoded so that equal steps are about equally visible: PQ and PU21."""

import torch
from torch import Tensor

from torchbrdf.errors import UsageError

# SMPTE ST 2084, table of constants; c_1 = c_3 - c_2 + 1.
_M1, _M2 = 2610 / 16384, 2523 / 32
_C2, _C3 = 2413 / 128, 2392 / 128
_C1 = _C3 - _C2 + 1
_PQ_PEAK = 10_000.0
# PU21, "banding + glare", p_1 ... p_7, and the least luminance that it was made for.
_PU = (0.353487901, 0.3734658629, 8.277049286e-05, 0.9062562627, 0.09150303166, 0.9099517204, 596.3148142)
_PU_LEAST = 0.005

HDR_WHITE = 203.0
"""Luminance of radiance 1, in cd/m^2, where nothing else is said: diffuse white of HDR pictures, ITU-R BT.2408."""
PQ_TOE = 1e-6
"""Up to here, in cd/m^2, `pq` is straight: far below what displays show or the eye sees, but of a finite slope."""


def pq(luminance: Tensor) -> Tensor:
    """The perceptual quantizer: luminance as HDR signals carry it, in [0, 1].

    ((c_1 + c_2 y) / (1 + c_3 y))^m_2, y = (L / 10000)^m_1. Its slope at black is infinite; below a millionth of a
    cd/m^2 a straight line to black takes its place, which differs by less than 3e-5.

    Args:
        luminance: in cd/m^2, any shape; below 0 counts as 0, and there is no end at 10,000.

    Returns:
        The shape of `luminance`.

    Source: SMPTE ST 2084:2014; ITU-R BT.2100-2, table 4.

    Example:
        >>> import torch
        >>> from torchbrdf.images import pq
        >>> pq(torch.tensor([0.0, 100.0, 10000.0]))
        tensor([7.3096e-07, 5.0808e-01, 1.0000e+00])
    """
    luminance = luminance.clamp_min(0)
    toe = luminance < PQ_TOE
    return torch.where(toe, _PQ_BLACK + _PQ_TOE_SLOPE * luminance, _pq(torch.where(toe, PQ_TOE, luminance)))


def _pq(luminance: Tensor) -> Tensor:
    """By the logarithm of the quotient, as 1 - (1 - c_1) (1 - y) / (1 + c_3 y): the power of 79 keeps its digits."""
    y = (luminance / _PQ_PEAK).pow(_M1)
    return (_M2 * ((_C1 - 1) * (1 - y) / (1 + _C3 * y)).log1p()).exp()


_PQ_BLACK, _PQ_END = _pq(torch.tensor([0.0, PQ_TOE], dtype=torch.float64, device="cpu")).tolist()
_PQ_TOE_SLOPE = (_PQ_END - _PQ_BLACK) / PQ_TOE


def pu21(luminance: Tensor) -> Tensor:
    """PU21: luminance on a scale for differences that were made for SDR; 100 cd/m^2 is 256, 10,000 cd/m^2 is 595.

    p_7 (((p_1 + p_2 L^p_4) / (1 + p_3 L^p_4))^p_5 - p_6), by sensitivity to banding, with glare. Below 0.005 cd/m^2,
    where the source has none, its tangent there takes its place: black is then -0.4.

    Args:
        luminance: in cd/m^2, any shape; below 0 counts as 0.

    Returns:
        The shape of `luminance`.

    Source: R. Mantiuk, M. Azimi, PU21: A Novel Perceptually Uniform Encoding for Adapting Existing Quality Metrics for
    HDR, 2021, doi:10.1109/PCS50896.2021.9477471; constants of the authors' program.

    Example:
        >>> import torch
        >>> from torchbrdf.images import pu21
        >>> pu21(torch.tensor([0.005, 100.0, 10000.0]))
        tensor([-3.5543e-05,  2.5638e+02,  5.9539e+02])
    """
    luminance = luminance.clamp_min(0)
    below = luminance < _PU_LEAST
    tangent = _PU_START + _PU_SLOPE * (luminance - _PU_LEAST)
    return torch.where(below, tangent, _pu21(torch.where(below, _PU_LEAST, luminance)))


def _pu21(luminance: Tensor) -> Tensor:
    p1, p2, p3, p4, p5, p6, p7 = _PU
    power = luminance.pow(p4)
    return p7 * (((p1 + p2 * power) / (1 + p3 * power)).pow(p5) - p6)


def _pu21_start() -> tuple[float, float]:
    """PU21 and its slope at the least luminance."""
    p1, p2, p3, p4, p5, p6, p7 = _PU
    power = _PU_LEAST**p4
    above, under = p1 + p2 * power, 1 + p3 * power
    value = (above / under) ** p5
    return p7 * (value - p6), p7 * p5 * value * (p2 / above - p3 / under) * p4 * power / _PU_LEAST


_PU_START, _PU_SLOPE = _pu21_start()


def check_luminance(owner: object, name: str, value: float) -> float:
    """A luminance in cd/m^2 that is given as a setting.

    Args:
        owner: whose setting.
        name: of the setting.
        value: the luminance.

    Returns:
        The value.

    Raises:
        UsageError: it is not above 0, or is above the 10,000 where PQ ends.
    """
    if not 0 < value <= _PQ_PEAK:
        found = f"expected {name} in cd/m^2, above 0 and at most {_PQ_PEAK:g}, found {value}"
        raise UsageError(f"{type(owner).__name__}: {found}")
    return value
