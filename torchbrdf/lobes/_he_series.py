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
    """R(g, x), with its first derivatives by both, in any way of differentiating.

    Args:
        g: at least 0, `(..., N)`.
        x: at least 0, `(..., N)`.

    Returns:
        R, `(..., N)`, and 0 beside its first derivatives to all others.
    """
    with torch.no_grad():
        value, by_g, by_x = he_series_and_derivatives(g.detach(), x.detach())
    # The terms' own graph would be a hundred times as large.
    return value + by_g * (g - g.detach()) + by_x * (x - x.detach())


def he_series_and_derivatives(g: Tensor, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """R and its derivatives by g and by x."""
    g, x = torch.broadcast_tensors(g, x)
    g = g.clamp_min(torch.finfo(g.dtype).tiny)
    # log(m / g) = x / m^2 at the peak.
    peak = g * (lambert_w(2 * x / g.square().clamp_min(1e-30)) / 2).exp()
    far = (peak > FAR) & (g > 1)
    if not torch.compiler.is_compiling() and not bool(far.any()):
        value, by_g, by_x = _near(g, x)
    else:
        near = _near(torch.where(far, 1, g), torch.where(far, 0, x))
        beyond = _far(torch.where(far, g, FAR), torch.where(far, x, 0), torch.where(far, peak, FAR))
        value, by_g, by_x = (torch.where(far, b, a) for a, b in zip(near, beyond, strict=True))
    return value, by_g - value, by_x


def _near(g: Tensor, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """R, its derivative by g but for -R, and that by x, by the fixed nodes."""
    log_g = g.log()
    value, by_log, by_x = (torch.zeros_like(g) for _ in range(3))
    for m, log_term in _NEAR:
        term = clamped_exp((log_g * (m - 1)).sub_(g).add_(x, alpha=-1 / m).add_(log_term))
        value += term
        by_log.add_(term, alpha=m - 1)
        by_x.sub_(term, alpha=1 / m)
    return value, by_log / g, by_x


def _far(g: Tensor, x: Tensor, peak: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The same about a peak far from 0."""
    step = _STEP * (1 / peak + 2 * x / peak**3).rsqrt()
    value, by_log, by_x = (torch.zeros_like(g) for _ in range(3))
    for k in range(-_SIDE, _SIDE + 1):
        m = peak + k * step
        over = 1 / m
        # log(g^m exp(-g) / m!) by way of g - m, which is small beside either.
        apart = (g - m) * over
        stirling = over * (1 / 12 - over.square() * (1 / 360 - over.square() / 1260))
        term = clamped_exp(m * (torch.log1p(apart) - apart) - x * over - stirling) * over * over.sqrt()
        value += term
        by_log += (m - 1) * term
        by_x -= term * over
    scale = step / (math.sqrt(2 * math.pi) * g)
    return value * scale, by_log * scale / g, by_x * scale
