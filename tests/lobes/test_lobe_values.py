"""The lobes' values against independent evaluations: the papers' formulas with 50 digits, and each other."""

import math

import mpmath
import numpy as np
import pytest
import torch
from helpers.directions import from_half_diff
from helpers.exact_lobes import Geometry, decades, mp
from helpers.exact_materials import EXACT
from helpers.lobe_cases import evaluate
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from torchbrdf.lobes import (
    LOBES,
    Lobe,
    abc,
    ashikhmin_shirley,
    beckmann,
    blinn_phong,
    cook_torrance,
    dielectric,
    distribution_based,
    ggx,
    gtr,
    lambert,
    schlick,
    shifted_gamma,
    student_t,
    ward,
)
from torchbrdf.pairs import Pairs


def test_every_lobe_has_a_formula_here() -> None:
    assert set(EXACT) == set(LOBES), "give a new lobe an independent formula in EXACT"


@pytest.mark.parametrize("name", EXACT)
@given(data=st.data())
@settings(max_examples=40)
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


def test_gtr_of_exponent_2_is_ggx() -> None:
    pairs = Pairs.from_half_diff(*torch.rand(3, 500, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    colour, f0 = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64), torch.tensor([0.3], dtype=torch.float64)
    for roughness in torch.tensor([[0.001], [0.1], [1.0]], dtype=torch.float64):
        expected = ggx(pairs, colour, roughness, f0)
        torch.testing.assert_close(gtr(pairs, colour, roughness, 2 * f0 / f0, f0), expected, rtol=1e-11, atol=0)


def test_student_t_lies_between_ggx_and_beckmann() -> None:
    """gamma = 2 is GGX with all digits; at a large gamma it is near Beckmann's lobe, the nearer the larger."""
    pairs = Pairs.from_half_diff(*torch.rand(3, 500, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    colour, f0 = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64), torch.tensor([0.3], dtype=torch.float64)
    for roughness in torch.tensor([[0.001], [0.1], [1.0]], dtype=torch.float64):
        expected = ggx(pairs, colour, roughness, f0)
        torch.testing.assert_close(student_t(pairs, colour, roughness, 2 * f0 / f0, f0), expected, rtol=1e-11, atol=0)
    expected = beckmann(pairs, colour, 0.4 * f0 / f0, f0)
    apart = [(student_t(pairs, colour, 0.4 * f0 / f0, k * f0 / f0, f0) - expected).abs().max() for k in (5, 10, 40)]
    assert apart[0] > 1.9 * apart[1] > 1.9**2 * apart[2] and apart[2] < 0.03 * expected.max()


@pytest.mark.parametrize("name", ["student_t", "lafortune", "he"])
def test_derivatives_in_closed_form(name: str) -> None:
    """Those of `value_and_jacobian` are those of forward differentiation."""
    pairs = Pairs.from_half_diff(*torch.rand(3, 200, dtype=torch.float64, generator=torch.Generator().manual_seed(2)))
    kind = LOBES[name]
    scalars = [torch.tensor([[spec.start], [0.9 * spec.start]], dtype=torch.float64) for spec in kind.scalars()]
    expected = Lobe.value_and_jacobian.__func__(kind, pairs, *scalars)  # type: ignore[attr-defined]
    for own, other in zip(kind.value_and_jacobian(pairs, *scalars), expected, strict=True):
        here = pairs.above_horizon
        torch.testing.assert_close(own[:, here], other[:, here], rtol=1e-9, atol=1e-12)
