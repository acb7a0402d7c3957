"""Intervals of parameters: that they hold the truth as often as they say, and what is said where there is none."""

import json
from pathlib import Path

import pytest
import torch

from torchbrdf.errors import UsageError
from torchbrdf.fitting import fit
from torchbrdf.fitting.intervals import find_intervals
from torchbrdf.fitting.objective import make_objective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.fitting.result import FitResult, fits_csv
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, make_model, read_fits, write_fits
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.losses import CompressedLoss, CubeRootLoss, LearnedLoss, Loss, Problem, RMSLoss
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs

MATERIALS = 200
TRUTH = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=[0.2, 0.3, 0.25], roughness=0.15)).to(torch.float64)


def pairs_of(count: int) -> Pairs:
    """In an order in which neighbours are alike, as those of a table are."""
    generator = torch.Generator().manual_seed(0)
    angles = 0.7 * torch.rand(3, count, generator=generator, dtype=torch.float64)
    return Pairs.from_half_diff(*angles[:, angles[0].argsort()][:, None])


def noisy(count: int, materials: int = MATERIALS, noise: float = 0.02, stretch: int = 1) -> Measured:
    """The truth with noise of one size, that `stretch` neighbours share."""
    pairs, generator = pairs_of(count), torch.Generator().manual_seed(1)
    error = torch.randn(materials, -(-count // stretch), 3, generator=generator, dtype=torch.float64)
    values = TRUTH(pairs).detach() + noise * error.repeat_interleave(stretch, 1)[:, :count]
    return Measured.from_samples(pairs, values)


def fitted(measured: Measured, intervals: str, loss: Loss | None = None) -> FitResult:
    return fit(TRUTH, measured, loss or RMSLoss(), diffuse="fit", samples=None, intervals=intervals)


def coverage(result: FitResult, method: str) -> float:
    """How often intervals hold the truth, over materials and numbers."""
    both = result.intervals[method]
    inside = [
        ((both.low[name] <= true) & (true <= both.high[name])).double().flatten()
        for name, true in get_parameters(TRUTH).items()
    ]
    return float(torch.cat(inside).mean())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gauss_newton_holds_the_truth_as_often_as_it_says(dtype: torch.dtype) -> None:
    result = fitted(noisy(400).to(dtype=dtype), "gauss_newton")
    assert 0.93 <= coverage(result, "gauss_newton") <= 0.97  # of 1400 numbers, not quite independent
    widths = result.intervals["gauss_newton"]
    rough = (widths.high["lobes.1.roughness"] - widths.low["lobes.1.roughness"]).mean()
    spread = result.model.lobes[1].roughness.detach().std()
    assert float(rough) == pytest.approx(2 * 1.96 * float(spread), rel=0.25)


def test_gauss_newton_of_noise_that_a_loss_evens_out() -> None:
    """Noise of one size in what is compared, the root of f cos_i."""
    pairs, generator = pairs_of(400), torch.Generator().manual_seed(1)
    noise = torch.randn(MATERIALS, 400, 3, generator=generator, dtype=torch.float64)
    cos_i = pairs.cos_i[..., None]
    values = ((TRUTH(pairs).detach() * cos_i).sqrt() + 0.01 * noise).square() / cos_i
    result = fitted(Measured.from_samples(pairs, values), "gauss_newton", CompressedLoss(0.5))
    assert 0.93 <= coverage(result, "gauss_newton") <= 0.97


def test_the_bootstrap_holds_the_truth() -> None:
    result = fitted(noisy(400, materials=40), "bootstrap")
    assert 0.90 <= coverage(result, "bootstrap") <= 0.98  # of 280 numbers, not quite independent


def test_the_bootstrap_sees_what_neighbours_share() -> None:
    """Errors that eight neighbours share: each value is no observation of its own."""
    result = fitted(noisy(1600, materials=40, stretch=16), "bootstrap")
    assert coverage(result, "gauss_newton") < 0.65
    assert 0.88 <= coverage(result, "bootstrap") <= 0.98


def test_the_bootstrap_serves_losses_that_are_no_squares() -> None:
    for loss in (CubeRootLoss(), LearnedLoss()):
        result = fitted(noisy(300, materials=2), "bootstrap", loss)
        assert [*result.intervals] == ["bootstrap"]
        low, high = result.intervals["bootstrap"]
        for name, value in get_parameters(result.model).items():
            assert bool((low[name] <= high[name]).all()), name
            assert bool(((low[name] < value * 1.05) & (high[name] > value * 0.95)).all()), name


def test_shared_numbers_and_bounds() -> None:
    """A parameter at its bound has no interval; shared ones have the same."""
    pairs = pairs_of(400)
    start = make_model("ggx:f0", dtype=torch.float64)
    start.lobes[1].roughness, start.lobes[2].roughness = 0.1, 1.0
    start.lobes[1].f0 = start.lobes[2].f0 = 0.2
    measured = Measured.from_samples(pairs, start(pairs).detach())
    record = fit(start, measured, RMSLoss(), diffuse="fit", samples=None).records()[0]
    low, high = record.intervals["gauss_newton"]["low"], record.intervals["gauss_newton"]["high"]
    assert low["f0"][0] == low["f0"][1]
    at_bound = [f"roughness[{k}] = 1" in record.at_bounds for k in range(2)]
    assert any(at_bound)
    assert [value is None for value in low["roughness"]] == at_bound
    assert all((a is None) == (b is None) for a, b in zip(low["roughness"], high["roughness"], strict=True))


def test_where_there_is_no_minimum_there_is_no_interval() -> None:
    pairs = pairs_of(200)
    model = TRUTH.batched(1)
    objective = make_objective(model, Problem(pairs, TRUTH(pairs).detach()[None, 0] * 1.5), RMSLoss())
    free = Parametrization(model, free_parameters(model, [0, 1]))
    found = find_intervals("gauss_newton", objective, get_parameters(model), free, torch.tensor([600]), 0)
    assert all(bool(value.isnan().all()) for value in found["gauss_newton"].low.values())


def test_files_have_intervals(tmp_path: Path) -> None:
    records = fitted(noisy(200, materials=2), "bootstrap").records()
    write_fits(tmp_path / "fits.json", records)
    assert read_fits(tmp_path / "fits.json") == records
    own = json.loads((tmp_path / "fits.json").read_text())[1]["intervals"]
    assert own["level"] == 0.95
    assert own["bootstrap"]["low"]["roughness"][0] < 0.15 < own["bootstrap"]["high"]["roughness"][0]
    header = fits_csv(records).splitlines()[0].split(",")
    assert {"intervals_gauss_newton_low_roughness_0", "intervals_bootstrap_high_specular_0_2"} <= {*header}


def test_old_files_have_none() -> None:
    values = fitted(noisy(100, materials=1), "none").records()[0].to_json()
    assert "intervals" not in values
    assert FitRecord.from_json(values).intervals == {}


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(UsageError, match="intervals: expected one of none, gauss_newton, bootstrap, found 'jackknife'"):
        fitted(noisy(10, materials=1), "jackknife")
