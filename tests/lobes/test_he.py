"""He's series against all of its terms, and his lobe where waves no longer matter."""

import math

import mpmath
import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from mpmath import mpf

from torchbrdf.lobes import dielectric, he, ward
from torchbrdf.lobes._he_series import he_series, lambert_w
from torchbrdf.pairs import Pairs


def exact(g: float, x: float, width: int = 16) -> mpf:
    """All terms that count, with 30 digits."""
    with mpmath.workdps(30):
        height, far = mpf(g), mpf(x)
        peak = height * mpmath.exp(mpmath.lambertw(2 * far / height**2).real / 2)
        spread = 1 / mpmath.sqrt(1 / peak + 2 * far / peak**3)
        terms = range(max(1, int(peak - width * spread)), int(peak + width * spread + 60))
        return mpmath.fsum(
            mpmath.exp((m - 1) * mpmath.log(height) - height - far / m - mpmath.loggamma(m + 1)) / m for m in terms
        )


def without_phase(g: float) -> mpf:
    """The sum for x = 0, which is the largest."""
    with mpmath.workdps(30):
        return mpmath.exp(-mpf(g)) * (mpmath.ei(g) - mpmath.log(g) - mpmath.euler) / g


def test_the_sum_without_phase() -> None:
    for g in (1e-8, 0.3, 20.0, 9000.0):
        assert float(without_phase(g)) == pytest.approx(float(exact(g, 0.0)), rel=1e-12)


@given(
    log_g=st.floats(math.log(1e-8), math.log(16_000)),
    x=st.one_of(st.just(0.0), st.floats(-3, 6).map(math.exp)),
    scaled=st.booleans(),
)
@settings(max_examples=150)
def test_the_series_is_all_of_it(log_g: float, x: float, scaled: bool) -> None:
    """For surfaces from smooth to rough, where 64 terms are nothing; 1e-12 relative in float64, 1e-4 in float32."""
    g = math.exp(log_g)
    x = x * g if scaled else x
    expected = exact(g, x)
    assume(expected > without_phase(g) * mpf(1e-25))
    for dtype, tolerance in ((torch.float64, 2e-12), (torch.float32, 1e-4)):
        found = he_series(torch.tensor([g], dtype=dtype), torch.tensor([x], dtype=dtype)).item()
        assert found == pytest.approx(float(expected), rel=tolerance, abs=1e-35)


def test_the_series_from_smooth_to_infinitely_rough() -> None:
    """exp(-x) of a smooth surface; finite, with finite derivatives, whatever the height."""
    for dtype in (torch.float32, torch.float64):
        g = torch.tensor([0.0, 1e-30, 1e-3, 1, 1e3, 1e6, 1e9, 1e12], dtype=dtype)
        g, x = (value.requires_grad_() for value in torch.cartesian_prod(g, g).unbind(-1))
        found = he_series(g, x)
        assert found.isfinite().all() and (found >= 0).all()
        assert all(slope.isfinite().all() for slope in torch.autograd.grad(found.sum(), (g, x)))
        torch.testing.assert_close(found[:8], (-x[:8]).exp(), rtol=1e-6, atol=1e-30)


def test_derivatives_of_the_series() -> None:
    g = torch.tensor([1e-3, 0.5, 5.0, 50.0, 70.0, 900.0], dtype=torch.float64, requires_grad=True)
    x = torch.tensor([0.1, 2.0, 9.0, 30.0, 0.0, 2000.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(he_series, (g, x), check_forward_ad=True)
    assert torch.autograd.gradgradcheck(he_series, (g, x))


def test_lambert_w() -> None:
    z = torch.tensor([0.0, 1e-300, 1e-8, 0.3, 1.0, 50.0, 1e10, 1e30], dtype=torch.float64)
    w = lambert_w(z)
    torch.testing.assert_close(w, torch.tensor([float(mpmath.lambertw(one).real) for one in z.tolist()]).double())
    assert w[0] == 0 and torch.autograd.gradcheck(lambert_w, (z[3:6].requires_grad_(),))


def test_a_rough_surface_is_beckmanns() -> None:
    """Where heights are many wavelengths only m = 2 sigma_0 / tau matters: F D / (4 cos_i cos_o) away from shadows."""
    angle = torch.linspace(0, 0.1, 20, dtype=torch.float64)
    pairs, m = Pairs.from_half_diff(angle, 0.5 * torch.ones_like(angle), angle), 0.05
    values = torch.tensor([[40.0], [80 / m], [1.5]], dtype=torch.float64)
    found = he(pairs, torch.ones(1, dtype=torch.float64), *values)[:, 0]
    d = (-pairs.tan2_h / m**2).exp() / (math.pi * m**2 * pairs.cos_h**4)
    expected = dielectric(values[2], pairs.cos_d) * d / (4 * pairs.cos_i * pairs.cos_o)
    torch.testing.assert_close(found, expected, rtol=2e-3, atol=0)
    # Ward's lobe has the same m.
    other = ward(pairs, torch.ones(1, dtype=torch.float64), torch.tensor([m], dtype=torch.float64))[:, 0]
    torch.testing.assert_close(found / found[0], other / other[0], rtol=0.05, atol=1e-3)


@pytest.mark.parametrize("roughness", [0.01, 0.1, 0.5])
def test_what_a_rougher_surface_does_not_mirror(roughness: float) -> None:
    """Light from the normal that is scattered is 1 - exp(-g) where F is 1 and nothing is in shadow."""
    theta, weight = (torch.from_numpy(x) for x in np.polynomial.legendre.leggauss(2000))
    theta, weight = (theta + 1) * 0.1, weight * 0.1
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand(2000, 3)
    wo = torch.stack([theta.sin(), torch.zeros_like(theta), theta.cos()], -1)
    values = torch.tensor([[roughness], [150.0], [1e6]], dtype=torch.float64)
    share = he(Pairs.from_directions(up, wo), torch.ones(1, dtype=torch.float64), *values)[:, 0]
    share = (share * theta.cos() * theta.sin() * weight).sum().item() * 2 * math.pi
    assert share == pytest.approx(1 - math.exp(-((4 * math.pi * roughness) ** 2)), rel=1e-3)
