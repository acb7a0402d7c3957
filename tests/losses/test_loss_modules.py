"""What is beside the values of every registered loss: its state, copies, functional form, tracing, and its use."""

import copy
import inspect
import pickle

import pytest
import torch
from helpers.caches import forget
from helpers.directions import hemisphere
from helpers.loss_cases import every_loss, make, some_pairs, some_values
from torch import Tensor

from torchbrdf.errors import ShapeError
from torchbrdf.lobes import Ward
from torchbrdf.losses import LOSSES, CompressedLoss, functional
from torchbrdf.measured.measured import Measured
from torchbrdf.pairs import Pairs


@every_loss
def test_a_state_dict_makes_a_loss_what_another_is(name: str) -> None:
    """Also one whose own weights were different and used before."""
    p, t, pairs = some_values(2, 30, seed=3), some_values(2, 30, seed=4), some_pairs(2, 30)
    one, other = make(name), make(name)
    state = {
        key: (1.5 + torch.arange(value.numel()).reshape(value.shape)) * value for key, value in one.state_dict().items()
    }
    before = other(p, t, pairs)
    one.load_state_dict(state)
    other.load_state_dict(one.state_dict())
    assert torch.equal(one(p, t, pairs), other(p, t, pairs))
    assert torch.equal(one(p, t, pairs), before) == (not state)
    assert sorted(one.state_dict()) == sorted(make(name).state_dict())


@every_loss
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision(name: str, dtype: torch.dtype) -> None:
    """Values, pairs and the loss itself: as right as the values that are left."""
    p, t, pairs = (
        x.to(dtype=dtype) for x in (some_values(2, 30, seed=3), some_values(2, 30, seed=4), some_pairs(2, 30))
    )
    expected = make(name)(p.double(), t.double(), pairs.widened().to(dtype=torch.float64))
    for loss in (make(name, exact=False), make(name, exact=False).to(dtype)):
        error = loss(p, t, pairs)
        assert error.dtype == dtype
        torch.testing.assert_close(error.double(), expected, rtol=0.01, atol=0)
        torch.testing.assert_close(loss.error(p, t, pairs), expected, rtol=1e-3, atol=0)


@every_loss
def test_copies(name: str) -> None:
    """Deep ones and pickled ones, after use: they are the same loss and carry no tensors of others."""
    p, t, pairs, loss = some_values(2, 3000, seed=3), some_values(2, 3000, seed=4), some_pairs(2, 3000), make(name)
    expected = loss(p, t, pairs)
    stored = pickle.dumps(loss)
    assert len(stored) < 20_000
    for same in (copy.deepcopy(loss), pickle.loads(stored)):
        assert torch.equal(same(p, t, pairs), expected) and repr(same) == repr(loss)


@every_loss
def test_the_functional_form_is_the_module(name: str) -> None:
    """With weights, every reduction, and the options of each."""
    p, t, pairs = some_values(2, 30, seed=3), some_values(2, 30, seed=4), some_pairs(2, 30)
    weight = torch.rand(30, 1, generator=torch.Generator().manual_seed(5)).double()
    function, own = getattr(functional, name), () if name == "rms" else (pairs,)
    for reduction in ("none", "mean", "sum"):
        expected = LOSSES[name](reduction=reduction)(p, t, pairs, weight)
        assert torch.equal(function(p, t, *own, weight, reduction=reduction), expected)
    assert torch.equal(function(p, t, *own), LOSSES[name]()(p, t, pairs))
    for key, value in {"exponent": 0.5, "eps": 1e-3}.items():
        if key in inspect.signature(LOSSES[name]).parameters:
            expected = LOSSES[name](**{key: value})(p, t, pairs)
            assert torch.equal(function(p, t, *own, **{key: value}), expected) and expected != LOSSES[name]()(
                p, t, pairs
            )


def test_every_loss_has_a_functional_form() -> None:
    assert sorted(functional.__all__) == sorted(LOSSES)


def test_what_is_printed() -> None:
    """The arguments that matter, as a call of the constructor."""
    assert repr(LOSSES["rms"]()) == "RMSLoss()"
    assert repr(LOSSES["rms"]("none")) == "RMSLoss(reduction='none')"
    assert repr(CompressedLoss(0.5)) == "CompressedLoss(exponent=0.5)"
    assert repr(CompressedLoss(0.5, "sum", eps=0.0)) == "CompressedLoss(exponent=0.5, reduction='sum', eps=0.0)"
    assert repr(LOSSES["cube_root"](eps=0.0)) == "CubeRootLoss(eps=0.0)"


@every_loss
def test_what_is_printed_says_what_differs(name: str) -> None:
    changed = {key: 0.25 for key in ("exponent", "eps") if key in inspect.signature(LOSSES[name]).parameters}
    for key, value in changed.items():
        assert f"{key}={value}" in repr(LOSSES[name](**{key: value}))
    assert "reduction='sum'" in repr(LOSSES[name](reduction="sum"))


@every_loss
def test_compiles(name: str) -> None:
    torch._dynamo.reset()
    forget()
    loss, p, t = make(name), some_values(2, 20, seed=3), some_values(2, 20, seed=4)
    wi, wo = hemisphere(2, 20, seed=1), hemisphere(2, 20, seed=2)

    def function(p: Tensor, wi: Tensor, wo: Tensor) -> Tensor:
        return loss(p, t, Pairs.from_directions(wi, wo))

    compiled = torch.compile(function, backend="eager", fullgraph=True)
    torch.testing.assert_close(compiled(p, wi, wo), function(p, wi, wo))


@every_loss
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda(name: str) -> None:
    p, t, pairs = some_values(2, 20, seed=3), some_values(2, 20, seed=4), some_pairs(2, 20)
    found = make(name)(p.cuda(), t.cuda(), pairs.to("cuda"))
    assert found.is_cuda
    torch.testing.assert_close(found.cpu(), make(name)(p, t, pairs), rtol=1e-12, atol=0)


@every_loss
def test_problem(name: str) -> None:
    """The measured pairs, or some of them; invalid samples have no say."""
    values = some_values(2, 20, seed=4)
    values[0, 3, 1] = torch.nan
    measured, loss = Measured.from_samples(some_pairs(1, 20), values), make(name)
    problem = loss.problem(measured)
    assert problem.target.shape == (2, 20, 3)
    assert problem.weight is not None
    assert problem.weight[0, 3].item() == 0
    prediction = some_values(2, 20, seed=3)
    keep = torch.arange(20) != 3
    found = loss(prediction, problem.target, problem.pairs, problem.weight)
    expected = loss(prediction[:, keep], values[:, keep], some_pairs(1, 20).select(samples=keep.nonzero()[:, 0]))
    torch.testing.assert_close(found[0], expected[0], rtol=1e-12, atol=0)

    subset = torch.tensor([5, 2, 11])
    part = loss.problem(measured, subset)
    assert part.pairs.shape == (1, 3)
    torch.testing.assert_close(part.target, values[:, subset], rtol=0, atol=0)
    assert torch.equal(part.weight, torch.ones(2, 3, 1, dtype=torch.float64))
    assert torch.equal(part.pairs.cos_i, some_pairs(1, 20).cos_i[:, subset])


@every_loss
@pytest.mark.parametrize("dtype", [torch.float32, pytest.param(torch.float64, marks=pytest.mark.slow)])
def test_in_a_training_loop(name: str, dtype: torch.dtype) -> None:
    """Adam finds the parameters that a Ward lobe's values were made with."""
    wi = hemisphere(400, seed=1)
    near = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64) + 0.3 * hemisphere(400, seed=2)
    pairs = Pairs.from_directions(wi, near / near.norm(dim=-1, keepdim=True)).to(dtype=dtype)
    target = Ward(specular=[0.2, 0.4, 0.6], roughness=0.2, dtype=dtype)(pairs).detach()
    lobe, loss = Ward(roughness=0.3, dtype=dtype), LOSSES[name]()
    optimizer = torch.optim.Adam(lobe.parameters(), lr=0.03)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.985)
    for _ in range(400):
        optimizer.zero_grad()
        loss(lobe(pairs), target, pairs).backward()
        optimizer.step()
        schedule.step()
    torch.testing.assert_close(lobe.specular.detach(), torch.tensor([0.2, 0.4, 0.6], dtype=dtype), rtol=0, atol=5e-3)
    assert lobe.roughness.item() == pytest.approx(0.2, abs=2e-3)


@every_loss
def test_whole_numbers_are_refused(name: str) -> None:
    """They would be rounded without a word."""
    pairs, whole = Pairs.from_half_diff(*torch.full((3, 5), 0.5)), torch.ones(5, 3, dtype=torch.int64)
    for values in ((whole, whole), (whole.float(), whole)):
        with pytest.raises(ShapeError, match=r"expected values of floats, found torch\.int64"):
            LOSSES[name]()(*values, pairs)
