"""The series of He's model, for any height of the surface: R(g, x) = exp(-g) sum_m g^(m - 1) exp(-x / m) / (m! m).

Its terms are large about a single m, the peak; where that is far from 0 there may be thousands of them, and 64 of the
original programs were not enough. As they are smooth in m, far fewer do, which is a sum by a wider step:

- Up to a peak of `FAR` at the m of `_NEAR`, which are 1, 2, 3, ... at first and lie wider and wider: m(y) is 1 + y +
  c y^12, which is 1 + y at its beginning up to the eleventh derivative, so that the sum of m'(y) times the terms is
  that of all terms (Euler and Maclaurin).
- Beyond, in steps of about a width of the peak to either side of it (the trapezoidal rule, whose error is exp(-2 pi^2 /
  step^2)); m! then is Stirling's.

The relative error is below 1e-12 where R is above 1e-25 of R(g, 0) (tests/lobes/test_he.py).
"""

import math

import torch
from torch import Tensor

from torchbrdf.lobes._microfacet import clamped_exp

# The peak up to which the fixed nodes are used, and the largest of these.
FAR = 64.0
_LAST = 150.0
_COUNT = 72
# Steps to either side of a far peak, in widths of it; 11 of them, so that what is left out is exp(-30).
_STEP, _SIDE = 0.72, 11

_GROWTH = (_LAST - _COUNT) / (_COUNT - 1) ** 12


def _node(y: int) -> tuple[float, float]:
    """m(y), and log of m'(y) / (m! m)."""
    m = 1 + y + _GROWTH * y**12
    return m, math.log1p(12 * _GROWTH * y**11) - math.lgamma(m + 1) - math.log(m)


_NEAR = [_node(y) for y in range(_COUNT)]


def lambert_w(z: Tensor) -> Tensor:
    """The w with w exp(w) = z, for z of at least 0, with its derivatives.

    By Halley's steps from w = log(1 + z), which needs four of them.
    """
    w = torch.log1p(z)
    w = w * (1 - torch.log1p(w) / (2 + w))
    for _ in range(4):
        rest = w - z * (-w).exp()
        w = w - rest / (1 + w - (w + 2) * rest / (2 * w + 2))
    return w


def he_series(g: Tensor, x: Tensor) -> Tensor:
    """R(g, x), with its first and second derivatives by both, in any way of differentiating.

    Args:
        g: at least 0, `(..., N)`.
        x: at least 0, `(..., N)`.

    Returns:
        R, `(..., N)`.
    """
    with torch.no_grad():
        value, more, most, less, least, both = _sums(g.detach(), x.detach())
        by_g, by_x, by_gg, by_both = more - value, -less, most - 2 * more + value, less - both
    # The graph of all the terms would be a hundred times as large as that of Taylor's polynomial.
    dg, dx = g - g.detach(), x - x.detach()
    first = value + by_g * dg + by_x * dx
    return first + 0.5 * by_gg * dg.square() + by_both * (dg * dx) + 0.5 * least * dx.square()


def he_series_and_derivatives(g: Tensor, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """R and its derivatives by g and by x."""
    value, more, _, less, _, _ = _sums(g, x)
    return value, more - value, -less


Sums = tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]


def _sums(g: Tensor, x: Tensor) -> Sums:
    """The sums of the terms times 1, (m - 1) / g, (m - 1) (m - 2) / g^2, 1 / m, 1 / m^2, and (m - 1) / (g m)."""
    g, x = torch.broadcast_tensors(g, x)
    g = g.clamp_min(_least(g))
    # log(m / g) = x / m^2 at the peak.
    peak = g * (lambert_w(2 * x / g.square()) / 2).exp()
    far = (peak > FAR) & (g > 1)
    if not torch.compiler.is_compiling() and not bool(far.any()):
        return _near(g, x)
    near = _near(torch.where(far, 1, g), torch.where(far, 0, x))
    beyond = _far(torch.where(far, g, FAR), torch.where(far, x, 0), torch.where(far, peak, FAR))
    value, more, most, less, least, both = (torch.where(far, b, a) for a, b in zip(near, beyond, strict=True))
    return value, more, most, less, least, both


def _least(g: Tensor) -> float:
    """A g so small that R is exp(-x), whose square is a normal number."""
    return torch.finfo(g.dtype).tiny ** 0.4


def _near(g: Tensor, x: Tensor) -> Sums:
    """The sums by the fixed nodes."""
    log_g = g.log()
    value, more, most, less, least, both = (torch.zeros_like(g) for _ in range(6))
    for m, log_term in _NEAR:
        term = clamped_exp((log_g * (m - 1)).sub_(g).add_(x, alpha=-1 / m).add_(log_term))
        value += term
        more.add_(term, alpha=m - 1)
        most.add_(term, alpha=(m - 1) * (m - 2))
        less.add_(term, alpha=1 / m)
        least.add_(term, alpha=1 / m**2)
        both.add_(term, alpha=(m - 1) / m)
    return value, more / g, most / g.square(), less, least, both / g


def _far(g: Tensor, x: Tensor, peak: Tensor) -> Sums:
    """The sums about a peak far from 0."""
    step = _STEP * (1 / peak + 2 * x / peak**3).rsqrt()
    value, more, most, less, least, both = (torch.zeros_like(g) for _ in range(6))
    for k in range(-_SIDE, _SIDE + 1):
        m = peak + k * step
        over = 1 / m
        # log(g^m exp(-g) / m!) by way of g - m, which is small beside either.
        apart = (g - m) * over
        stirling = over * (1 / 12 - over.square() * (1 / 360 - over.square() / 1260))
        term = clamped_exp(m * (torch.log1p(apart) - apart) - x * over - stirling) * over * over.sqrt()
        share = (m - 1) / g * term
        value += term
        more += share
        most += (m - 2) / g * share
        less += term * over
        least += term * over.square()
        both += share * over
    scale = step / (math.sqrt(2 * math.pi) * g)
    return value * scale, more * scale, most * scale, less * scale, least * scale, both * scale
