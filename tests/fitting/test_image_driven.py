"""The image-driven strategy: which fit it keeps, what records say of it, and its options."""

from pathlib import Path

import pytest
import torch

from torchbrdf.errors import UsageError
from torchbrdf.fitting import STRATEGIES, FitResult, GlobalSearch, ImageDriven, Status, fit
from torchbrdf.fitting.strategy import strategy_name
from torchbrdf.lobes import make_model, read_fits
from torchbrdf.losses import CompressedLoss, CosineRMSLoss, CubeRootLoss, FunctionLoss, Loss
from torchbrdf.measured import load, standins
from torchbrdf.measured.measured import Measured
from torchbrdf.render import RenderedLoss, Scene, sphere

METRICS = (CosineRMSLoss(), CompressedLoss(0.2), CubeRootLoss())
SEARCH = GlobalSearch(starts=2, kept=1)


@pytest.fixture(scope="module")
def materials() -> Measured:
    whole = load(standins())
    return whole.batch([2, 5, 6], torch.arange(0, len(whole.pairs), 900))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(sphere(3), size=12, nodes=16, light_samples=16)


def fitted(measured: Measured, loss: Loss, strategy: object, **settings: int) -> FitResult:
    return fit(make_model("ward", 1), measured, loss, strategy=strategy, diffuse="fit", samples=500, **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("difference", ["delta_e76", "log_hdr", "ssim"])
def test_it_keeps_the_candidate_whose_picture_is_nearest(materials, scene, difference) -> None:
    """Each material its own, also where the difference is no mean over pixels."""
    loss = RenderedLoss(scene, difference, reduction="none")
    result = fitted(materials, loss, ImageDriven(METRICS, SEARCH))
    others = [fitted(materials, metric, SEARCH) for metric in METRICS]
    problem = loss.problem(materials)
    with torch.no_grad():
        errors = torch.stack([loss.error(one.model(problem.pairs), problem.target) for one in others])
    torch.testing.assert_close(result.error, errors.amin(0), rtol=1e-5, atol=0)
    names = ["cosine_rms", "compressed(exponent=0.2)", "cube_root"]
    assert result.chosen == [names[k] for k in errors.argmin(0).tolist()]
    assert difference != "delta_e76" or len(set(result.chosen)) > 1
    nearest = errors.argmin(0)
    for name, value in result.model.named_parameters():
        own = torch.stack([dict(others[k].model.named_parameters())[name][m] for m, k in enumerate(nearest.tolist())])
        torch.testing.assert_close(value, own)
    assert [stage.name for stage in result.history] == [*(f"under {name}" for name in names), "the nearest"]
    assert result.status == [Status.CONVERGED] * 3 and result.starts == 9


def test_records_say_what_was_chosen(materials, scene, tmp_path: Path) -> None:
    result = fitted(materials, RenderedLoss(scene), ImageDriven(METRICS, SEARCH))
    result.save(tmp_path / "fits.json")
    found = read_fits(tmp_path / "fits.json")
    assert [record.chosen for record in found] == result.chosen
    assert found[0].loss == "rendered_delta_e76" and found[0].strategy.startswith("ImageDriven(metrics=(CosineRMS")
    assert fitted(materials, CompressedLoss(), SEARCH).records()[0].chosen == ""


def test_the_loss_that_is_given_decides(materials) -> None:
    """It can be one of BRDF values, too: then its own fit is the nearest."""
    result = fitted(materials, CompressedLoss(0.2), ImageDriven(METRICS, SEARCH))
    assert result.chosen == ["compressed(exponent=0.2)"] * 3 and result.samples == 500


def test_steps_under_the_loss_itself_bring_it_nearer(materials, scene) -> None:
    loss = RenderedLoss(scene)
    plain, polished = (fitted(materials, loss, ImageDriven(METRICS, SEARCH, polish=n)) for n in (0, 3))
    assert bool((polished.error < plain.error).all()) and polished.chosen == plain.chosen
    assert polished.history[-1].name == "polished" and polished.status == plain.status


def test_steps_that_do_not_are_not_taken(materials, scene) -> None:
    """Under a difference that has no curvature of its own a colour difference stands in for it."""
    loss = RenderedLoss(scene, "ssim")
    plain, polished = (fitted(materials, loss, ImageDriven(METRICS, SEARCH, polish=n)) for n in (0, 2))
    assert bool((polished.error <= plain.error).all())


def test_what_it_is_made_of_is_checked() -> None:
    assert STRATEGIES["image_driven"] == ImageDriven() and repr(ImageDriven()) == "ImageDriven()"
    assert STRATEGIES["image_driven_polished"] == ImageDriven(polish=3)
    assert repr(ImageDriven(("log",), polish=2)) == "ImageDriven(metrics=('log',), polish=2)"
    assert isinstance(ImageDriven((torch.nn.MSELoss(),)).losses[0], FunctionLoss)
    assert "\n" in repr(ImageDriven((FunctionLoss(torch.nn.MSELoss()),)))
    assert strategy_name(ImageDriven((FunctionLoss(torch.nn.MSELoss()),))).isprintable()  # files have it
    with pytest.raises(UsageError, match="metrics: expected at least one loss, found none"):
        ImageDriven(())
    with pytest.raises(UsageError, match=r"unknown loss 'lgo'; .* did you mean 'log'"):
        ImageDriven(("lgo",))
    with pytest.raises(UsageError, match="polish: expected a number of steps from 0 on, found -1"):
        ImageDriven(polish=-1)
