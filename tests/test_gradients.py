"""Gradients by directions, and second derivatives: finite wherever values are, and 0 where values are masked to 0."""

import itertools
import math
from collections.abc import Callable

import pytest
import torch
from helpers.directions import hemisphere
from helpers.picture_pairs import NAMES, pictures
from torch import Tensor

from torchbrdf.images import DIFFERENCES, Difference
from torchbrdf.lobes import LOBES, BoundedParameter, Lobe
from torchbrdf.losses import LOSSES, CosineRMSLoss, SolidAngleCosineRMSLoss
from torchbrdf.pairs import Pairs
from torchbrdf.roots import safe_norm, safe_ratio, safe_sqrt

every_lobe = pytest.mark.parametrize("name", LOBES)
every_loss = pytest.mark.parametrize("name", LOSSES)
every_difference = pytest.mark.parametrize("name", NAMES)
both_dtypes = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
QUANTITIES = ("cos_i", "cos_o", "cos_h", "cos_d", "tan2_h", "theta_h", "theta_d", "phi_d")
MIRROR, DOWN = torch.tensor([-1.0, -1.0, 1.0]), torch.tensor([1.0, 1.0, -1.0])


def special(dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Directions up, oblique, ever more grazing and below the horizon, each with each, its mirror and its opposite."""
    heights = [1e-3, 1e-6, 1e-8, 1e-10, 1e-17, 1e-20, 1e-25, 1e-30]
    some = [[0, 0, 1.0], [0.3, 0.2, 0.9], [1.0, 0, 0], [0, 1.0, 0], [0.6, 0, 0.8], [1e-4, 0, 1], [1e-10, 0, 1]]
    base = torch.tensor([*some, *([1.0, 0, height] for height in heights)], dtype=dtype)
    base = base / base.norm(dim=-1, keepdim=True)
    turned = [base, base * MIRROR.to(dtype), -base, base * DOWN.to(dtype)]
    pairs = [(one, other) for first in (base, turned[3]) for one in first for part in turned for other in part]
    wi, wo = (torch.stack(part) for part in zip(*pairs, strict=True))
    return wi, wo


def gradients(value: Tensor, inputs: tuple[Tensor, ...]) -> list[Tensor]:
    """Those of a sum; 0 by what it does not depend on."""
    if not value.requires_grad:
        return [torch.zeros_like(one) for one in inputs]
    found = torch.autograd.grad(value.sum(), inputs, allow_unused=True, create_graph=True)
    return [torch.zeros_like(one) if part is None else part for one, part in zip(inputs, found, strict=True)]


def at(spec: BoundedParameter, where: str) -> float:
    if where != "middle":
        return float(getattr(spec, where))
    return math.sqrt(spec.lower * spec.upper) if spec.log else (spec.lower + min(spec.upper, 1)) / 2


@both_dtypes
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_quantities_of_pairs(quantity: str, dtype: torch.dtype) -> None:
    wi, wo = (x.requires_grad_() for x in special(dtype))
    value = getattr(Pairs.from_directions(wi, wo), quantity)
    for found in gradients(value, (wi, wo)):
        assert found.isfinite().all()


@both_dtypes
def test_quantities_of_cosines(dtype: torch.dtype) -> None:
    cosines = torch.tensor([1.0, 0.5, 1e-3, 1e-12, 1e-19, 1e-25, 0.0], dtype=dtype)
    cos_h, cos_d = (x.clone().requires_grad_() for x in torch.cartesian_prod(cosines, cosines).unbind(-1))
    pairs = Pairs.from_cosines(cos_h.detach(), cos_h=cos_h, cos_d=cos_d)
    for quantity in ("tan2_h", "theta_h", "theta_d"):
        for found in gradients(getattr(pairs, quantity), (cos_h, cos_d)):
            assert found.isfinite().all(), quantity


@every_lobe
@both_dtypes
@pytest.mark.parametrize("where", ["lower", "start", "middle", "upper"])
def test_lobes_at_special_directions(name: str, dtype: torch.dtype, where: str) -> None:
    specs = LOBES[name].parameter_specs
    lobe: Lobe = LOBES[name](dtype=dtype, **{key: at(spec, where) for key, spec in specs.items()})
    wi, wo = (x.requires_grad_() for x in special(dtype))
    value = lobe(Pairs.from_directions(wi, wo))
    assert value.isfinite().all()
    below = (wi[:, 2] <= 0) | (wo[:, 2] <= 0)
    assert below.any() and not value[below].any()
    for total in (value, torch.log1p(value)):
        for found in gradients(total, (wi, wo)):
            assert found.isfinite().all()
            assert not found[below].any()


@every_lobe
def test_one_opposite_pair_spoils_no_light_that_others_share(name: str) -> None:
    angle = torch.tensor(0.3, requires_grad=True)
    light = torch.stack([angle.sin(), 0 * angle, angle.cos()])[None]
    viewers = torch.cat([hemisphere(5, seed=3, dtype=torch.float32), -light.detach()])
    lobe: Lobe = LOBES[name]()
    (expected,) = gradients(lobe(Pairs.from_directions(light, viewers[:5])), (angle,))
    (found,) = gradients(lobe(Pairs.from_directions(light, viewers)), (angle,))
    assert found.isfinite() and torch.equal(found, expected)


@every_lobe
def test_a_flat_normal_under_a_light_at_the_camera(name: str) -> None:
    """Where normals are optimised, and all start so: h = n in every pixel."""
    normal = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).repeat(4, 1).requires_grad_()
    x = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64) - normal[:, :1] * normal
    x = x / x.norm(dim=-1, keepdim=True)
    frame = torch.stack([x, torch.linalg.cross(normal, x), normal], 1)
    light = (frame @ torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None])[..., 0]
    value = LOBES[name](dtype=torch.float64)(Pairs.from_directions(light, light))
    assert gradients(value, (normal,))[0].isfinite().all()


@every_loss
@both_dtypes
def test_losses_at_special_directions(name: str, dtype: torch.dtype) -> None:
    """All pairs, those that reflect straight back alone, and exact mirror pairs alone."""
    wi, wo = special(dtype)
    target = torch.rand(len(wi), 3, dtype=dtype, generator=torch.Generator().manual_seed(0))
    for other, factor in itertools.product((wo, wi, wi * MIRROR.to(dtype)), (1.2, 1.0)):
        inputs = wi.clone().requires_grad_(), other.clone().requires_grad_()
        error = LOSSES[name]()(factor * target, target, Pairs.from_directions(*inputs))
        assert error.isfinite() and (error == 0) == (factor == 1)
        assert all(found.isfinite().all() for found in gradients(error, inputs))


@every_loss
def test_gradcheck_of_directions(name: str) -> None:
    wi, near = hemisphere(6, seed=1), hemisphere(6, seed=2)
    target = torch.rand(6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))

    def error(wi: Tensor, wo: Tensor) -> Tensor:
        return LOSSES[name]()(1.5 * target + 0.1, target, Pairs.from_directions(wi, wo))

    if name != "rms":  # which reads no directions
        assert torch.autograd.gradcheck(error, (wi.requires_grad_(), near.requires_grad_()))


def test_mirror_pairs_alone_have_a_mean() -> None:
    """Their solid angles are 0, in proportions that count: sin(theta_d) cos(theta_d)."""
    wi = hemisphere(50, seed=1)
    pairs = Pairs.from_directions(wi, wi * MIRROR.double())
    target = torch.rand(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    weight = (pairs.theta_d.sin() * pairs.theta_d.cos())[:, None]
    expected = CosineRMSLoss()(2 * target, target, pairs, weight)
    torch.testing.assert_close(SolidAngleCosineRMSLoss()(2 * target, target, pairs), expected)


# Second derivatives


def second(function: Callable[[Tensor], Tensor], start: Tensor) -> Tensor:
    """Products of the second derivatives with two vectors."""
    point = start.clone().requires_grad_()
    (slope,) = gradients(function(point), (point,))
    vectors = torch.ones_like(slope), torch.rand(slope.shape, generator=torch.Generator().manual_seed(0)).to(slope)
    return torch.stack([gradients(slope * vector, (point,))[0] for vector in vectors])


@every_loss
@both_dtypes
def test_second_derivatives_of_losses(name: str, dtype: torch.dtype) -> None:
    """At equal values, at some that are equal, at zeros and below."""
    wi = hemisphere(20, seed=1, dtype=dtype)
    pairs, loss = Pairs.from_directions(wi, wi.flip(0)), LOSSES[name]()
    target = 10 * torch.rand(2, 20, 3, generator=torch.Generator().manual_seed(0)).to(dtype)
    target[:, 0] = 0
    some = torch.where(torch.arange(20)[:, None] < 5, target, 1.3 * target)
    none = torch.zeros_like(target)
    for prediction, wanted in [(target, target), (some, target), (none, none), (-target, target), (none, target)]:
        assert second(lambda x, wanted=wanted: loss(x, wanted, pairs), prediction).isfinite().all()  # type: ignore[misc]


@every_loss
def test_gradgradcheck_of_losses(name: str) -> None:
    wi = hemisphere(4, seed=1)
    pairs, loss = Pairs.from_directions(wi, wi.flip(0)), LOSSES[name]()
    target = torch.rand(4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) + 0.5
    assert torch.autograd.gradgradcheck(lambda x: loss(x, target, pairs), (1.7 * target).requires_grad_())


@every_lobe
def test_gradgradcheck_of_lobes(name: str) -> None:
    """By directions, near the mirror direction."""
    specs = LOBES[name].parameter_specs
    lobe: Lobe = LOBES[name](dtype=torch.float64, **{key: at(spec, "middle") for key, spec in specs.items()})
    wi = hemisphere(3, seed=1)
    near = wi * MIRROR.double() + 0.2 * hemisphere(3, seed=2)
    inputs = wi.requires_grad_(), (near / near.norm(dim=-1, keepdim=True)).requires_grad_()

    def function(wi: Tensor, wo: Tensor) -> Tensor:
        return torch.log1p(lobe(Pairs.from_directions(wi, wo)))

    if name != "lambert":  # which reads no directions
        assert torch.autograd.gradgradcheck(function, inputs)


@every_difference
@both_dtypes
def test_second_derivatives_of_differences(name: str, dtype: torch.dtype) -> None:
    difference: Difference = DIFFERENCES[name](reduction="sum")
    side = max(difference.least_side, 12)
    reference = torch.rand(1, side, side, 3, generator=torch.Generator().manual_seed(0)).to(dtype)
    some = reference.clone()
    some[:, : side // 2] *= 0.9
    grey = reference[..., :1].expand_as(reference)
    black, white = torch.zeros_like(reference), torch.ones_like(reference)
    pairs = [(reference, reference), (some, reference), (black, black), (white, white), (grey, grey), (black, white)]
    for image, other in pairs:
        assert second(lambda x, other=other: difference.loss(x, other), image).isfinite().all()  # type: ignore[misc]


@every_difference
def test_gradgradcheck_of_differences(name: str) -> None:
    difference: Difference = DIFFERENCES[name](reduction="sum")
    image, reference, _ = pictures(difference, batch=1)
    point = torch.zeros(1, 1, 3, dtype=torch.float64, requires_grad=True)

    def loss(change: Tensor) -> Tensor:
        inner = torch.nn.functional.pad(change, (0, 0, 4, image.shape[2] - 5, 4, image.shape[1] - 5))
        return difference.loss(image + inner, reference)

    assert torch.autograd.gradgradcheck(loss, point)


# What they are made of


def test_roots_and_quotients() -> None:
    x = torch.tensor([4.0, 0.0], dtype=torch.float64, requires_grad=True)
    assert safe_sqrt(x).tolist() == [2, 0] and gradients(safe_sqrt(x), (x,))[0].tolist() == [0.25, 0]
    assert second(lambda x: safe_sqrt(x), x.detach())[0].tolist() == [-1 / 32, 0]
    assert safe_sqrt(torch.tensor([-1.0, torch.nan])).isnan().all()
    vectors = torch.tensor([[3.0, 4.0], [0.0, 0.0]], requires_grad=True)
    assert gradients(safe_norm(vectors), (vectors,))[0].flatten().tolist() == pytest.approx([0.6, 0.8, 0, 0])
    one, tiny = torch.tensor(1.0, requires_grad=True), torch.tensor(1e-30, requires_grad=True)
    assert safe_ratio(one, tiny).item() == pytest.approx(1e30)
    assert [found.item() for found in gradients(safe_ratio(one, tiny), (one, tiny))] == [0, 0]
    assert gradients(safe_ratio(3, one), (one,))[0].item() == -3
