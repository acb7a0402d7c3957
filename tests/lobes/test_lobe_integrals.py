"""Lobes' integrals: albedos, normalized distributions, energy, shadowing."""

import math
from collections.abc import Callable
from itertools import pairwise

import mpmath
import numpy as np
import pytest
import torch
from helpers.exact_lobes import Geometry, correlated, mp, student_t_lambda
from helpers.lobe_cases import evaluate, values_at
from mpmath import mpf
from torch import Tensor

from torchbrdf.lobes import (
    abc,
    ashikhmin_shirley,
    beckmann,
    blinn_phong,
    cook_torrance,
    eon,
    ggx,
    gtr,
    lafortune,
    lambert,
    shifted_gamma,
    student_t,
    ward,
    ward_duer,
)
from torchbrdf.pairs import Pairs


def integral(integrand: Callable[[Tensor], Tensor], edges: list[float], count: int = 200) -> float:
    """By Gauss' rule with so many nodes on every piece."""
    nodes, weight = (torch.from_numpy(x) for x in np.polynomial.legendre.leggauss(count))
    pieces = ((integrand((a + b) / 2 + (b - a) / 2 * nodes) * weight).sum() * (b - a) / 2 for a, b in pairwise(edges))
    return float(sum(pieces))


def albedo(function: Callable[..., Tensor], width: float, *values: float) -> float:
    """The share of light from the normal that is reflected; rotational symmetry leaves one integral."""

    def integrand(theta: Tensor) -> Tensor:
        return 2 * math.pi * values_at(function, 0.0, theta, 0.0, *values) * theta.cos() * theta.sin()

    return integral(integrand, [0, min(2 * width, 1.0), min(8 * width, 1.4), math.pi / 2])


def test_lambert_reflects_its_albedo() -> None:
    assert albedo(lambert, 0.5, 0.7) == pytest.approx(0.7, rel=1e-9)


@pytest.mark.parametrize("roughness", [0.003, 0.03, 0.1])
def test_ward_reflects_its_albedo_when_sharp(roughness: float) -> None:
    """With t = tan(theta_h) the albedo at the normal is the mean of 1 - 3 t^2 + ... over exp(-t^2 / alpha^2)."""
    expected = 0.7 * (1 - 3 * roughness**2)
    assert albedo(ward, roughness, 0.7, roughness) == pytest.approx(expected, rel=20 * roughness**4 + 1e-8)


@pytest.mark.parametrize("exponent", [200.0, 2000.0, 20000.0])
def test_ashikhmin_shirley_reflects_albedo_and_fresnel_when_sharp(exponent: float) -> None:
    """At the normal the integral of eq. 2 is (m - 1) / (m + 3) F0, but for grazing light."""
    expected = 0.7 * 0.4 * (exponent - 1) / (exponent + 3)
    assert albedo(ashikhmin_shirley, exponent**-0.5, 0.7, exponent, 0.4) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("roughness", [0.003, 0.1, 0.5, 1.0])
def test_beckmann_of_the_paper_lacks_the_one_over_pi(roughness: float) -> None:
    """Eq. 5 integrates to pi over the projected hemisphere: its 1/pi is the one in front of eq. 4.

    Against light and viewer in the half vector's direction F is F0 and G of eq. 6 is min(1, 2 cos_h^2).
    """

    def d_cosine(theta: Tensor) -> Tensor:
        cos = theta.cos()
        value = values_at(cook_torrance, theta, theta, 0.0, 1.0, roughness, 0.5)
        d = value * math.pi * cos * cos / (0.5 * (2 * cos * cos).clamp_max(1))
        return 2 * math.pi * d * cos * theta.sin()

    total = integral(d_cosine, [0, min(4 * roughness, 0.7), math.pi / 2])
    assert total == pytest.approx(math.pi, rel=1e-6)


@pytest.mark.parametrize("exponent", [0.5, 10.0, 1000.0, 100_000.0])
def test_blinn_phong_is_normalized_over_half_vectors(exponent: float) -> None:
    """Ngan's factor: the lobe times cos_h integrates to the albedo over the half vectors, at any exponent."""

    def integrand(theta: Tensor) -> Tensor:
        return 2 * math.pi * values_at(blinn_phong, theta, theta, 0.0, 0.7, exponent) * theta.cos() * theta.sin()

    total = integral(integrand, [0, min(4 / math.sqrt(exponent), 1.0), math.pi / 2])
    assert total == pytest.approx(0.7, rel=1e-8)


@pytest.mark.parametrize(("alpha", "p"), [(0.001, 0.0), (0.02, 0.5), (0.1, 1.0), (0.5, 1.7)])
def test_shifted_gamma_is_normalized_by_an_incomplete_gamma_function(alpha: float, p: float) -> None:
    """With K = 1 / (alpha Gamma(1 - p, alpha)) the distribution times cos_h integrates to 1."""
    k = 1 / (alpha * float(mpmath.gammainc(1 - p, alpha)))
    # Neither shadow nor Fresnel: F is F0 + (1 - F0) 0, as light and viewer are in the half vector's direction.
    rest = (1.0, alpha, p, k, 1.0, 0.0, 1e-8, 2.5, 1000.0, 1.25)

    def d_cosine(theta: Tensor) -> Tensor:
        d = values_at(shifted_gamma, theta, theta, 0.0, *rest) * math.pi * theta.cos().square()
        return 2 * math.pi * d * theta.cos() * theta.sin()

    edges = [0, math.atan(alpha), math.atan(8 * alpha), math.pi / 2 - 1e-6]
    assert integral(d_cosine, edges) == pytest.approx(1, rel=1e-6)


@pytest.mark.parametrize(("sharpness", "exponent"), [(10.0, 0.5), (1e3, 1.2), (1e5, 2.5)])
def test_abc_integrates_to_its_closed_form(sharpness: float, exponent: float) -> None:
    """Over solid angle the distribution is 2 pi ((1 + B)^(1 - C) - 1) / (B (1 - C))."""

    def distribution(theta: Tensor) -> Tensor:
        cos = theta.cos()
        value = values_at(abc, theta, theta, 0.0, 1.0, sharpness, exponent, 1.5)
        d = value * math.pi * cos * cos / (0.04 * (2 * cos * cos).clamp_max(1))  # F is ((n - 1) / (n + 1))^2
        return 2 * math.pi * d * theta.sin()

    total = integral(distribution, [0, 2 / math.sqrt(sharpness), math.pi / 4, math.pi / 2])
    closed = 2 * math.pi * ((1 + sharpness) ** (1 - exponent) - 1) / (sharpness * (1 - exponent))
    assert total == pytest.approx(closed, rel=1e-6)


def d_cosine(
    function: Callable[..., Tensor], visible: Callable[[Tensor], Tensor], *values: float, count: int = 200
) -> float:
    """The integral of D cos_h over half vectors, of a lobe whose G / (4 cos_i cos_o) is known where wi = wo = h."""

    def integrand(tangent: Tensor) -> Tensor:
        theta = tangent.atan()
        d = values_at(function, theta, theta, 0.0, 1.0, *values) / visible(theta.cos())
        return 2 * math.pi * d * theta.sin() * theta.cos() ** 3

    return integral(integrand, [0, *(values[0] * 10.0**k for k in range(-1, 8))], count)


@pytest.mark.parametrize("roughness", [0.01, 0.1, 0.5, 1.0])
def test_ggx_and_its_kin_are_normalized(roughness: float) -> None:
    def of_ggx(cos: Tensor) -> Tensor:
        return 0.25 / (cos * (roughness**2 + (1 - roughness**2) * cos**2).sqrt())

    def of_beckmann(cos: Tensor) -> Tensor:
        v = cos / (roughness * (1 - cos**2).sqrt())
        twice = (-(v**2)).exp() / (v * math.sqrt(math.pi)) - v.erfc()
        return 0.25 / (cos**2 * (1 + twice))

    assert d_cosine(ggx, of_ggx, roughness, 1.0) == pytest.approx(1, rel=1e-6)
    assert d_cosine(beckmann, of_beckmann, roughness, 1.0) == pytest.approx(1, rel=1e-6)
    for exponent in (1.0, 1.5, 2.0, 5.0):
        assert d_cosine(gtr, of_ggx, roughness, exponent, 1.0) == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize("theta", [0.0, 0.5, 1.0, 1.4, 1.55])
def test_ward_duer_never_reflects_more_than_its_albedo(theta: float) -> None:
    """Where Ward's own lobe reflects more and more towards grazing directions."""
    cos_o, phi = torch.meshgrid(
        (torch.arange(800, dtype=torch.float64) + 0.5) / 800,
        (torch.arange(800, dtype=torch.float64) + 0.5) / 800 * math.pi,
        indexing="ij",
    )
    sin_o = (1 - cos_o.square()).sqrt()
    wo = torch.stack([sin_o * phi.cos(), sin_o * phi.sin(), cos_o], -1).reshape(-1, 3)
    wi = torch.tensor([[math.sin(theta), 0.0, math.cos(theta)]], dtype=torch.float64).expand_as(wo)
    pairs, one = Pairs.from_directions(wi, wo), torch.ones(1, dtype=torch.float64)
    share = (ward_duer(pairs, one, 0.2 * one)[:, 0] * wo[:, 2]).mean().item() * 2 * math.pi
    assert 0.5 < share < 1.005
    if theta == 0:
        assert share == pytest.approx(
            (ward(pairs, one, 0.2 * one)[:, 0] * wo[:, 2]).mean().item() * 2 * math.pi, rel=0.2
        )


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("theta", [0.0, 0.7, 1.3, 1.5])
def test_eon_keeps_all_energy(roughness: float, theta: float) -> None:
    """A white one reflects all light from any direction; the albedo of a grey one is below its parameter."""
    cos_o, weight = (torch.from_numpy(x) for x in np.polynomial.legendre.leggauss(200))
    cos_o, weight = (cos_o + 1) / 2, weight / 2
    phi = (torch.arange(400, dtype=torch.float64) + 0.5) / 400 * math.pi
    cos_o, phi, weight = (
        x.flatten() for x in (cos_o[:, None] + 0 * phi, phi + 0 * cos_o[:, None], weight[:, None] + 0 * phi)
    )
    sin_o = (1 - cos_o.square()).sqrt()
    wo = torch.stack([sin_o * phi.cos(), sin_o * phi.sin(), cos_o], -1)
    wi = torch.tensor([[math.sin(theta), 0.0, math.cos(theta)]], dtype=torch.float64).expand_as(wo)
    pairs, one = Pairs.from_directions(wi, wo), torch.ones(1, dtype=torch.float64)

    def share(rho: float) -> float:
        value = eon(pairs, rho * one, roughness * one)[:, 0]
        return (value * cos_o * weight).sum().item() * 2 * math.pi / 400

    assert share(1.0) == pytest.approx(1, rel=2e-4)
    assert share(0.5) <= 0.5 + 1e-4


@pytest.mark.parametrize("exponent", [1.6, 2.5, 12.0])
def test_shadowing_of_student_t_by_integration(exponent: float) -> None:
    """Lambda is the mean of (p - mu) / mu over slopes p beyond mu = cot(theta), as Smith has it."""
    sigma, theta_i, theta_o, phi = 0.4, 1.2, 0.7, 0.5

    def density(p: mpf) -> mpf:
        """Of one slope: the other one integrated out."""
        scale = (exponent - 1) * sigma**2
        alone = mpmath.beta(exponent - 0.5, 0.5) * (1 + p**2 / scale) ** (0.5 - exponent) * mpmath.sqrt(scale)
        return alone / (mpmath.pi * sigma**2)

    def slope(tangent: mpf) -> mpf:
        mu = 1 / tangent
        steps = [*range(-30, 10, 4), *range(10, 400, 40)]  # of log(p - mu)
        return mpmath.quad(lambda t: mpmath.exp(2 * t) * density(mu + mpmath.exp(t)), steps) / mu

    wi = [math.sin(theta_i), 0.0, math.cos(theta_i)]
    wo = [math.sin(theta_o) * math.cos(phi), math.sin(theta_o) * math.sin(phi), math.cos(theta_o)]
    g = Geometry(mp(wi), mp(wo))
    d = (1 + mpmath.tan(g.delta) ** 2 / ((exponent - 1) * sigma**2)) ** -exponent / (mpmath.pi * sigma**2 * g.n_h**4)
    found = evaluate(student_t, theta_i, theta_o, phi, 1.0, sigma, exponent, 1.0)
    assert found == pytest.approx(float(d * correlated(g, slope)), rel=1e-9)


@pytest.mark.parametrize("exponent", [1.6, 2.0, 5.0, 40.0])
def test_student_t_is_normalized(exponent: float) -> None:
    """D cos_h integrates to 1 over the half vectors; where wi = wo = h the shadowing is known from the exact Lambda."""

    def visible(cos: Tensor) -> Tensor:
        tangents = ((1 - cos**2).sqrt() / cos).tolist()
        slope = [float(student_t_lambda(mpf(0.3), mpf(exponent))(mpf(tangent))) for tangent in tangents]
        return 0.25 / (cos**2 * (1 + 2 * torch.tensor(slope, dtype=torch.float64)))

    assert d_cosine(student_t, visible, 0.3, exponent, 1.0, count=20) == pytest.approx(1, rel=2e-4)


@pytest.mark.parametrize("exponent", [2.0, 40.0, 5000.0])
def test_lafortune_of_the_mirror_direction_is_phong(exponent: float) -> None:
    """With C_z = 1 it is a power of the cosine between wo and wi mirrored, which (n + 2) / (2 pi) normalizes."""
    theta_i, theta_o, phi = 0.6, 0.63, 3.0
    wi = np.array([math.sin(theta_i), 0, math.cos(theta_i)])
    wo = np.array([math.sin(theta_o) * math.cos(phi), math.sin(theta_o) * math.sin(phi), math.cos(theta_o)])
    cosine = float(wi @ (wo * [-1, -1, 1]))
    found = evaluate(lafortune, theta_i, theta_o, phi, 0.7, 1.0, exponent)
    assert found == pytest.approx(0.7 * (exponent + 2) / (2 * math.pi) * cosine**exponent, rel=1e-11)
    assert albedo(lafortune, exponent**-0.5, 0.7, 1.0, exponent) == pytest.approx(0.7, rel=1e-7)
