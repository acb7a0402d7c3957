"""Mitsuba's rough plastic against `bsdf.eval`, and the shares of its coat against integrals by Mitsuba's own facets."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.mitsuba_pictures import VARIANT, obstacle

from torchbrdf.lobes import RoughPlastic
from torchbrdf.lobes._rough_dielectric import COSINES, transmittances
from torchbrdf.pairs import Pairs

pytestmark = pytest.mark.skipif(bool(obstacle()), reason=str(obstacle()))
CASES = [(0.05, 1.5), (0.2, 1.3), (0.6, 2.0)]
COLOUR = [0.8, 0.3, 0.05]
# Nodes of Gauss and Legendre along either axis of a square, by which Mitsuba chooses facets.
OWN, INSIDE, MANY = 32, 128, 400


def mitsuba() -> Any:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant(VARIANT)
    return mi


def shares(alpha: float, ior: float, cosines: np.ndarray, outside: int, inside: int) -> tuple[np.ndarray, np.ndarray]:
    """What enters at each cosine, and what is reflected from inside, by facets of Mitsuba's sampling."""
    mi = mitsuba()
    distribution = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
    found: list[list[float]] = [[], []]
    for cosine in cosines:
        for k, count in enumerate((outside, inside)):
            nodes, weights = np.polynomial.legendre.leggauss(count)
            x, y = ((one.ravel() + 1) / 2 for one in np.meshgrid(nodes, nodes))
            wi = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0, float(cosine))
            m, _ = distribution.sample(wi, mi.Point2f(x.astype("f4"), y.astype("f4")))
            wi, m = np.array([np.sqrt(1 - cosine**2), 0, cosine]), np.array(m).astype(float)
            m /= np.linalg.norm(m, axis=0)
            c = wi @ m
            other = 1 - (1 - c**2) * (ior**2 if k else ior**-2)
            beyond, other = other <= 0, np.sqrt(np.maximum(other, 0))
            index = 1 / ior if k else ior
            across, along = (c - index * other) / (c + index * other), (index * c - other) / (index * c + other)
            reflectance = np.where(beyond, 1, (across**2 + along**2) / 2)
            height = 2 * c * m[2] - cosine if k else cosine / ior + (other - c / ior) * m[2]
            height = np.maximum(height, 0)
            masked = 2 * height / (height + np.sqrt(alpha**2 + (1 - alpha**2) * height**2))
            part = (weights[:, None] * weights).ravel() / 4
            found[k].append(float(part @ (masked * (reflectance if k else 1 - reflectance))))
    return np.array(found[0]), np.array(found[1])


@cache
def pairs() -> tuple[torch.Tensor, torch.Tensor]:
    wi, wo = (hemisphere(10_000, seed=seed, dtype=torch.float32).double() for seed in (3, 4))
    return wi, wo


def values(alpha: float, ior: float, **more: Any) -> torch.Tensor:
    """By Mitsuba, without the cosine."""
    mi = mitsuba()
    bsdf = mi.load_dict(
        {"type": "roughplastic", "distribution": "ggx", "alpha": alpha, "int_ior": ior, "ext_ior": 1.0, **more}
    )
    wi, wo = pairs()
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = mi.Vector3f(*wo.T.float().numpy())
    found = bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(*wi.T.float().numpy()))
    return torch.from_numpy(found.numpy().T.copy()).double() / wi[:, 2:]


def rgb(value: list[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": value}


@pytest.mark.parametrize(("alpha", "ior"), CASES)
def test_values_are_mitsubas(alpha: float, ior: float) -> None:
    """The coat's reflection to 1e-4; with the base to 1.3e-3, which is what Mitsuba's own shares leave."""
    wi, wo = pairs()
    here = torch.minimum(wi[:, 2], wo[:, 2]) > 1e-3
    for colour, most in (([0.0] * 3, 1e-4), (COLOUR, 1.3e-3)):
        lobe = RoughPlastic(base_color=colour, specular=0.7, roughness=alpha, ior=ior, dtype=torch.float64)
        expected = values(alpha, ior, diffuse_reflectance=rgb(colour), specular_reflectance=rgb([0.7] * 3))
        found = lobe(Pairs.from_directions(wi, wo)).detach()
        torch.testing.assert_close(found[here], expected[here], rtol=most, atol=1e-7)


def test_values_are_mitsubas_with_its_own_shares() -> None:
    """What is left is the number of facets: with Mitsuba's, a base's value is Mitsuba's to 1e-4."""
    alpha, ior = CASES[0]
    cosines = np.maximum(np.linspace(0, 1, COSINES), 1e-6)
    into, back = shares(alpha, ior, cosines, OWN, INSIDE)
    wi, wo = (one[:, 2].numpy() for one in pairs())
    share = np.interp(wi, np.linspace(0, 1, COSINES), into) * np.interp(wo, np.linspace(0, 1, COSINES), into)
    found = share / (np.pi * ior**2 * (1 - 2 * (back * cosines).mean()))
    expected = values(alpha, ior, diffuse_reflectance=rgb([1.0] * 3), specular_reflectance=rgb([0.0] * 3))
    here = np.minimum(wi, wo) > 1e-3
    np.testing.assert_allclose(found[here], expected[:, 0].numpy()[here], rtol=1e-4)


@pytest.mark.parametrize(("alpha", "ior"), CASES)
def test_shares_of_many_facets(alpha: float, ior: float) -> None:
    """The integrals themselves, by 160,000 facets: Mitsuba's shares come to ours."""
    some = [0, 3, 10, 31, 63]
    cosines = np.maximum(np.linspace(0, 1, COSINES), 1e-6)[some]
    into, _ = shares(alpha, ior, cosines, MANY, 1)
    few, _ = shares(alpha, ior, cosines, OWN, 1)
    a, n = (torch.tensor([value], dtype=torch.float64) for value in (alpha, ior))
    found = transmittances(a, n)[0].numpy()[some]
    np.testing.assert_allclose(found, into, rtol=3e-5)
    assert np.abs(few / into - 1).max() > 3 * np.abs(found / into - 1).max()


@pytest.mark.slow
def test_share_from_inside_of_many_facets() -> None:
    alpha, ior = CASES[1]
    cosines = np.maximum(np.linspace(0, 1, COSINES), 1e-6)
    _, back = shares(alpha, ior, cosines, 1, MANY)
    a, n = (torch.tensor([value], dtype=torch.float64) for value in (alpha, ior))
    assert transmittances(a, n)[1].item() == pytest.approx(1 - 2 * (back * cosines).mean(), rel=5e-5)


def test_a_nonlinear_one_is_the_same_with_other_colours() -> None:
    alpha, ior = CASES[1]
    wi, wo = pairs()
    a, n, colour = (torch.tensor(value, dtype=torch.float64) for value in ([alpha], [ior], COLOUR))
    left = transmittances(a, n)[1]
    lobe = RoughPlastic(base_color=colour * left / (1 - colour * (1 - left)), roughness=alpha, ior=ior, dtype=a.dtype)
    expected = values(alpha, ior, diffuse_reflectance=rgb(COLOUR), nonlinear=True)
    here = torch.minimum(wi[:, 2], wo[:, 2]) > 1e-3
    found = lobe(Pairs.from_directions(wi, wo)).detach()
    torch.testing.assert_close(found[here], expected[here], rtol=1.3e-3, atol=1e-7)
