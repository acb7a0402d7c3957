"""The lobes' values against independent evaluations: the paper's formulas with 50 digits, integrals, Mitsuba."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np
import pytest
import torch
from helpers.directions import from_half_diff
from helpers.exact_lobes import Geometry, decades
from helpers.exact_materials import EXACT
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from mpmath import mpf
from scipy import integrate

from torchbrdf.lobes import (
    LOBES,
    abc,
    ashikhmin_shirley,
    beckmann,
    blinn_phong,
    cook_torrance,
    dielectric,
    distribution_based,
    eon,
    ggx,
    gtr,
    lambert,
    schlick,
    shifted_gamma,
    ward,
    ward_duer,
)
from torchbrdf.pairs import Pairs


def test_every_lobe_has_a_formula_here() -> None:
    assert set(EXACT) == set(LOBES), "give a new lobe an independent formula in EXACT"


def mp(x: Any) -> Any:
    return [mp(value) for value in x] if isinstance(x, list) else mpf(x)


@pytest.mark.parametrize("name", EXACT)
@given(data=st.data())
@settings(max_examples=60)
def test_closed_form(name: str, data: st.DataObject) -> None:
    """1e-12 relative, at any directions and in the highlight of the sharpest lobes."""
    theta_h = data.draw(st.one_of(st.floats(0, 1.5), decades(1e-6, 0.5)), "theta_h")
    theta_d, phi_d, phi_h = data.draw(st.tuples(st.floats(0, 1.55), *[st.floats(-math.pi, math.pi)] * 2), "angles")
    wi, wo = from_half_diff(*(np.array(x) for x in (theta_h, theta_d, phi_d, phi_h)))
    assume(min(wi[2], wo[2]) > 1e-9)
    formula, strategies = EXACT[name]
    drawn = [data.draw(strategy) for strategy in strategies]
    parameters = []
    for value, spec in zip(drawn, LOBES[name].parameter_specs.values(), strict=True):
        tensor = torch.tensor(value, dtype=torch.float64)
        parameters.append(tensor.reshape(*spec.shape[:-1], 1).expand(spec.shape))
    pairs = Pairs.from_directions(torch.from_numpy(wi)[None], torch.from_numpy(wo)[None])
    found = LOBES[name].function(pairs, *parameters)
    assert found.shape == (1, 3)
    with mpmath.workdps(50):
        expected = float(formula(Geometry(mp(wi.tolist()), mp(wo.tolist())), *map(mp, drawn)))
    for value in found[0].tolist():
        assert value == pytest.approx(expected, rel=1e-12, abs=1e-290)


def test_every_channel_has_its_own_albedo() -> None:
    pairs = Pairs.from_half_diff(*torch.full((3, 1), 0.2, dtype=torch.float64))
    colour, one = torch.tensor([0.1, 0.2, 0.7], dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    for function, rest in [(lambert, 0), (ward, 1), (cook_torrance, 2), (ashikhmin_shirley, 2)]:
        value = function(pairs, colour, *[0.3 * one] * rest)[0]
        torch.testing.assert_close(value / value.sum(), colour)
    for function, rest in [(blinn_phong, 1), (abc, 3)]:
        value = function(pairs, colour, *[1.3 * one] * rest)[0]
        torch.testing.assert_close(value / value.sum(), colour)
    nodes = torch.arange(1.0, 6, dtype=torch.float64)[:, None] * colour
    value = distribution_based(pairs, nodes, 0.3 * one)[0]
    torch.testing.assert_close(value / value.sum(), colour)


def test_shifted_gamma_has_parameters_of_its_own_for_each_channel() -> None:
    """Each channel is the lobe of that channel's numbers, and of no other's."""
    pairs = Pairs.from_half_diff(*torch.tensor([[0.2], [1.1], [0.3]], dtype=torch.float64))
    specs = LOBES["shifted_gamma"].parameter_specs.values()
    rising = torch.linspace(0.9, 1.1, 3, dtype=torch.float64)
    values = [torch.tensor(spec.start or 0.1, dtype=torch.float64) * rising for spec in specs]
    found = shifted_gamma(pairs, *values)[0]
    for channel in range(3):
        alone = shifted_gamma(pairs, *(value[channel : channel + 1] for value in values))[0]
        torch.testing.assert_close(alone, found[channel : channel + 1], rtol=1e-14, atol=0)
    assert len(set(found.tolist())) == 3


def test_table_1() -> None:
    """The paper's starting values and bounds."""
    table = {
        ("ward", "specular"): (0.5, 0, 1),
        ("ward", "roughness"): (0.01, 0.001, 0.5),
        ("cook_torrance", "specular"): (0.5, 0, 1),
        ("cook_torrance", "roughness"): (0.02, 0.001, 1),
        ("cook_torrance", "f0"): (0.3, 0.02, 1),
        ("ashikhmin_shirley", "specular"): (0.5, 0, 1),
        ("ashikhmin_shirley", "exponent"): (5, 0.001, 50000),
        ("ashikhmin_shirley", "f0"): (0.3, 0.02, 1),
    }
    found = {
        (lobe, name): (b.start, b.lower, b.upper)
        for lobe in ("ward", "cook_torrance", "ashikhmin_shirley")
        for name, b in LOBES[lobe].parameter_specs.items()
    }
    assert found == table
    albedo = LOBES["lambert"].parameter_specs["albedo"]
    assert (albedo.lower, albedo.upper) == (0, 1)


def evaluate(
    function: Callable[..., torch.Tensor], theta_i: float, theta_o: float, phi: float, *values: float
) -> float:
    wi = torch.tensor([[math.sin(theta_i), 0, math.cos(theta_i)]], dtype=torch.float64)
    sin_o = math.sin(theta_o)
    wo = torch.tensor([[sin_o * math.cos(phi), sin_o * math.sin(phi), math.cos(theta_o)]], dtype=torch.float64)
    parameters = [torch.tensor([value], dtype=torch.float64) for value in values]
    return function(Pairs.from_directions(wi, wo), *parameters)[0, 0].item()


def albedo(function: Callable[..., torch.Tensor], width: float, *values: float) -> float:
    """The share of light from the normal that is reflected; rotational symmetry leaves one integral."""

    def integrand(theta: float) -> float:
        return 2 * math.pi * evaluate(function, 0.0, theta, 0.0, *values) * math.cos(theta) * math.sin(theta)

    edges = [0, min(2 * width, 1.0), min(8 * width, 1.4), math.pi / 2]
    return sum(integrate.quad(integrand, a, b, epsrel=1e-8)[0] for a, b in pairwise(edges))


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

    def d_cosine(theta: float) -> float:
        cos = math.cos(theta)
        value = evaluate(cook_torrance, theta, theta, 0.0, 1.0, roughness, 0.5)
        d = value * math.pi * cos * cos / (0.5 * min(1.0, 2 * cos * cos))
        return 2 * math.pi * d * cos * math.sin(theta)

    edges = [0, min(4 * roughness, 0.7), math.pi / 2]
    total = sum(integrate.quad(d_cosine, a, b, epsrel=1e-8)[0] for a, b in pairwise(edges))
    assert total == pytest.approx(math.pi, rel=1e-6)


@pytest.mark.parametrize("exponent", [0.5, 10.0, 1000.0, 100_000.0])
def test_blinn_phong_is_normalized_over_half_vectors(exponent: float) -> None:
    """Ngan's factor: the lobe times cos_h integrates to the albedo over the half vectors, at any exponent."""

    def integrand(theta: float) -> float:
        value = evaluate(blinn_phong, theta, theta, 0.0, 0.7, exponent)
        return 2 * math.pi * value * math.cos(theta) * math.sin(theta)

    edges = [0, min(4 / math.sqrt(exponent), 1.0), math.pi / 2]
    total = sum(integrate.quad(integrand, a, b, epsrel=1e-9)[0] for a, b in pairwise(edges))
    assert total == pytest.approx(0.7, rel=1e-8)


@pytest.mark.parametrize("exponent", [300.0, 30_000.0])
def test_blinn_phong_is_ward_when_sharp(exponent: float) -> None:
    """cos_h^n is exp(-tan2_h n / 2) but for the fourth order: Ward's lobe with alpha^2 = 2 / n, at the normal."""
    alpha = math.sqrt(2 / exponent)
    for tan_h in (0.0, alpha / 2, alpha):
        theta = math.atan(tan_h)
        # Light and viewer in the half vector's direction; Ward divides by its cosine, and its ks is 4 times as large.
        ours = evaluate(blinn_phong, theta, theta, 0.0, 1.0, exponent)
        other = 4 * evaluate(ward, theta, theta, 0.0, 1.0, alpha) * math.cos(theta)
        assert ours == pytest.approx(other, rel=4 / exponent)


@pytest.mark.parametrize(("alpha", "p"), [(0.001, 0.0), (0.02, 0.5), (0.1, 1.0), (0.5, 1.7)])
def test_shifted_gamma_is_normalized_by_an_incomplete_gamma_function(alpha: float, p: float) -> None:
    """With K = 1 / (alpha Gamma(1 - p, alpha)) the distribution times cos_h integrates to 1."""
    k = 1 / (alpha * float(mpmath.gammainc(1 - p, alpha)))
    # Neither shadow nor Fresnel: F is F0 + (1 - F0) 0, as light and viewer are in the half vector's direction.
    rest = (1.0, alpha, p, k, 1.0, 0.0, 1e-8, 2.5, 1000.0, 1.25)

    def d_cosine(theta: float) -> float:
        cos = math.cos(theta)
        d = evaluate(shifted_gamma, theta, theta, 0.0, *rest) * math.pi * cos * cos
        return 2 * math.pi * d * cos * math.sin(theta)

    edges = [0, math.atan(alpha), math.atan(8 * alpha), math.pi / 2 - 1e-6]
    assert sum(integrate.quad(d_cosine, a, b, epsrel=1e-9)[0] for a, b in pairwise(edges)) == pytest.approx(1, rel=1e-6)


@pytest.mark.parametrize(("sharpness", "exponent"), [(10.0, 0.5), (1e3, 1.2), (1e5, 2.5)])
def test_abc_integrates_to_its_closed_form(sharpness: float, exponent: float) -> None:
    """Over solid angle the distribution is 2 pi ((1 + B)^(1 - C) - 1) / (B (1 - C))."""

    def distribution(theta: float) -> float:
        cos = math.cos(theta)
        value = evaluate(abc, theta, theta, 0.0, 1.0, sharpness, exponent, 1.5)
        d = value * math.pi * cos * cos / (0.04 * min(1.0, 2 * cos * cos))  # F is ((n - 1) / (n + 1))^2
        return 2 * math.pi * d * math.sin(theta)

    edges = [0, 2 / math.sqrt(sharpness), math.pi / 4, math.pi / 2]
    total = sum(integrate.quad(distribution, a, b, epsrel=1e-9)[0] for a, b in pairwise(edges))
    closed = 2 * math.pi * ((1 + sharpness) ** (1 - exponent) - 1) / (sharpness * (1 - exponent))
    assert total == pytest.approx(closed, rel=1e-6)


@pytest.mark.parametrize("ior", [1.05, 1.5, 4.0, 99.0])
def test_dielectric_of_mitsuba(ior: float) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    for cosine in (1.0, 0.8, 0.5, 0.2, 0.02):
        found = dielectric(torch.tensor(ior), torch.tensor(cosine, dtype=torch.float64)).item()
        assert found == pytest.approx(mi.fresnel(cosine, ior)[0], rel=1e-3)


def test_dielectric_at_its_ends() -> None:
    """(n - 1)^2 / (n + 1)^2 at the normal, 1 at grazing, and nothing at Brewster's angle but the other polarization."""
    ior = torch.tensor([1.5, 3.0], dtype=torch.float64)
    torch.testing.assert_close(dielectric(ior, torch.ones_like(ior)), ((ior - 1) / (ior + 1)).square())
    torch.testing.assert_close(dielectric(ior, torch.zeros_like(ior)), torch.ones_like(ior))
    brewster = (1 + ior.square()).rsqrt()  # its cosine
    half = ((ior.square() - 1) / (ior.square() + 1)).square() / 2
    torch.testing.assert_close(dielectric(ior, brewster), half)


def test_schlick_at_its_ends() -> None:
    f0 = torch.tensor([0.04, 1.0])
    assert schlick(f0, torch.tensor(1.0)).tolist() == f0.tolist()
    assert schlick(f0, torch.tensor(0.0)).tolist() == [1.0, 1.0]


@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_beckmann_of_mitsuba(alpha: float) -> None:
    """Mitsuba's normal distribution, which has the 1/pi."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    peer = mi.MicrofacetDistribution(mi.MicrofacetType.Beckmann, alpha, False)
    for theta in np.linspace(0, min(2 * math.atan(alpha), 0.7), 8).tolist():
        cos = math.cos(theta)
        ours = evaluate(cook_torrance, theta, theta, 0.0, 1.0, alpha, 1.0) * math.pi * cos**2 / min(1.0, 2 * cos**2)
        assert ours / math.pi == pytest.approx(peer.eval([math.sin(theta), 0, cos]), rel=1e-4)


def test_diffuse_of_mitsuba() -> None:
    """Mitsuba's value has the cosine of the outgoing direction in it."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.8]}})
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = [math.sin(0.4), 0, math.cos(0.4)]
    peer = bsdf.eval(mi.BSDFContext(), interaction, [0, math.sin(1.1), math.cos(1.1)])
    for value, albedo in zip(list(peer), (0.2, 0.5, 0.8), strict=True):
        assert evaluate(lambert, 0.4, 1.1, math.pi / 2, albedo) * math.cos(1.1) == pytest.approx(value, rel=1e-5)


def d_cosine(function: Callable[..., torch.Tensor], visible: Callable[[float], float], *values: float) -> float:
    """The integral of D cos_h over half vectors, of a lobe whose G / (4 cos_i cos_o) is known where wi = wo = h."""

    def integrand(tangent: float) -> float:
        theta = math.atan(tangent)
        cos = math.cos(theta)
        d = evaluate(function, theta, theta, 0.0, 1.0, *values) / visible(cos)
        return 2 * math.pi * d * cos * math.sin(theta) * cos**2

    edges = [0, *(values[0] * 10.0**k for k in range(-1, 8))]
    return sum(integrate.quad(integrand, a, b, epsrel=1e-9)[0] for a, b in pairwise(edges))


@pytest.mark.parametrize("roughness", [0.01, 0.1, 0.5, 1.0])
def test_ggx_and_its_kin_are_normalized(roughness: float) -> None:
    def of_ggx(cos: float) -> float:
        return 0.25 / (cos * math.sqrt(roughness**2 + (1 - roughness**2) * cos**2))

    def of_beckmann(cos: float) -> float:
        tangent = math.sqrt(1 - cos**2) / cos
        if tangent < 1e-9:
            return 0.25 / cos**2
        v = 1 / (roughness * tangent)
        twice = math.exp(-(v**2)) / (v * math.sqrt(math.pi)) - math.erfc(v)
        return 0.25 / (cos**2 * (1 + twice))

    assert d_cosine(ggx, of_ggx, roughness, 1.0) == pytest.approx(1, rel=1e-6)
    assert d_cosine(beckmann, of_beckmann, roughness, 1.0) == pytest.approx(1, rel=1e-6)
    for exponent in (1.0, 1.5, 2.0, 5.0):
        assert d_cosine(gtr, of_ggx, roughness, exponent, 1.0) == pytest.approx(1, rel=1e-4)


def test_gtr_of_exponent_2_is_ggx() -> None:
    pairs = Pairs.from_half_diff(*torch.rand(3, 500, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    colour, f0 = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64), torch.tensor([0.3], dtype=torch.float64)
    for roughness in torch.tensor([[0.001], [0.1], [1.0]], dtype=torch.float64):
        expected = ggx(pairs, colour, roughness, f0)
        torch.testing.assert_close(gtr(pairs, colour, roughness, 2 * f0 / f0, f0), expected, rtol=1e-11, atol=0)


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


@pytest.mark.parametrize("alpha", [0.05, 0.3, 0.9])
@pytest.mark.parametrize(("name", "function"), [("GGX", ggx), ("Beckmann", beckmann)])
def test_distributions_of_mitsuba(name: str, function: Callable[..., torch.Tensor], alpha: float) -> None:
    """D by itself, and G with heights uncorrelated, from which the correlated one follows, in Mitsuba's own code."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    peer = mi.MicrofacetDistribution(getattr(mi.MicrofacetType, name), alpha, False)
    generator = np.random.default_rng(0)
    for theta_i, theta_o, phi in generator.uniform(0, [1.4, 1.4, math.pi], (40, 3)):
        wi = np.array([math.sin(theta_i), 0, math.cos(theta_i)])
        wo = np.array([math.sin(theta_o) * math.cos(phi), math.sin(theta_o) * math.sin(phi), math.cos(theta_o)])
        half = (wi + wo) / np.linalg.norm(wi + wo)
        d = peer.eval(half.tolist())
        inverse = sum(1 / peer.smith_g1(one.tolist(), half.tolist()) for one in (wi, wo)) - 1
        expected = d / inverse / (4 * wi[2] * wo[2])
        # Mitsuba approximates Beckmann's Lambda by a rational function.
        tolerance = 1e-4 if name == "GGX" else 1e-2
        assert evaluate(function, theta_i, theta_o, phi, 1.0, alpha, 1.0) == pytest.approx(expected, rel=tolerance)


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
