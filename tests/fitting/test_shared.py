"""What several fits of the same materials share: targets laid out, and the noise, made once."""

import pickle

import pytest
import torch

from torchbrdf.fitting import Gathered, fit, work
from torchbrdf.fitting.noise import NoiseRecords
from torchbrdf.fitting.shared import Objectives, Shared
from torchbrdf.lobes import make_model
from torchbrdf.losses import CompressedLoss, CosineRMSLoss, CubeRootLoss, LogLoss, Problem, RMSLoss
from torchbrdf.measured import load, standins
from torchbrdf.pairs import Pairs


@pytest.fixture
def measured():
    return load(standins()).batch([6, 8]).within(25.0).batch(samples=torch.arange(0, 40_000, 5))


def of_size(count):
    problem = Problem(Pairs.from_cosines(torch.ones(1, count)), torch.zeros(1, count, 3))
    return Objectives(problem, None, None, None)


def test_fits_that_share_problems_are_as_fits_alone(measured, monkeypatch):
    made = []
    make = work.make_objective
    monkeypatch.setattr(work, "make_objective", lambda *given: made.append(given) or make(*given))
    losses, models = [CubeRootLoss(), CompressedLoss()], [make_model("ward", 1), make_model("cook_torrance", 1)]
    gathered = Gathered(measured, models, losses)
    for loss in losses:
        for model in models:
            alone = fit(model, measured, loss, max_theta=25.0, samples=2000)
            before = len(made)
            shared = fit(model, measured, loss, max_theta=25.0, samples=2000, gathered=gathered)
            assert (len(made) > before) == (model is models[0])  # the second model finds what the first has left
            torch.testing.assert_close(shared.error, alone.error, rtol=1e-4, atol=0)


def test_other_subsets_are_not_shared(measured):
    loss, model = LogLoss(), make_model("ward", 1)
    gathered = Gathered(measured, [model], [loss])
    for samples, seed in ((2000, 0), (2000, 1), (1000, 1), (None, 0)):
        options = {"max_theta": 25.0, "samples": samples, "seed": seed}
        shared = fit(model, measured, loss, gathered=gathered, **options)
        torch.testing.assert_close(shared.subset_error, fit(model, measured, loss, **options).subset_error)


def test_what_was_used_last_is_kept_as_far_as_there_is_room():
    shared = Shared(most=3 * 25)
    for name, size in (("a", 10), ("b", 10), ("c", 10)):
        shared.put(name, of_size(size))
    assert shared.take("a") is None and shared.take("b") is not None
    assert shared.take("b") is None  # whoever has it works in its memory
    shared.put("too large", of_size(26))
    assert shared.take("too large") is None
    shared.put("d", of_size(5))
    assert pickle.loads(pickle.dumps(shared)).take("d") is None and shared.take("d") is not None


def test_noise_is_told_once_and_as_for_each_loss_alone(measured, monkeypatch):
    from torchbrdf.fitting import noise

    material = Pairs.from_half_diff(*torch.rand(3, 1, 2000, generator=torch.Generator().manual_seed(1)))
    values = make_model("ward", 1).batched(1)(material) * (1 + 0.1 * torch.randn(1, 2000, 3))
    given = type(measured).from_samples(material, values.detach())
    calls = []
    told = noise.noises_of
    monkeypatch.setattr(noise, "noises_of", lambda all_: calls.append(all_) or told(all_))
    records, losses = NoiseRecords(given), [RMSLoss(), CosineRMSLoss(), CubeRootLoss()]
    together = [records.of(loss) for loss in losses]
    assert len(calls) == 1
    assert together == [NoiseRecords(given).of(loss) for loss in losses]
    assert together[0][0]["error"] > 0
