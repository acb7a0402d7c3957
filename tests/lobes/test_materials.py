"""Renderers' materials: colours, energy, exchange of light and viewer, what they have in common, and fits."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from torch import Tensor

from torchbrdf.fitting import fit
from torchbrdf.lobes import GGXF82, GLTF, LOBES, OpenPBR, Principled, conductor, dielectric, ggx, ggx_f82, make_model
from torchbrdf.losses import CompressedLoss
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs

WHOLE = [name for name, kind in LOBES.items() if kind.is_material]
COLOUR = [0.8, 0.35, 0.1]
LUMINANCE = 0.212671 * 0.8 + 0.715160 * 0.35 + 0.072169 * 0.1


def some_pairs(count: int = 400) -> Pairs:
    return Pairs.from_directions(hemisphere(count, seed=3), hemisphere(count, seed=4))


def test_there_are_six() -> None:
    assert WHOLE == ["gltf", "gltf_anisotropic", "openpbr", "openpbr_anisotropic", "principled", "roughplastic"]


def schlick(f0: float, cosine: Tensor) -> Tensor:
    return f0 + (1 - f0) * (1 - cosine) ** 5


def facets(pairs: Pairs, alpha: float) -> Tensor:
    one = torch.ones(1, dtype=torch.float64)
    return ggx(pairs, one.expand(3), alpha * one, one)[:, 0]


@pytest.mark.parametrize("metallic", [0.0, 0.4, 1.0])
def test_colours_of_gltf(metallic: float) -> None:
    """Appendix B with a colour a channel: a dielectric's brightest reflection takes light from all of its body."""
    pairs, tint, n = some_pairs(), [0.2, 1.0, 0.5], 1.7
    lobe = GLTF(
        base_color=COLOUR, metallic=metallic, roughness=0.5, specular=0.8, specular_color=tint, ior=n, clearcoat=0.0,
        sheen_color=0.0, dtype=torch.float64,
    )  # fmt: skip
    f0 = [((n - 1) / (n + 1)) ** 2 * one for one in tint]
    reflected = torch.stack([schlick(one, pairs.cos_d) for one in f0], -1)
    own = facets(pairs, 0.25)
    for channel, color in enumerate(COLOUR):
        body = (1 - 0.8 * reflected.amax(-1)) * color / math.pi
        plastic = body + 0.8 * reflected[:, channel] * own
        metal = own * schlick(color, pairs.cos_d)
        expected = (1 - metallic) * plastic + metallic * metal
        torch.testing.assert_close(lobe(pairs)[:, channel].detach(), expected, rtol=1e-9, atol=1e-12)


def test_colours_of_sheen() -> None:
    """What lies below the sheen of glTF loses as much in all channels, by the brightest one."""
    pairs = some_pairs()
    black = {"base_color": 0.0, "specular": 0.0, "metallic": 0.0, "clearcoat": 0.0, "dtype": torch.float64}
    sheen = GLTF(**black, sheen_color=COLOUR)(pairs).detach()
    torch.testing.assert_close(sheen / sheen.sum(-1, keepdim=True), torch.tensor(COLOUR).double().expand(400, 3) / 1.25)
    white, bare = black | {"base_color": 1.0}, GLTF(**(black | {"base_color": 1.0}), sheen_color=0.0)(pairs).detach()
    left = (GLTF(**white, sheen_color=COLOUR)(pairs).detach() - sheen) / bare
    torch.testing.assert_close(left, left[:, :1].expand(-1, 3))
    assert left.min() < 0.95 and left.max() <= 1


@pytest.mark.parametrize("channel", range(3))
def test_channels_of_openpbr_are_those_of_a_grey_one(channel: int) -> None:
    colours = {"base_color": COLOUR, "specular_color": [0.9, 0.7, 0.6], "coat_color": [0.9, 0.5, 0.3]}
    pairs, rest = some_pairs(), {"coat_weight": 0.7, "fuzz_weight": 0.3, "dtype": torch.float64}
    found = OpenPBR(**colours, fuzz_color=[0.1, 0.2, 0.9], **rest)(pairs)[:, channel]
    grey = {name: value[channel] for name, value in colours.items()}
    expected = OpenPBR(**grey, fuzz_color=[0.1, 0.2, 0.9][channel], **rest)(pairs)[:, 0]
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=0)


def test_openpbr_is_its_parts() -> None:
    """A metal without coat and fuzz is `ggx_f82` with the square of its roughness."""
    pairs, bare = some_pairs(), {"coat_weight": 0.0, "fuzz_weight": 0.0, "dtype": torch.float64}
    metal = OpenPBR(base_color=COLOUR, base_metalness=1.0, specular_color=0.7, specular_roughness=0.4, **bare)
    expected = GGXF82(f0=COLOUR, f82=0.7, roughness=0.16, dtype=torch.float64)
    torch.testing.assert_close(metal(pairs), expected(pairs), rtol=1e-12, atol=0)


def test_f82_is_the_tint_at_82_degrees() -> None:
    angle = torch.tensor([math.acos(1 / 7)], dtype=torch.float64)
    pairs, one = Pairs.from_half_diff(0 * angle, angle, angle), torch.ones(1, dtype=torch.float64)
    f0, tint = torch.tensor(COLOUR).double(), torch.tensor([0.6, 0.8, 1.0]).double()
    plain = ggx_f82(pairs, f0, torch.ones(3).double(), 0.3 * one, one)
    torch.testing.assert_close(ggx_f82(pairs, f0, tint, 0.3 * one, one), tint * plain, rtol=1e-12, atol=0)
    torch.testing.assert_close(plain[:, 1], ggx(pairs, one.expand(3), 0.3 * one, f0[1:2])[:, 1], rtol=1e-12, atol=0)


def test_a_metal_without_absorption_is_a_dielectric() -> None:
    cosine = torch.linspace(0.01, 1, 50, dtype=torch.float64)
    eta = torch.tensor(1.7, dtype=torch.float64)
    torch.testing.assert_close(conductor(eta, 0 * eta, cosine), dielectric(eta, cosine))


def directional_albedo(values: Callable[[Pairs], Tensor], theta: float) -> float:
    """The share of light from everywhere that is reflected to a viewer."""
    nodes, weight = np.polynomial.legendre.leggauss(100)
    cos, phi = np.meshgrid((nodes + 1) / 2, (np.arange(80) + 0.5) / 80 * math.pi, indexing="ij")
    sin = np.sqrt(1 - cos**2)
    wi = torch.tensor(np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], -1).reshape(-1, 3))
    wo = torch.tensor([[math.sin(theta), 0.0, math.cos(theta)]], dtype=torch.float64).expand_as(wi)
    share = torch.tensor((cos * weight[:, None] / 2 / 80 * 2 * math.pi).reshape(-1))
    return (values(Pairs.from_directions(wi, wo))[:, 0] * share).sum().item()


def white(kind: type, seed: int) -> dict[str, float]:
    """All colours 1, all else anything, but not so sharp that the integral misses it."""
    random = np.random.default_rng(seed)
    found = {}
    for name, spec in kind.parameter_specs.items():
        lower = 0.35 if "roughness" in name else spec.lower
        drawn = random.choice([lower, spec.upper, random.uniform(lower, spec.upper)])
        found[name] = 1.0 if spec.shape == (3,) else float(drawn)
    return found


@pytest.mark.parametrize("theta", [0.0, 0.8, 1.3, 1.5])
@pytest.mark.parametrize(("name", "most"), [("ggx_f82", 1.0), ("openpbr", 1.02), ("gltf", 1.1)])
def test_white_ones_reflect_no_more_than_they_get(name: str, most: float, theta: float) -> None:
    """But for the layers' albedos, which are fits; glTF's specification says that its mix of both gains some."""
    kind = LOBES[name]
    shares = [
        directional_albedo(lambda pairs, own=own: kind(**own, dtype=torch.float64)(pairs).detach(), theta)
        for own in (white(kind, seed) for seed in range(40))
    ]
    assert 0.7 < max(shares) < most


def test_disneys_body_gains_energy_as_it_was_published() -> None:
    """It stands in the documentation; `torchbrdf` does not mend what a renderer shows."""
    body = Principled(base_color=1.0, metallic=0.0, roughness=1.0, sheen=0.0, clearcoat=0.0, dtype=torch.float64)
    assert 1.05 < directional_albedo(lambda pairs: body(pairs).detach(), 1.4) < 1.6


@pytest.mark.parametrize("name", WHOLE)
def test_names_of_scalars_are_those_of_terms(name: str) -> None:
    """Coefficients and terms take all parameters between them."""
    from torchbrdf.lobes.separable import pattern

    kind = LOBES[name]
    known = {spec.name for spec, terms in zip(kind.term_scalars(), pattern(kind).slopes, strict=True) if terms}
    assert known == {spec.name for spec in kind.term_scalars()}
    assert known | {*pattern(kind).parameters} == {*kind.parameter_specs}


@pytest.mark.parametrize("name", [*WHOLE, "ggx_f82", "roughconductor"])
def test_a_fit_finds_what_made_the_values(name: str) -> None:
    torch.manual_seed(0)
    truth, pairs = LOBES[name](dtype=torch.float64), some_pairs(1000)
    model = make_model(name, 1, dtype=torch.float64)
    with torch.no_grad():
        for spec in truth.parameter_specs.values():
            own = getattr(truth, spec.name)
            toward = spec.lower + 0.6 * (min(spec.upper, 1.5) - spec.lower)
            own.copy_(0.5 * own + 0.5 * toward * torch.linspace(0.9, 1.1, own.numel(), dtype=torch.float64))
    measured = Measured.from_samples(pairs, truth(pairs)[None].detach(), names=["made"])
    result = fit(model, measured, CompressedLoss(), strategy="global", samples=None, diffuse="fit")
    assert result.error.item() < 2e-3
