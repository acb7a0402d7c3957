"""Losses that somebody else wrote, as a user would: each is fitted, and what is missing or wrong is said in a line."""

import warnings

import pytest
import torch
from helpers.known_models import measured_from, some_pairs
from torch import nn

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.fitting import Batches, SlowFitWarning, fit, score
from torchbrdf.lobes import Lambert, Sum, Ward, make_model
from torchbrdf.losses import LOSSES, CosineRMSLoss, FunctionLoss, LearnedLoss, Loss, RMSLoss, as_loss, make_loss
from torchbrdf.measured import Measured

TRUTH = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=[0.2, 0.25, 0.3], roughness=0.15)).double()


class EncodeAlone(Loss):
    needs = ("cos_i",)

    def encode(self, values, pairs):
        return (values.clamp_min(0) * pairs.cos_i[..., None] + 1e-3).sqrt()


class L1Loss(Loss):
    smoothing_widths = (0.1, 0.01, 0.001)

    def encode(self, values, pairs):
        return values

    def penalty(self, difference):
        return difference.abs()


class Fourth(Loss):
    def encode(self, values, pairs):
        return values

    def penalty(self, difference):
        return difference.square() + difference**4


class Lightness(Loss):
    """Mixes channels, so that it is no function of one value at a time."""

    def encode(self, values, pairs):
        return torch.cat([values.mean(-1, keepdim=True), values[..., 1:] - values[..., :1]], -1)


class ForwardAlone(Loss):
    def forward(self, prediction, target, pairs=None, weight=None):
        return (prediction - target).square().mean()


class ErrorAlone(Loss):
    def error(self, prediction, target, pairs=None, weight=None):
        square = (prediction - target).square() * (1 if weight is None else weight)
        return square.mean((1, 2)).sqrt().float()  # in a dtype of its own


class Scaled(LearnedLoss):
    """Changes a binned loss's encoding without derivatives of it."""

    def encode(self, values, pairs):
        return 2 * super().encode(values, pairs)


class AModule(nn.Module):
    def forward(self, prediction, target):
        return (prediction.clamp_min(0).sqrt() - target.sqrt()).square()


def with_pairs(prediction, target, pairs):
    return ((prediction - target) * pairs.cos_i[..., None]).square().mean()


def weighing(prediction, target, weight=None):
    square = (prediction - target).square()
    return square.mean() if weight is None else (square * weight).sum() / weight.sum()


POINTWISE = [EncodeAlone(), L1Loss(), Fourth()]
GENERAL = {
    "mixes channels": Lightness(),
    "forward alone": ForwardAlone(),
    "error alone": ErrorAlone(),
    "binned": Scaled(),
    "MSELoss": nn.MSELoss(),
    "elementwise MSELoss": nn.MSELoss(reduction="none"),
    "a module": AModule(),
    "lambda": lambda p, t: ((p - t) ** 2).mean(),
    "a material": lambda p, t: ((p - t) ** 2).mean((1, 2)),
    "a pair": lambda p, t: ((p - t) ** 2).mean(-1),
    "with pairs": with_pairs,
    "with weight": weighing,
}
EVERY = {type(loss).__name__: loss for loss in POINTWISE} | GENERAL


def two_materials():
    """One that the model can be, and one with holes."""
    values = TRUTH(some_pairs(600)).detach().repeat(2, 1, 1)
    values[1, ::3] = torch.nan
    return Measured.from_samples(some_pairs(600), values)


@pytest.mark.parametrize("name", EVERY)
def test_a_fit_finds_what_values_were_made_with(name):
    with pytest.warns(SlowFitWarning, match=r"^\S+: no derivatives of its own: .* by autograd, which is slower$"):
        result = fit(make_model("ward", 1), two_materials(), EVERY[name], diffuse="fit", samples=None, max_theta=90.0)
    for own, truth in zip(result.model.parameters(), TRUTH.parameters(), strict=True):
        torch.testing.assert_close(own, truth.to(own).expand_as(own), rtol=0.02, atol=2e-3)
    assert result.error.dtype == torch.float64 and (result.error < 0.02).all()
    loss = as_loss(EVERY[name])
    found = score(result.model, two_materials().within(90.0), [loss, RMSLoss()])
    torch.testing.assert_close(found[0], result.error, rtol=1e-4, atol=1e-9)
    assert result.loss == loss.registered_name


@pytest.mark.parametrize("loss", POINTWISE, ids=lambda loss: type(loss).__name__)
def test_without_closed_derivatives_a_mean_of_penalties_still_has_curvature(loss):
    assert loss.is_separable() and not loss.has_closed_derivatives
    with pytest.warns(SlowFitWarning):
        result = fit(make_model("ward", 1), measured_from(TRUTH, some_pairs(600)), loss, samples=None)
    assert "7 starts" in result.history[0].name and str(result.status[0]) == "converged"


def test_a_loss_with_derivatives_is_not_said_to_be_slow():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit(make_model("ward", 1), measured_from(TRUTH, some_pairs(300)), CosineRMSLoss(), samples=None)


def test_a_subset_then_all_samples_and_the_staged_procedure():
    measured = measured_from(TRUTH, some_pairs(900))
    for strategy in ("staged", "global"):
        with pytest.warns(SlowFitWarning):
            result = fit(make_model("ward", 1), measured, nn.MSELoss(), samples=200, strategy=strategy)
        assert "all samples" in result.history[-1].name and result.error.item() < 1e-3


def test_a_database_under_a_function(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SlowFitWarning)
        batches = Batches(make_model("ward", 1), nn.MSELoss(), out=tmp_path, samples=None)
        (record,) = batches.run([measured_from(TRUTH, some_pairs(300))])
        assert record.loss == "MSELoss"
        assert Batches(make_model("ward", 1), nn.MSELoss(), out=tmp_path, samples=None).done


class Mistyped(Loss):
    def encode(self, values, pairs):
        return values * pairs.cos_x


class Reducing(Loss):
    def encode(self, values, pairs):
        return values.mean(-1)


@pytest.mark.filterwarnings("ignore::torchbrdf.fitting.SlowFitWarning")
def test_a_mistake_within_encode_is_said_as_it_is():
    measured = measured_from(TRUTH, some_pairs(300))
    with pytest.raises(AttributeError, match="cos_x"):
        fit(make_model("ward", 1), measured, Mistyped(), samples=None)


def test_encode_gives_a_value_for_each_value():
    values = torch.rand(2, 5, 3)
    with pytest.raises(
        ShapeError, match=r"Reducing: expected a value for each of values \(2, 5, 3\) .* found \(2, 5\)"
    ):
        Reducing()(values, values)


def test_what_is_registered_may_be_a_class_an_instance_or_a_function(monkeypatch):
    one, other = torch.rand(2, 5, 3), torch.rand(2, 5, 3)
    offers = {"kind": L1Loss, "module": nn.L1Loss, "instance": nn.L1Loss(), "function": nn.functional.l1_loss}
    monkeypatch.setattr(LOSSES, "_things", {**dict(LOSSES.items()), **offers})
    expected = (one - other).abs().double().mean((1, 2))
    torch.testing.assert_close(make_loss("kind", "none")(one, other).double() ** 2, expected, rtol=1e-5, atol=0)
    for name in ("module", "instance", "function"):
        torch.testing.assert_close(make_loss(name, "none")(one, other).double(), expected, rtol=1e-5, atol=0)
    assert make_loss("kind").registered_name == "kind"


class NoGradient(nn.Module):
    def forward(self, prediction, target):
        return (prediction.detach() - target).square().mean()


@pytest.mark.parametrize(
    ("loss", "kind", "said"),
    [
        (3, UsageError, "loss: expected a Loss, a module or a function of .prediction, target., found int"),
        (lambda p: p.mean(), UsageError, "loss <lambda>: expected a function of .prediction, target.: too many"),
        (lambda p, t: 1.0, ShapeError, "<lambda>: expected a tensor from .prediction, target., found float"),
        (lambda p, t: p.mean(1), ShapeError, r"<lambda>: expected a scalar, .* \(1, 300, 3\), found \(1, 3\)"),
        (
            nn.MSELoss,
            UsageError,
            r"loss: expected an instance or a function, found the class MSELoss; write MSELoss",
        ),
        (NoGradient(), UsageError, "NoGradient: no gradient: it does not use the prediction"),
        (Loss(), NotImplementedError, "Loss: expected a method encode, error or forward, found none of them"),
    ],
)
@pytest.mark.filterwarnings("ignore::torchbrdf.fitting.SlowFitWarning")
def test_what_is_wrong_is_said_in_a_line(loss, kind, said):
    measured = Measured.from_samples(some_pairs(300).select(samples=slice(0, 300)), TRUTH(some_pairs(300)).detach())
    count = len(measured.pairs)
    with pytest.raises(kind, match=f"^{said}".replace("300", str(count))) as raised:
        fit(make_model("ward", 1), measured, loss, diffuse="fit", samples=None, max_theta=90.0)
    assert "\n" not in str(raised.value)


def test_weights_that_differ_need_a_value_for_each_pair():
    p, t = torch.rand(2, 5, 3), torch.rand(2, 5, 3)
    weight = torch.tensor([1.0, 2.0, 0.0, 1.0, 1.0])[:, None]
    with pytest.raises(ShapeError, match="MSELoss: weights that differ need a value for each pair"):
        FunctionLoss(nn.MSELoss(), "none")(p, t, None, weight)
    found = FunctionLoss(nn.MSELoss(reduction="none"), "none")(p, t, None, weight)
    torch.testing.assert_close(found, RMSLoss("none")(p, t, None, weight).square())
    torch.testing.assert_close(FunctionLoss(weighing, "none")(p, t, None, weight.expand(5, 3)), found)
    assert FunctionLoss(nn.MSELoss(), "none")(p, t, None, torch.zeros(5, 1)).isnan().all()


def test_what_is_overridden_is_not_derived_from_what_it_replaced():
    """A subclass of a formula with another encoding has the derivative of its own."""

    class Doubled(RMSLoss):
        def encode(self, values, pairs):
            return 2 * values

    values = torch.rand(1, 4, 3)
    encoded, slope = Doubled().encode_with_derivative(values, None)
    assert torch.equal(encoded, 2 * values) and torch.equal(slope, torch.full_like(values, 2))
    assert Doubled().objective == "pointwise" and not Doubled().has_closed_derivatives
    assert ErrorAlone.objective == ForwardAlone.objective == "autograd" and Scaled.objective == "binned"
