"""What the values of every registered lobe keep to. A new lobe gets all of these by being registered."""

import copy
import math

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.lobe_cases import every_lobe, made, middle, some_pairs, values
from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.lobes import LOBES
from torchbrdf.lobes.separable import tangents
from torchbrdf.pairs import Pairs

DTYPES = [torch.float32, torch.float64]
# How many combinations of parameters at their bounds a test goes through at most.
CORNERS = 2048


def extreme_pairs(dtype: torch.dtype) -> Pairs:
    """Every combination of heights down to grazing, with the azimuths of mirror, retro and sideways reflection."""
    cos = torch.tensor([1.0, 0.5, 1e-3, 1e-6, 1e-12, 1e-30], dtype=dtype)
    turn = torch.tensor([0, 1e-3, math.pi / 2, math.pi - 1e-3, math.pi], dtype=dtype)
    cos_i, cos_o, phi = torch.cartesian_prod(cos, cos, turn).unbind(-1)
    sin_i, sin_o = (1 - cos_i**2).sqrt(), (1 - cos_o**2).sqrt()
    wi = torch.stack([sin_i, torch.zeros_like(sin_i), cos_i], -1)
    side = torch.where(phi == math.pi, 0.0, phi.sin())  # so that the mirror direction is exactly that
    return Pairs.from_directions(wi, torch.stack([sin_o * phi.cos(), sin_o * side, cos_o], -1))


@every_lobe
def test_function_and_module_agree(name: str) -> None:
    parameters, pairs = values(name), some_pairs(20)
    lobe = LOBES[name](**parameters)
    torch.testing.assert_close(lobe(pairs), LOBES[name].function(pairs, *parameters.values()), rtol=0, atol=0)
    torch.testing.assert_close(lobe(pairs), LOBES[name].function(pairs, **parameters), rtol=0, atol=0)


@every_lobe
@pytest.mark.parametrize(("lead", "shape"), [((), (2, 3, 7)), ((3,), (7,)), ((1,), (3, 7)), ((2, 3), (1, 7))])
def test_any_leading_dimensions(name: str, lead: tuple[int, ...], shape: tuple[int, ...]) -> None:
    """Parameters (..., k) and pairs (..., N) broadcast, as computed one by one."""
    parameters, pairs = values(name, *lead), some_pairs(*shape)
    result = LOBES[name].function(pairs, *parameters.values())
    full = torch.broadcast_shapes(lead, shape[:-1])
    assert result.shape == (*full, 7, 3)
    wi, wo = pairs.wi.expand(*full, 7, 3), pairs.wo.expand(*full, 7, 3)
    declared = LOBES[name].parameter_specs
    spread = {key: value.expand(*full, *declared[key].shape) for key, value in parameters.items()}
    for index in np.ndindex(*full):
        one = [value[index] for value in spread.values()]
        expected = LOBES[name].function(Pairs.from_directions(wi[index], wo[index]), *one)
        torch.testing.assert_close(result[index], expected, rtol=1e-12, atol=0)


@every_lobe
def test_dtype_follows_the_inputs(name: str) -> None:
    for dtype in DTYPES:
        assert made(name, dtype=dtype)(some_pairs(4, dtype=dtype)).dtype == dtype
        assert all(value.dtype == dtype for value in LOBES[name](dtype=dtype).parameters())


@every_lobe
def test_zero_below_the_horizon(name: str) -> None:
    """Exactly 0, with gradients that are numbers: also where the half vector is on the horizon or there is none."""
    dtype = torch.float32  # where overflow is nearer
    down = torch.tensor([1.0, 1.0, -1.0], dtype=dtype)
    wi, wo = hemisphere(50, seed=5, dtype=dtype), hemisphere(50, seed=6, dtype=dtype)
    on_horizon = torch.tensor([[1.0, 0.0, 0.0]], dtype=dtype).expand(50, 3)
    for pair in [
        (wi, wo * down),
        (wi * down, wo),
        (wi * down, wo * down),
        (wi, wi * down),
        (wi, -wi),
        (on_horizon, wo),
    ]:
        lobe = made(name, dtype=dtype)
        result = lobe(Pairs.from_directions(*pair))
        assert (result == 0).all()
        result.sum().backward()
        for value in lobe.parameters():
            assert (value.grad == 0).all()


@every_lobe
def test_finite_everywhere(name: str) -> None:
    """Values and gradients at grazing directions and at every corner of the bounds, or at many of them."""
    dtype = torch.float32  # where overflow is nearer
    pairs, declared = extreme_pairs(dtype), LOBES[name].parameter_specs
    choices = torch.tensor([[b.lower, b.start, middle(b), b.upper] for b in declared.values()], dtype=dtype)
    if 4 ** len(declared) <= CORNERS:
        corners = torch.cartesian_prod(*choices).reshape(-1, len(declared))
    else:  # too many for all of them
        generator = torch.Generator().manual_seed(0)
        drawn = torch.randint(4, (CORNERS, len(declared)), generator=generator)
        corners = torch.cat([choices.T, choices.T[drawn, torch.arange(len(declared))]])
    parameters = [
        corners[:, k].reshape(-1, *[1] * len(spec.shape)).expand(-1, *spec.shape).clone().requires_grad_()
        for k, spec in enumerate(declared.values())
    ]
    result = LOBES[name].function(pairs, *parameters)
    assert result.isfinite().all()
    assert (result >= 0).all()
    # Values reach 1e26 at grazing directions; compressed, the others have a say as well.
    for total in (result.sum(), torch.log1p(result).sum()):
        for key, gradient in zip(declared, torch.autograd.grad(total, parameters, retain_graph=True), strict=True):
            assert gradient.isfinite().all(), key


@every_lobe
def test_float32_keeps_the_digits(name: str) -> None:
    """Against float64 on the same float32 directions, with the sharpest lobes of the bounds."""
    pairs = some_pairs(2000, dtype=torch.float32)
    wi = pairs.wi
    near = wi * torch.tensor([-1.0, -1.0, 1.0]) + 1e-3 * hemisphere(2000, seed=8, dtype=torch.float32)
    sharp = Pairs.from_directions(wi, near / near.norm(dim=-1, keepdim=True))
    for bound in ("lower", "start", "upper"):
        lobe = LOBES[name](**{key: getattr(b, bound) or middle(b) for key, b in LOBES[name].parameter_specs.items()})
        exact = copy.deepcopy(lobe).double()
        for case in (pairs, sharp):
            expected = exact(Pairs.from_directions(case.wi.double(), case.wo.double()))
            error = (lobe(case).double() - expected).abs() / (expected + 1e-6 * expected.max())
            assert error.max() < 2e-4


@every_lobe
def test_gradcheck(name: str) -> None:
    pairs = some_pairs(4)
    parameters = [value.requires_grad_() for value in values(name, 2).values()]
    assert torch.autograd.gradcheck(lambda *p: LOBES[name].function(pairs, *p), parameters)


@every_lobe
def test_gradcheck_of_directions(name: str) -> None:
    parameters, pairs = values(name), some_pairs(6)
    wi, wo = pairs.wi.clone().requires_grad_(), pairs.wo.clone().requires_grad_()

    def function(wi: Tensor, wo: Tensor) -> Tensor:
        return LOBES[name].function(Pairs.from_directions(wi, wo), *parameters.values())

    assert torch.autograd.gradcheck(function, (wi, wo))


@every_lobe
def test_reciprocity(name: str) -> None:
    lobe, pairs = made(name), some_pairs(500)
    swapped = Pairs.from_directions(pairs.wo, pairs.wi)
    torch.testing.assert_close(lobe(swapped), lobe(pairs), rtol=1e-12, atol=0)


def turned(pairs: Pairs, angle: float) -> Pairs:
    """Both directions turned about the normal."""
    c, s = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)
    return Pairs.from_directions(pairs.wi @ turn.T, pairs.wo @ turn.T)


@every_lobe
def test_turning_both_directions(name: str) -> None:
    """It changes nothing, unless a lobe is anisotropic: then half of a turn is none, and a quarter is one."""
    lobe, pairs = made(name), some_pairs(100)
    if LOBES[name].is_anisotropic:
        first, second = LOBES[name].axes
        lobe = LOBES[name](**{**values(name), second: 5 * values(name)[first]})
        torch.testing.assert_close(lobe(turned(pairs, math.pi)), lobe(pairs), rtol=1e-9, atol=0)
        assert ((lobe(turned(pairs, math.pi / 2)) / lobe(pairs)).log().abs() > 0.01).double().mean() > 0.5
    else:
        torch.testing.assert_close(lobe(turned(pairs, 0.7)), lobe(pairs), rtol=1e-9, atol=0)


every_anisotropic = pytest.mark.parametrize("name", [name for name, lobe in LOBES.items() if lobe.is_anisotropic])


@every_anisotropic
@pytest.mark.parametrize("rotation", [0.0, 0.4, -2.0])
def test_equal_widths_are_the_isotropic_lobe(name: str, rotation: float) -> None:
    kind, isotropic = LOBES[name], LOBES[name.removesuffix("_anisotropic")]
    parameters, pairs = values(name), some_pairs(500)
    first, second = kind.axes
    width = {first: parameters[first], second: parameters[first], "rotation": torch.full((1,), rotation).double()}
    found = kind.function(pairs, **{**parameters, **width})
    own = {spec: parameters[spec if spec in parameters else first] for spec in isotropic.parameter_specs}
    torch.testing.assert_close(found, isotropic.function(pairs, **own), rtol=1e-9, atol=0)


@every_anisotropic
def test_turning_the_grain_is_turning_the_directions(name: str) -> None:
    parameters, pairs = values(name), some_pairs(100)
    first, second = LOBES[name].axes
    parameters = {**parameters, second: 3 * parameters[first]}
    further = {**parameters, "rotation": parameters["rotation"] + 0.7}
    function = LOBES[name].function
    torch.testing.assert_close(
        function(turned(pairs, 0.7), **further), function(pairs, **parameters), rtol=1e-9, atol=0
    )


@every_anisotropic
def test_the_canonical_grain_is_the_same_lobe(name: str) -> None:
    """Along x it is the narrow one, and the rotation is within half of a turn."""
    kind, pairs = LOBES[name], some_pairs(50)
    first, second = kind.axes
    rotation = torch.linspace(-math.pi, math.pi, 17, dtype=torch.float64)[:, None]
    for ratio in (0.5, 1.0, 2.0):
        parameters = {**values(name, 17), "rotation": rotation}
        parameters[second] = ratio * parameters[first]
        found = kind.canonical(parameters)
        torch.testing.assert_close(kind.function(pairs, **found), kind.function(pairs, **parameters), rtol=1e-9, atol=0)
        assert (found["rotation"] > -math.pi / 2 - 1e-12).all() and (found["rotation"] <= math.pi / 2 + 1e-12).all()
        narrow = found[first] <= found[second] if kind.rises_with_width else found[first] >= found[second]
        assert narrow.all()
        again = kind.canonical(found)
        assert all(torch.equal(value, found[key]) for key, value in again.items())


@every_anisotropic
def test_pairs_that_know_no_azimuth_are_refused(name: str) -> None:
    pairs, lobe = some_pairs(5), made(name)
    cosines = Pairs.from_cosines(pairs.cos_i, pairs.cos_o, pairs.cos_h, pairs.cos_d, pairs.tan2_h)
    angles = Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d)
    for unknown in (cosines, angles):
        with pytest.raises(ShapeError, match=r"^Pairs: slope_x is needed, but only .* were given$"):
            lobe(unknown)
    known = Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d, pairs.phi_h)
    torch.testing.assert_close(lobe(known), lobe(pairs), rtol=1e-9, atol=1e-300)


@every_anisotropic
def test_derivatives_of_the_anisotropic(name: str) -> None:
    """Those of closed forms are those of forward differentiation, at equal widths, too."""
    kind, pairs = LOBES[name], some_pairs(200)
    specs = kind.term_scalars()
    scalars = {spec.name: torch.tensor([[spec.start], [0.9 * spec.start + 0.1]]).double() for spec in specs}
    scalars[kind.axes[1]][1] = scalars[kind.axes[0]][1]
    terms, slopes = kind.terms_and_jacobian(pairs, *scalars.values())
    others, expected = tangents(lambda *own: kind.terms(pairs, *own), list(scalars.values()))
    for own, other in zip([terms, *slopes], [others, *expected], strict=True):
        for one, two in zip(own, other, strict=True):
            zero = torch.zeros(2, 200, dtype=torch.float64)
            values = [zero if value is None else value.expand(2, 200) for value in (one, two)]
            torch.testing.assert_close(*values, rtol=1e-9, atol=1e-12)


@every_lobe
def test_linear_parameters_are_linear(name: str) -> None:
    parameters, other, pairs = values(name), values(name, seed=9), some_pairs(50)
    function, linear = LOBES[name].function, [key for key, b in LOBES[name].parameter_specs.items() if b.linear]
    assert linear or LOBES[name].albedo_spec() is None
    for key in linear:
        mixed = function(pairs, **{**parameters, key: 2 * parameters[key] - 3 * other[key]})
        parts = 2 * function(pairs, **parameters) - 3 * function(pairs, **{**parameters, key: other[key]})
        torch.testing.assert_close(mixed, parts, rtol=1e-10, atol=1e-14)


@every_lobe
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda(name: str) -> None:
    lobe, pairs = made(name, 3), some_pairs(3, 100)
    result = copy.deepcopy(lobe).cuda()(pairs.to("cuda"))
    assert result.is_cuda
    torch.testing.assert_close(result.cpu(), lobe(pairs), rtol=1e-10, atol=0)
