"""What the values of every registered loss keep to. A new loss needs a plain formula here."""

import json
from collections.abc import Callable
from importlib.resources import files

import numpy as np
import pytest
import torch
from helpers.directions import Array
from helpers.loss_cases import WITH_EPS, every_loss, make, some_pairs, some_values
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.losses import LOSSES, CompressedLoss
from torchbrdf.losses.base import weighted_mean
from torchbrdf.pairs import Pairs

DTYPES = [torch.float32, torch.float64]


def rms(difference: Array, weight: Array) -> float:
    return np.sqrt(np.sum(weight * difference**2) / np.sum(weight))


def plain_compressed(p: Array, t: Array, cos: Array, weight: Array, exponent: float = 1 / 3) -> float:
    p, t = np.maximum(p, 0), np.maximum(t, 0)
    return rms((p * cos) ** exponent - (t * cos) ** exponent, weight)


def plain_log(p: Array, t: Array, cos: Array, weight: Array) -> float:
    return rms(np.log(1 + np.maximum(p, 0) * cos) - np.log(1 + np.maximum(t, 0) * cos), weight)


def plain_cube_root(p: Array, t: Array, cos: Array, weight: Array) -> float:
    return np.sqrt(np.sum(weight * np.cbrt(((p - t) * cos) ** 2)) / np.sum(weight))


def plain_learned(p: Array, t: Array, cos: Array, theta_h: Array, theta_d: Array, weight: Array) -> float:
    """Bin after bin, with the constants that come with torchbrdf; cos (N, 1), weight (N,)."""
    w1, w2, w3, w4 = json.loads((files("torchbrdf.assets") / "learned_metric.json").read_text())["constants"].values()
    x, y, light = np.maximum(p, 0) * cos, np.maximum(t, 0) * cos, np.array([0.2126, 0.7152, 0.0722])
    centres_h, centres_d = [0, 5, 15, 35, 70], [25, 50, 75]
    a, b, e = np.full((5, 3), np.nan), np.full((5, 3), np.nan), np.full((5, 3, 3), np.nan)
    for h in range(5):
        for k in range(3):
            high = np.interp(np.degrees(theta_h), centres_h, np.eye(5)[h])
            wide = np.interp(np.degrees(theta_d), centres_d, np.eye(3)[k])
            if not np.any(weight * high * wide):  # the means below are of the other bins
                continue
            one, other = (np.average(z, 0, weight * high * wide) for z in (x, y))
            a[h, k] = np.log(light @ one + 1e-3) - np.log(light @ other + 1e-3)
            b[h, k] = np.sqrt(np.mean((np.log(one + 1e-3) - np.log(other + 1e-3)) ** 2))
            e[h, k] = np.cbrt(one + 1e-3) - np.cbrt(other + 1e-3)
    gloss = [
        np.nanmean(a[:2, k]) - np.nanmean(a[3:, k])
        for k in range(2)
        if not (np.isnan(a[:2, k]).all() or np.isnan(a[3:, k]).all())
    ]
    colors = [np.nanmean(e[h], 0) for h in (2, 3, 4) if not np.isnan(e[h]).all()]
    v = np.mean(colors, 0) if colors else np.zeros(3)
    single = np.abs(np.log(x + 1e-3) - np.log(y + 1e-3)).mean(1)
    return (
        w1 * abs(np.mean(gloss) if gloss else 0)
        + w2 * np.sqrt(np.mean((v - light @ v) ** 2))
        + w3 * np.nanmean(b)
        + w4 * np.average(single, weights=weight)
    )


# Values (N, 3), cosine (N, 1) and weight (N, 3); the solid angle is put into the weight by the test.
PLAIN: dict[str, Callable[..., float]] = {
    "rms": lambda p, t, cos, weight: rms(p - t, weight),
    "cosine_rms": lambda p, t, cos, weight: rms((p - t) * cos, weight),
    "cube_root": plain_cube_root,
    "compressed": plain_compressed,
    "learned": plain_learned,
    "log": plain_log,
    "solid_angle_cosine_rms": lambda p, t, cos, weight: rms((p - t) * cos, weight),
}


def test_every_loss_has_a_formula_here() -> None:
    assert set(PLAIN) == set(LOSSES), "give a new loss a plain formula in PLAIN"


def plain(name: str, prediction: Tensor, target: Tensor, pairs: Pairs, weight: Tensor | None = None) -> float:
    """The plain formula for one material."""
    wi, wo = pairs.wi.numpy(), pairs.wo.numpy()
    weight = torch.ones_like(prediction) if weight is None else weight.expand(prediction.shape)
    weights = weight.numpy()
    if name == "learned":
        half = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
        theta_h = np.arctan2(np.hypot(half[:, 0], half[:, 1]), np.abs(half[:, 2]))
        theta_d = np.arccos(np.clip(np.sum(half * wi, -1), -1, 1))
        cosines = np.maximum(wi[:, 2:], 0) * np.maximum(wo[:, 2:], 0)
        return plain_learned(prediction.numpy(), target.numpy(), cosines, theta_h, theta_d, weights[:, 0])
    if name == "solid_angle_cosine_rms":
        half = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
        theta_h, theta_d = np.arccos(np.abs(half[:, 2])), np.arccos(np.sum(half * wi, -1))
        weights = weights * (np.sqrt(theta_h) * np.sin(theta_h) * np.sin(theta_d) * np.cos(theta_d))[:, None]
    return PLAIN[name](prediction.numpy(), target.numpy(), np.maximum(wi[:, 2:], 0), weights)


@every_loss
@pytest.mark.parametrize("weighted", [False, True])
def test_formula(name: str, weighted: bool) -> None:
    """1e-10 against numpy, also with negative values, zeros, and light from below."""
    p, t, pairs = some_values(200, seed=3), some_values(200, seed=4), some_pairs(200)
    p[:5], t[3:10], t[10:20], p[15:25] = 0, 0, -0.1 * t[10:20], -0.1 * p[15:25]
    wi = pairs.wi.clone()
    wi[50:60, 2] *= -1
    pairs = Pairs.from_directions(wi, pairs.wo)
    weight = torch.rand(200, 1, generator=torch.Generator().manual_seed(5)).double() if weighted else None
    found = make(name)(p, t, pairs, weight)
    assert found.shape == ()
    assert found.item() == pytest.approx(plain(name, p, t, pairs, weight), rel=1e-10)


@pytest.mark.parametrize("exponent", [0.1, 1 / 2.2, 1.0, 2.0])
def test_exponents_of_the_compressed_loss(exponent: float) -> None:
    p, t, pairs = some_values(50, seed=3), some_values(50, seed=4), some_pairs(50)
    found = CompressedLoss(exponent, eps=0.0)(p, t, pairs).item()
    expected = plain_compressed(p.numpy(), t.numpy(), pairs.cos_i.numpy()[:, None], np.ones((50, 3)), exponent)
    assert found == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("exponent", [0.0, -1.0, 2.5])
def test_refused_exponents(exponent: float) -> None:
    with pytest.raises(UsageError, match=f"expected an exponent above 0 and at most 2, found {exponent}"):
        CompressedLoss(exponent)


@every_loss
@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("dtype", DTYPES)
def test_nothing_between_equals(name: str, dtype: torch.dtype, exact: bool) -> None:
    """Error 0 and gradient 0 for identical inputs; finite gradients where only some are identical, or 0."""
    target, pairs = some_values(2, 40, dtype=dtype), some_pairs(2, 40, dtype=dtype)
    target[:, :7] = 0
    prediction = target.clone().requires_grad_()
    error = make(name, exact)(prediction, target, pairs)
    assert error.tolist() == [0, 0]
    (gradient,) = torch.autograd.grad(error.sum(), prediction)
    assert not gradient.any()

    changed = target.clone()
    changed[:, 5:20] *= 1.5
    changed[:, 0] = -0.1
    prediction, loss = changed.requires_grad_(), make(name, exact)
    (gradient,) = torch.autograd.grad(loss(prediction, target, pairs).sum(), prediction)
    assert gradient.isfinite().all()
    assert ((gradient * (prediction - target))[:, 7:20].sum((1, 2)) > 0).all()
    if loss.is_separable():  # one value has no say in how another counts
        assert (gradient[:, 7:20] > 0).all()


@every_loss
@pytest.mark.parametrize("exact", [True, False])
def test_gradcheck(name: str, exact: bool) -> None:
    """Away from equal values, where a cube root has a cusp."""
    target, pairs = some_values(2, 4, seed=4), some_pairs(2, 4)
    factor = torch.tensor([0.4, 3.0], dtype=torch.float64)[torch.arange(24).reshape(2, 4, 3) % 2]
    weight = torch.tensor([[1.0], [0.5], [0.0], [2.0]], dtype=torch.float64)
    loss, prediction = make(name, exact), (factor * target).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: loss(x, target, pairs, weight), prediction)
    assert torch.autograd.gradcheck(lambda x: loss(target, x, pairs), prediction)


@every_loss
def test_weight_0_does_not_count(name: str) -> None:
    p, t, pairs = some_values(30, seed=3), some_values(30, seed=4), some_pairs(30)
    weight = torch.ones(30, 1, dtype=torch.float64)
    weight[20:] = 0
    other = torch.where(weight > 0, p, 7.0)
    expected = make(name)(p[:20], t[:20], pairs.select(samples=slice(20)))
    torch.testing.assert_close(make(name)(other, t, pairs, weight), expected, rtol=1e-12, atol=0)


@every_loss
def test_constant_weights_do_nothing(name: str) -> None:
    p, t, pairs = some_values(2, 30, seed=3), some_values(2, 30, seed=4), some_pairs(2, 30)
    expected = make(name)(p, t, pairs)
    for shape in [(1, 1), (30, 1), (2, 30, 1), (2, 30, 3), (1, 30, 3)]:
        weight = torch.full(shape, 0.3, dtype=torch.float64)
        torch.testing.assert_close(make(name)(p, t, pairs, weight), expected, rtol=1e-12, atol=0)


@every_loss
def test_a_weight_of_2_is_a_sample_twice(name: str) -> None:
    p, t, pairs = some_values(30, seed=3), some_values(30, seed=4), some_pairs(30)
    count = torch.arange(30) % 4
    twice = torch.repeat_interleave(torch.arange(30), count)
    expected = make(name)(p[twice], t[twice], pairs.select(samples=twice))
    found = make(name)(p, t, pairs, count[:, None].double())
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=0)


@every_loss
def test_channels_count_on_their_own(name: str) -> None:
    """n counts every channel: weight 0 for two of three is a comparison of one."""
    p, t, pairs = some_values(30, seed=3), some_values(30, seed=4), some_pairs(30)
    green = torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64)
    expected = make(name)(p[:, 1:2], t[:, 1:2], pairs)
    torch.testing.assert_close(make(name)(p, t, pairs, green), expected, rtol=1e-12, atol=0)


@every_loss
def test_without_any_weight_there_is_no_error(name: str) -> None:
    p, weight = some_values(2, 5), torch.ones(2, 5, 1, dtype=torch.float64)
    weight[1] = 0
    error = make(name)(p * 2, p, some_pairs(2, 5), weight)
    assert error.isnan().tolist() == [False, True]


@every_loss
@pytest.mark.parametrize("lead", [(), (1,), (3,), (2, 3)])
def test_any_batch_shape(name: str, lead: tuple[int, ...]) -> None:
    p, t, loss = some_values(*lead, 20, seed=3), some_values(*lead, 20, seed=4), make(name)
    for pairs in (some_pairs(*lead, 20), some_pairs(20)):
        found = loss(p, t, pairs)
        assert found.shape == lead
        wi, wo = pairs.wi.expand(*lead, 20, 3), pairs.wo.expand(*lead, 20, 3)
        for index in np.ndindex(*lead):
            one = loss(p[index], t[index], Pairs.from_directions(wi[index], wo[index]))
            torch.testing.assert_close(found[index], one, rtol=1e-12, atol=0)


@every_loss
def test_one_target_for_many_predictions(name: str) -> None:
    p, t, pairs, loss = some_values(4, 20, seed=3), some_values(1, 20, seed=4), some_pairs(1, 20), make(name)
    torch.testing.assert_close(loss(p, t, pairs), loss(p, t.expand_as(p), pairs), rtol=1e-12, atol=0)


@every_loss
def test_reduction(name: str) -> None:
    p, t, pairs = some_values(4, 20, seed=3), some_values(4, 20, seed=4), some_pairs(4, 20)
    errors = make(name)(p, t, pairs)
    torch.testing.assert_close(make(name, reduction="mean")(p, t, pairs), errors.mean())
    torch.testing.assert_close(make(name, reduction="sum")(p, t, pairs), errors.sum())
    assert LOSSES[name]().reduction == "mean"
    with pytest.raises(UsageError, match="expected reduction none, mean or sum, found 'average'"):
        LOSSES[name](reduction="average")


@every_loss
def test_cosines_suffice(name: str) -> None:
    """What `needs` says can be had from cosines that somebody already has."""
    full, p, t = some_pairs(20), some_values(20, seed=3), some_values(20, seed=4)
    source = {"cos_i": "cos_i", "cos_o": "cos_o", "theta_h": "cos_h", "theta_d": "cos_d"}
    cosines = {"cos_i": full.cos_i, **{source[need]: getattr(full, source[need]) for need in make(name).needs}}
    torch.testing.assert_close(make(name)(p, t, Pairs.from_cosines(**cosines)), make(name)(p, t, full))


@every_loss
def test_without_pairs(name: str) -> None:
    p, t, loss = some_values(20, seed=3), some_values(20, seed=4), make(name)
    if not loss.needs:
        assert loss(p, t) == loss(p, t, None)
        return
    with pytest.raises(ShapeError, match=rf"^{type(loss).__name__}: needs pairs for {', '.join(loss.needs)}"):
        loss(p, t)


@every_loss
def test_what_does_not_fit_is_refused(name: str) -> None:
    p, pairs, loss = some_values(2, 20), some_pairs(2, 20), make(name)
    kind = type(loss).__name__
    with pytest.raises(ShapeError, match=rf"^{kind}: expected values \(\.\.\., N, C\), found .*\(3,\)"):
        loss(p[0, 0], p, pairs)
    with pytest.raises(
        ShapeError, match=rf"^{kind}: prediction and target differ .* \(2, 19, 3\), target \(2, 20, 3\)"
    ):
        loss(p[:, 1:], p, pairs)
    with pytest.raises(ShapeError, match=rf"^{kind}: weights \(20,\) do not broadcast to values \(2, 20, 3\)$"):
        loss(p, p, pairs, torch.ones(20))
    if loss.needs:
        with pytest.raises(ShapeError, match=rf"^{kind}: 19 pairs for values \(2, 20, 3\)$"):
            loss(p, p, some_pairs(2, 19))


@every_loss
def test_float32_sums(name: str) -> None:
    """200,000 samples, values of five decades."""
    p, t, pairs = some_values(200_000, seed=3), some_values(200_000, seed=4), some_pairs(200_000)
    weight = (torch.arange(200_000) % 3)[:, None]
    single = make(name)(p.float(), t.float(), pairs.to(dtype=torch.float32), weight.float())
    assert single.dtype == torch.float32
    assert single.item() == pytest.approx(make(name)(p, t, pairs, weight.double()).item(), rel=1e-5)


def test_sums_are_kept_in_float64() -> None:
    values = some_values(2, 10000, dtype=torch.float32)
    expected = values.double().mean((-2, -1))
    for weight in (None, torch.full((1, 1), 2.0)):
        torch.testing.assert_close(weighted_mean(values, weight), expected, rtol=1e-13, atol=0)


@pytest.mark.parametrize("name", WITH_EPS)
@pytest.mark.parametrize("size", [1e-4, 1e-2, 1.0, 1e2])
@pytest.mark.parametrize("ratio", [0.5, 1.01, 10.0])
def test_the_default_eps_does_not_matter(name: str, size: float, ratio: float) -> None:
    """Below 1e-4 relative for values and differences that BRDFs have."""
    target = torch.full((1, 3), size, dtype=torch.float64)
    pairs = Pairs.from_cosines(*torch.full((4, 1), 0.7, dtype=torch.float64))
    exact, found = (make(name, exact)(ratio * target, target, pairs).item() for exact in (True, False))
    assert found == pytest.approx(exact, rel=1e-4)
