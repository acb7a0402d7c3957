"""Directions, cosines and half/difference angles."""

import copy
import math
import pickle
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from helpers.directions import from_half_diff, hemisphere
from hypothesis import assume, given
from hypothesis import strategies as st
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.pairs import Pairs

QUANTITIES = ["cos_i", "cos_o", "cos_h", "cos_d", "tan2_h", "theta_h", "theta_d", "phi_d", "wi", "wo", "above_horizon"]

quarter = st.floats(0, math.pi / 2)
half_turn = st.floats(0, math.pi, exclude_max=True)
turn = st.floats(-math.pi, math.pi)


def half_diff(theta_h: float, theta_d: float, phi_d: float) -> Pairs:
    return Pairs.from_half_diff(*(torch.tensor([x], dtype=torch.float64) for x in (theta_h, theta_d, phi_d)))


def directions(theta_h: float, theta_d: float, phi_d: float, phi_h: float) -> Pairs:
    wi, wo = from_half_diff(*(np.array([x]) for x in (theta_h, theta_d, phi_d, phi_h)))
    return Pairs.from_directions(torch.from_numpy(wi), torch.from_numpy(wo))


def random_pairs(*shape: int, dtype: torch.dtype = torch.float64) -> Pairs:
    return Pairs.from_directions(hemisphere(*shape, seed=1, dtype=dtype), hemisphere(*shape, seed=2, dtype=dtype))


@given(quarter, quarter, half_turn, turn)
def test_angles_to_directions(theta_h: float, theta_d: float, phi_d: float, phi_h: float) -> None:
    """Cosines from the angles are those of the rotated vectors, whatever the half vector's azimuth."""
    angles, vectors = half_diff(theta_h, theta_d, phi_d), directions(theta_h, theta_d, phi_d, phi_h)
    for name in ("cos_i", "cos_o", "cos_d"):
        torch.testing.assert_close(getattr(angles, name), getattr(vectors, name), rtol=0, atol=1e-14)
    # Rounding of the directions turns a short half vector.
    torch.testing.assert_close(angles.cos_h, vectors.cos_h, rtol=0, atol=2e-15 / max(math.cos(theta_d), 1e-15))
    wi, wo = from_half_diff(*(np.array([x]) for x in (theta_h, theta_d, phi_d)))
    torch.testing.assert_close(angles.wi, torch.from_numpy(wi), rtol=0, atol=1e-14)
    torch.testing.assert_close(angles.wo, torch.from_numpy(wo), rtol=0, atol=1e-14)


@given(quarter, quarter, half_turn, turn)
def test_directions_to_angles(theta_h: float, theta_d: float, phi_d: float, phi_h: float) -> None:
    assume(theta_d < math.pi / 2 - 1e-3)  # where the half vector vanishes it has no angle
    pairs = directions(theta_h, theta_d, phi_d, phi_h)
    assert pairs.theta_h.item() == pytest.approx(theta_h, abs=1e-12)
    assert pairs.theta_d.item() == pytest.approx(theta_d, abs=1e-15, rel=1e-12)
    assume(min(theta_h, theta_d) > 1e-3)  # there phi_d is lost in rounding
    turned = 2 * (pairs.phi_d.item() - phi_d)
    assert (math.cos(turned), math.sin(turned)) == pytest.approx((1, 0), abs=1e-8)


@given(quarter, quarter, half_turn, turn)
def test_round_trip(theta_h: float, theta_d: float, phi_d: float, phi_h: float) -> None:
    """Directions -> angles -> cosines, everywhere; folding phi_d may swap light and viewer."""
    assume(theta_d < math.pi / 2 - 1e-3)
    pairs = directions(theta_h, theta_d, phi_d, phi_h)
    back = Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d)
    expected = sorted([pairs.cos_i.item(), pairs.cos_o.item()])
    assert sorted([back.cos_i.item(), back.cos_o.item()]) == pytest.approx(expected, abs=1e-12)


@given(quarter, quarter, half_turn, turn)
def test_swapping_light_and_viewer(theta_h: float, theta_d: float, phi_d: float, phi_h: float) -> None:
    assume(theta_d < math.pi / 2 - 1e-3)
    pairs = directions(theta_h, theta_d, phi_d, phi_h)
    swapped = Pairs.from_directions(pairs.wo, pairs.wi)
    assert swapped.cos_i.item() == pairs.cos_o.item()
    for name in ("theta_h", "theta_d", "cos_h", "cos_d", "tan2_h"):
        torch.testing.assert_close(getattr(swapped, name), getattr(pairs, name), rtol=1e-12, atol=1e-15)
    assume(min(theta_h, theta_d) > 1e-3)
    turned = 2 * (swapped.phi_d - pairs.phi_d).item()
    assert (math.cos(turned), math.sin(turned)) == pytest.approx((1, 0), abs=1e-8)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_ranges(dtype: torch.dtype) -> None:
    pairs = random_pairs(20000, dtype=dtype)
    edges = Pairs.from_directions(  # half vector at the normal, in the plane, and backwards in the plane
        torch.tensor([[0, 0, 1], [0.6, 0, 0.8], [-0.6, -1e-9, 0.8], [0.6, 1e-9, 0.8]], dtype=dtype),
        torch.tensor([[0, 0, 1], [-0.6, 0, 0.8], [0, 0, 1], [0, 0, 1]], dtype=dtype),
    )
    for case in (pairs, edges):
        assert ((case.phi_d >= 0) & (case.phi_d < math.pi)).all()
        for angle in (case.theta_h, case.theta_d):
            assert ((angle >= 0) & (angle <= math.pi / 2)).all()


@pytest.mark.parametrize("exponent", [-6, -3, -1])
def test_tan2_h_keeps_its_digits_in_float32(exponent: int) -> None:
    """Near theta_h = 0 a float32 cos_h is 1; tan2_h keeps the digits that the directions have."""
    count = 200
    generator = np.random.default_rng(exponent + 10)
    theta_h = np.full(count, 10.0**exponent) * generator.uniform(1, 9, count)
    vectors = from_half_diff(theta_h, generator.uniform(0, 1.3, count), *generator.uniform(0, math.pi, (2, count)))
    wi, wo = (torch.from_numpy(vector).float() for vector in vectors)
    exact = wi.double() + wo.double()
    expected = (exact[:, 0] ** 2 + exact[:, 1] ** 2) / exact[:, 2] ** 2
    pairs = Pairs.from_directions(wi, wo)
    assert pairs.tan2_h.dtype == torch.float32
    torch.testing.assert_close(pairs.tan2_h.double(), expected, rtol=1e-6, atol=0)
    torch.testing.assert_close(pairs.theta_h.double(), expected.sqrt().atan(), rtol=1e-6, atol=0)
    angle = torch.from_numpy(theta_h).float()
    given = Pairs.from_half_diff(angle, angle, angle)
    torch.testing.assert_close(given.tan2_h.double(), angle.double().tan() ** 2, rtol=1e-6, atol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_limits_are_numbers(dtype: torch.dtype) -> None:
    """The half vector on the horizon, no half vector at all, and nothing but the normal."""
    wi = torch.tensor([[1, 0, 0], [0.6, 0, 0.8], [0, 0, 1], [1, 0, 1e-30]], dtype=dtype)
    wo = torch.tensor([[0, 1, 0], [-0.6, 0, -0.8], [0, 0, 1], [1, 0, 1e-30]], dtype=dtype)
    corners = torch.cartesian_prod(*[torch.tensor([0, math.pi / 2], dtype=dtype)] * 3).unbind(-1)
    for pairs in (Pairs.from_directions(wi, wo), Pairs.from_half_diff(*corners)):
        for name in QUANTITIES:
            assert not getattr(pairs, name).isnan().any(), name


def test_above_needs_both() -> None:
    cos = torch.tensor([0.5, 0.0, -0.5])
    pairs = Pairs.from_cosines(*(x.flatten() for x in torch.meshgrid(cos, cos, indexing="ij")))
    assert pairs.above_horizon.tolist() == [True] + [False] * 8


def test_directions_broadcast() -> None:
    pairs = Pairs.from_directions(hemisphere(4, 1, 1), hemisphere(5))
    assert pairs.shape == (4, 1, 5)
    assert len(pairs) == 5
    for name in QUANTITIES:
        assert getattr(pairs, name).shape[:3] == (4, 1, 5)


def everything(pairs: Pairs) -> dict[str, torch.Tensor]:
    return {name: getattr(pairs, name) for name in QUANTITIES}


@pytest.mark.parametrize(
    ("materials", "samples"),
    [
        (slice(1, 3), None),
        (None, slice(1, 6, 2)),
        ([2, 0], [3, 0]),
        (torch.tensor([1]), torch.tensor([5, 5, 1])),
        (slice(1, 3), [3, 0]),
    ],
)
@pytest.mark.parametrize(
    ("made", "warm"), [("directions", False), ("angles", True)], ids=["derived after", "derived before"]
)
def test_select(made: str, materials: Any, samples: Any, warm: bool) -> None:
    pairs, same = random_pairs(3, 7), random_pairs(3, 7)
    if made == "angles":
        pairs, same = (Pairs.from_half_diff(p.theta_h, p.theta_d, p.phi_d) for p in (pairs, same))
    whole = everything(same)
    if warm:
        everything(pairs)
    part = everything(pairs.select(materials, samples))
    for name, value in whole.items():
        rows = value if materials is None else value[materials]
        torch.testing.assert_close(part[name], rows if samples is None else rows[:, samples], rtol=1e-14, atol=1e-15)


def test_shared_pairs_are_everybodys() -> None:
    pairs = random_pairs(1, 7)
    chosen = pairs.select(materials=[4, 2], samples=[1])
    assert chosen.shape == (1, 1)
    assert chosen.cos_i.item() == pairs.cos_i[0, 1].item()


def test_unbatched_pairs_have_samples_only() -> None:
    pairs = random_pairs(7)
    torch.testing.assert_close(pairs.select(materials=[0], samples=[2]).wi, pairs.wi[[2]])


@pytest.mark.parametrize("warm", [False, True])
def test_to(warm: bool) -> None:
    pairs = random_pairs(2, 5)
    if warm:
        everything(pairs)
    single = pairs.to(dtype=torch.float32)
    assert (single.dtype, pairs.dtype) == (torch.float32, torch.float64)
    assert single.device == torch.device("cpu")
    for name, value in everything(single).items():
        assert value.dtype == (torch.bool if name == "above_horizon" else torch.float32)
        torch.testing.assert_close(value, getattr(pairs, name).to(value.dtype), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(pairs.to("cpu").wi, pairs.wi, rtol=0, atol=0)


def test_from_cosines_derives_what_it_can() -> None:
    full = random_pairs(50)
    pairs = Pairs.from_cosines(full.cos_i, full.cos_o, full.cos_h, full.cos_d)
    for name in ("tan2_h", "theta_h", "theta_d", "above_horizon"):
        torch.testing.assert_close(getattr(pairs, name), getattr(full, name), rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(Pairs.from_cosines(full.cos_i, tan2_h=full.tan2_h).theta_h, full.theta_h)


def test_from_cosines_refuses_what_it_cannot_know() -> None:
    for name in ("cos_o", "cos_h", "cos_d", "tan2_h", "theta_h", "theta_d", "phi_d", "wi", "wo"):
        with pytest.raises(ShapeError, match=rf"^Pairs: {name} is needed, but only cos_i were given$"):
            getattr(Pairs.from_cosines(torch.ones(3)), name)


def test_wrong_shape_is_refused() -> None:
    message = "Pairs: expected directions (..., N, 3), found wi (5, 3) and wo (5, 2)"
    with pytest.raises(ShapeError, match=f"^{re.escape(message)}$"):
        Pairs.from_directions(torch.ones(5, 3), torch.ones(5, 2))


def test_repr_says_what_is_known() -> None:
    assert repr(Pairs.from_cosines(torch.ones(2, 3))) == "Pairs((2, 3), torch.float32, cpu, known: cos_i)"
    assert repr(Pairs()) == "Pairs()"
    vectors = Pairs(wi=torch.ones(2, 5, 3), wo=torch.ones(2, 5, 3))
    assert repr(vectors) == "Pairs((2, 5), torch.float32, cpu, known: wi, wo)"


def test_an_unknown_quantity_is_refused() -> None:
    with pytest.raises(UsageError, match=r"^Pairs: unknown quantity 'cos_x'; expected wi, wo, cos_i, "):
        Pairs(cos_x=torch.ones(3))


def test_items_make_the_same_pairs() -> None:
    pairs = random_pairs(4)
    again = Pairs(**dict(pairs.items()))
    for name, value in everything(pairs).items():
        assert torch.equal(getattr(again, name), value), name


def test_unsqueeze_puts_a_shared_material_in_front() -> None:
    pairs = random_pairs(4)
    tan2 = pairs.cached(squared, lambda: squared(pairs))
    shared = pairs.unsqueeze()
    assert shared.shape == (1, 4) and shared.wi.shape == (1, 4, 3)
    for name, value in everything(shared).items():
        assert torch.equal(value[0], getattr(pairs, name)), name
    assert torch.equal(shared.cached(squared, lambda: torch.empty(0))[0], tan2)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda pairs: pickle.loads(pickle.dumps(pairs))])
def test_copies_know_the_same(copied: Callable[[Pairs], Pairs]) -> None:
    pairs = random_pairs(2, 4)
    everything(pairs)
    pairs.cached(squared, lambda: squared(pairs))
    made = copied(pairs)
    assert repr(made) == repr(pairs)
    for name, value in everything(made).items():
        assert torch.equal(value, getattr(pairs, name)), name
    assert torch.equal(made.cached(squared, lambda: squared(made)), squared(pairs))


def test_differentiable() -> None:
    wi, wo = hemisphere(6, seed=3).requires_grad_(), hemisphere(6, seed=4).requires_grad_()

    def quantities(wi: torch.Tensor, wo: torch.Tensor) -> tuple[torch.Tensor, ...]:
        pairs = Pairs.from_directions(wi, wo)
        return pairs.cos_h, pairs.cos_d, pairs.tan2_h, pairs.theta_h, pairs.theta_d, pairs.phi_d

    assert torch.autograd.gradcheck(quantities, (wi, wo))


def squared(pairs: Pairs) -> Tensor:
    return pairs.cos_h.square()


def test_what_lobes_derive_is_kept_and_follows_a_selection() -> None:
    wi, wo = hemisphere(1, 9, seed=1), hemisphere(1, 9, seed=2)
    pairs = Pairs.from_directions(wi, wo)
    made = []

    def make() -> Tensor:
        made.append(1)
        return squared(pairs)

    first = pairs.cached(squared, make)
    assert pairs.cached(squared, make) is first and len(made) == 1
    part = pairs.select(samples=slice(2, 5))
    assert torch.equal(part.cached(squared, make), first[:, 2:5]) and len(made) == 1
    assert part.to(dtype=torch.float32).cached(squared, make).dtype == torch.float32
    moving = Pairs.from_directions(wi.requires_grad_(), wo)
    value = moving.cached(squared, lambda: squared(moving))
    assert value.requires_grad
    assert moving.cached(squared, lambda: squared(moving)) is not value  # a graph is not kept


def test_what_is_kept_belongs_to_who_asked() -> None:
    """Functions of one name in two modules, a class, a module, and two quantities of one owner keep apart."""
    pairs = random_pairs(3)
    other = type(squared)(squared.__code__, {}, "squared")
    other.__module__ = "somebody_elses"
    owners = [(squared, ""), (other, ""), (squared, "second"), (Pairs, ""), (math, "")]
    kept = [pairs.cached(owner, lambda k=k: torch.full((3,), float(k)), name) for k, (owner, name) in enumerate(owners)]
    assert [value[0].item() for value in kept] == [0, 1, 2, 3, 4]
    for (owner, name), value in zip(owners, kept, strict=True):
        assert pairs.cached(owner, lambda: torch.empty(0), name) is value
    assert {name for name, _ in pairs.items()} <= set(QUANTITIES)
    with pytest.raises(UsageError, match=r"^Pairs.cached: expected an owner at the top of a module, found .*<lambda>$"):
        pairs.cached(lambda: None, lambda: torch.empty(0))


def test_joined_pairs_are_one_after_the_other() -> None:
    """Shared ones beside those of each material, with all that isotropic lobes ask for."""
    shared = Pairs.from_half_diff(*torch.rand(3, 1, 4, dtype=torch.float64))
    own = Pairs.from_directions(hemisphere(2, 3, seed=1), hemisphere(2, 3, seed=2))
    both = Pairs.joined([shared, own])
    assert both.shape == (2, 7)
    for name in ("cos_i", "cos_o", "cos_h", "cos_d", "tan2_h", "theta_h", "theta_d", "phi_d", "above_horizon"):
        value = getattr(both, name)
        assert torch.equal(value[:, :4], getattr(shared, name).expand(2, 4))
        assert torch.equal(value[:, 4:], getattr(own, name))
    assert Pairs.joined([shared.select(0), shared]).shape == (1, 8)
    with pytest.raises(ShapeError, match="is needed, but only cos_i were given"):
        Pairs.joined([shared, Pairs.from_cosines(torch.ones(1, 2, dtype=torch.float64))])


ABOUT_THE_NORMAL = ("slope_x", "slope_y", "phi_h")


@given(quarter, quarter, half_turn, turn)
def test_the_half_vectors_azimuth(theta_h: float, theta_d: float, phi_d: float, phi_h: float) -> None:
    """From angles with phi_h and from the directions: the same slopes and azimuth, and the same directions."""
    assume(theta_d < math.pi / 2 - 1e-3 and theta_h < math.pi / 2 - 1e-3)
    vectors = directions(theta_h, theta_d, phi_d, phi_h)
    angles = Pairs.from_half_diff(*(torch.tensor([x], dtype=torch.float64) for x in (theta_h, theta_d, phi_d, phi_h)))
    assert angles.is_oriented and vectors.is_oriented
    for name in ("slope_x", "slope_y", "wi", "wo"):
        scale = 1 + math.tan(theta_h) ** 2 / math.cos(theta_d)
        torch.testing.assert_close(getattr(angles, name), getattr(vectors, name), rtol=1e-12, atol=1e-14 * scale)
    assume(theta_h > 1e-3)
    turned = (vectors.phi_h - angles.phi_h).item()
    assert (math.cos(turned), math.sin(turned)) == pytest.approx((1, 0), abs=1e-10)


def test_slopes_keep_their_digits_in_float32() -> None:
    generator = np.random.default_rng(3)
    for exponent in (-6, -3, -1):
        theta_h = 10.0**exponent * generator.uniform(1, 9, 200)
        theta_d, phi_d, phi_h = generator.uniform(0, 1.3, 200), *generator.uniform(0, math.pi, (2, 200))
        wi, wo = (torch.from_numpy(vector).float() for vector in from_half_diff(theta_h, theta_d, phi_d, phi_h))
        half = wi.double() + wo.double()
        pairs = Pairs.from_directions(wi, wo)
        # A component is as good as the directions are, which have 24 bits each.
        for name, k in (("slope_x", 0), ("slope_y", 1)):
            assert getattr(pairs, name).dtype == torch.float32
            torch.testing.assert_close(getattr(pairs, name).double(), half[:, k] / half[:, 2], rtol=1e-6, atol=0)
        angles = (torch.from_numpy(one).float() for one in (theta_h, theta_d, phi_d, phi_h))
        given = Pairs.from_half_diff(*angles)
        expected = np.tan(theta_h) * np.cos(phi_h)
        error = np.abs(given.slope_x.double().numpy() - expected) / np.tan(theta_h)
        assert error.max() < 1e-6


def test_pairs_without_an_azimuth_are_not_oriented() -> None:
    """Not of cosines, not of half and difference angles alone, and not after directions were derived of these."""
    full = random_pairs(1, 5)
    angles = Pairs.from_half_diff(full.theta_h, full.theta_d, full.phi_d)
    assert angles.wi.shape == (1, 5, 3) and angles.wo.shape == (1, 5, 3)
    cosines = Pairs.from_cosines(full.cos_i, full.cos_o, full.cos_h, full.cos_d, full.tan2_h)
    for pairs in (angles, angles.to(dtype=torch.float32), angles.select(samples=[1]), cosines, Pairs.joined([full])):
        assert not pairs.is_oriented
        for name in ABOUT_THE_NORMAL:
            with pytest.raises(ShapeError, match=rf"^Pairs: {name} is needed, but only "):
                getattr(pairs, name)


def test_azimuths_follow_what_is_made_of_pairs() -> None:
    full = random_pairs(2, 7)
    everything(full)  # what was derived changes nothing
    angles = Pairs.from_half_diff(full.theta_h, full.theta_d, full.phi_d, full.phi_h)
    for pairs in (full, angles):
        ways = [
            (pairs.select([1], [4, 2]), lambda value: value[[1]][:, [4, 2]]),
            (pairs.unsqueeze(), lambda value: value[None]),
            (pickle.loads(pickle.dumps(pairs)), lambda value: value),
            (Pairs(**dict(pairs.items())), lambda value: value),
            (Pairs.joined([pairs, pairs], oriented=True), lambda value: torch.cat([value, value], 1)),
        ]
        for made, changed in ways:
            assert made.is_oriented
            for name in (*ABOUT_THE_NORMAL, "wi", "wo"):
                torch.testing.assert_close(getattr(made, name), changed(getattr(pairs, name)), rtol=1e-12, atol=1e-14)
        half = pairs.to(dtype=torch.float16)
        wide = half.widened()
        assert wide.is_oriented and wide.dtype == torch.float32
        torch.testing.assert_close(wide.slope_x.double(), pairs.slope_x, rtol=2e-2, atol=2e-2)
    with pytest.raises(ShapeError, match="is needed"):
        Pairs.joined([full, Pairs.from_half_diff(full.theta_h, full.theta_d, full.phi_d)], oriented=True)


def test_slopes_are_differentiable() -> None:
    wi, wo = hemisphere(6, seed=3).requires_grad_(), hemisphere(6, seed=4).requires_grad_()

    def quantities(wi: Tensor, wo: Tensor) -> tuple[Tensor, ...]:
        pairs = Pairs.from_directions(wi, wo)
        return pairs.slope_x, pairs.slope_y, pairs.phi_h

    assert torch.autograd.gradcheck(quantities, (wi, wo))
    # On the axes, at the normal and at the horizon they are numbers.
    special = torch.tensor([[0.6, 0, 0.8], [0, 0, 1], [1, 0, 0], [0.6, 0, -0.8]], dtype=torch.float64).requires_grad_()
    other = special.detach() * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    pairs = Pairs.from_directions(special, other)
    total = pairs.slope_x + pairs.slope_y + pairs.phi_h
    assert total.isfinite().all()
    (gradient,) = torch.autograd.grad(total.sum(), special)
    assert gradient.isfinite().all()
