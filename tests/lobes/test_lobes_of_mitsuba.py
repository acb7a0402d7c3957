"""Lobes' parts beside Mitsuba's own: Fresnel, distributions, shadowing, diffuse reflection."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.lobe_cases import evaluate

from torchbrdf.lobes import (
    beckmann,
    cook_torrance,
    dielectric,
    ggx,
    ggx_anisotropic,
    lambert,
    roughconductor_anisotropic,
)
from torchbrdf.pairs import Pairs


@pytest.mark.parametrize("ior", [1.05, 1.5, 4.0, 99.0])
def test_dielectric_of_mitsuba(ior: float) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    for cosine in (1.0, 0.8, 0.5, 0.2, 0.02):
        found = dielectric(torch.tensor(ior), torch.tensor(cosine, dtype=torch.float64)).item()
        assert found == pytest.approx(mi.fresnel(cosine, ior)[0], rel=1e-3)


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


@pytest.mark.parametrize(("alpha_u", "alpha_v"), [(0.05, 0.3), (0.6, 0.1), (0.2, 0.2), (0.02, 0.9)])
def test_the_grain_of_mitsubas_rough_conductor(alpha_u: float, alpha_v: float) -> None:
    """By `bsdf.eval`, which has the cosine in it: 1e-4, with its metal, and ours with what its shadowing differs by."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    rough = {"type": "roughconductor", "distribution": "ggx", "alpha_u": alpha_u, "alpha_v": alpha_v}
    metal, mirror = (mi.load_dict({**rough, **one}) for one in ({"eta": 0.2, "k": 3.0}, {"material": "none"}))
    peer = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha_u, alpha_v, False)
    interaction = mi.SurfaceInteraction3f()
    one, widths = torch.ones(1, dtype=torch.float64), (alpha_u, alpha_v, 0.0)
    numbers = [torch.tensor([value], dtype=torch.float64) for value in widths]
    of_metal = [torch.tensor([value], dtype=torch.float64) for value in (0.2, 3.0)]
    wi, wo = hemisphere(60, seed=3), hemisphere(60, seed=4)
    wo[:30] = torch.nn.functional.normalize(wi[:30] * torch.tensor([-1.0, -1.0, 1.0]) + 0.1 * wo[:30], dim=-1)
    for light, viewer in zip(wi, wo, strict=True):
        pairs = Pairs.from_directions(light[None], viewer[None])
        interaction.wi = viewer.tolist()
        expected = [bsdf.eval(mi.BSDFContext(), interaction, light.tolist())[0] for bsdf in (metal, mirror)]
        found = roughconductor_anisotropic(pairs, one, *numbers, *of_metal).item() * pairs.cos_i.item()
        assert found == pytest.approx(expected[0], rel=1e-4, abs=1e-9)
        half = ((light + viewer) / (light + viewer).norm()).tolist()
        g_i, g_o = (peer.smith_g1(vector.tolist(), half) for vector in (light, viewer))
        correlated = expected[1] / (g_i * g_o) / (1 / g_i + 1 / g_o - 1)
        found = ggx_anisotropic(pairs, one, *numbers, one).item() * pairs.cos_i.item()
        assert found == pytest.approx(correlated, rel=1e-4, abs=1e-9)
