"""Pictures as a loss: its contract, its derivatives, and fits under it."""

import copy

import pytest
import torch
from helpers.painted import Painted
from helpers.picture_pairs import NAMES
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.fitting import Status, fit
from torchbrdf.fitting.objective import make_objective
from torchbrdf.fitting.objective.image import ImageObjective
from torchbrdf.fitting.parameters import Parametrization, free_parameters
from torchbrdf.images import DIFFERENCES, PixelDifference, ToneMap
from torchbrdf.lobes import LOBES, BoundedParameter, CookTorrance, Lambert, Lobe, Sum, Ward, make_model
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, blob

PIXELWISE = [name for name in NAMES if issubclass(DIFFERENCES[name], PixelDifference)]


def scene_of(size: int, **settings: int) -> Scene:
    return Scene(blob(), Camera(15.0), Environment.default(), size=size, **settings)


@pytest.fixture(scope="module")
def small() -> Scene:
    return scene_of(24)


@pytest.fixture(scope="module")
def large() -> Scene:
    """Large enough for every difference, but with few lights."""
    return scene_of(176, nodes=16, light_samples=32)


def mixture(roughness: float = 0.1, dtype: torch.dtype = torch.float32) -> Sum:
    return Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=[0.3, 0.25, 0.2], roughness=roughness)).to(dtype=dtype)


def values(scene: Scene, *materials: Lobe, dtype: torch.dtype = torch.float32) -> Tensor:
    with torch.no_grad():
        return torch.cat([material.to(dtype=dtype)(scene.pairs.to(dtype=dtype)) for material in materials])


@pytest.mark.parametrize("name", NAMES)
def test_the_contract(large: Scene, name: str) -> None:
    loss = RenderedLoss(large, name, reduction="none")
    assert loss.registered_name == f"rendered_{name}"
    near, far, target = (values(large, mixture(x)) for x in (0.105, 0.2, 0.1))
    assert loss(target, target, large.pairs).abs().max() < 1e-4
    errors = [loss(one, target, large.pairs).item() for one in (near, far)]
    assert 0 < errors[0] < errors[1]
    # neither on batch mates, nor (through the tone map) on the prediction
    bright = values(large, Lambert(albedo=1.0))
    batch = loss(torch.cat([near, far]), torch.cat([target, bright]), large.pairs)
    assert batch[0].item() == pytest.approx(errors[0], rel=1e-4)
    prediction = far.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(prediction, target, large.pairs).sum(), prediction)
    assert gradient.isfinite().all() and gradient.abs().max() > 0
    same = target.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(same, target, large.pairs).sum(), same)
    assert gradient.isfinite().all()


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *(("ward", name) for name in NAMES),
        *((kind, "delta_e76") for kind in ("cook_torrance", "ashikhmin_shirley", "distribution_based")),
    ],
)
def test_gradients_reach_every_parameter(large: Scene, name: str, kind: str) -> None:
    """Through lobe, transport, tone map and difference, against central differences."""
    torch.manual_seed(0)
    start = {"roughness": 0.2, "exponent": 30.0, "f0": 0.4, "specular": [0.3, 0.2, 0.25], "distribution": 0.5}
    lobe = LOBES[kind]
    own = {key: start.get(key, spec.start) for key, spec in lobe.parameter_specs.items()}
    model = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), lobe(**own, dtype=torch.float64)).to(dtype=torch.float64)  # type: ignore[arg-type]
    loss = RenderedLoss(large, name)
    pairs = large.pairs.to(dtype=torch.float64)
    target = values(large, mixture(0.25), dtype=torch.float64)

    def error() -> Tensor:
        return loss(model(pairs)[None] if model(pairs).dim() == 2 else model(pairs), target, pairs)

    parameters = [parameter for part in model.components() for parameter in part.parameters()]
    gradients = torch.autograd.grad(error(), parameters)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        direction = torch.rand_like(parameter) + 0.1
        step = 1e-5 * parameter.detach().abs()
        ends = []
        for sign in (1, -1):
            with torch.no_grad():
                parameter += sign * step * direction
                ends.append(error().item())
                parameter -= sign * step * direction
        found = (gradient * step * direction).sum().item()
        assert found == pytest.approx((ends[0] - ends[1]) / 2, rel=1e-4, abs=1e-10)


@pytest.mark.parametrize("name", PIXELWISE)
def test_the_majorizer_touches_the_loss(small: Scene, name: str) -> None:
    loss = RenderedLoss(small, name)
    first, target = (loss.observe(values(small, mixture(x), Lambert(), dtype=torch.float64)) for x in (0.2, 0.1))
    first = (first * 1.2).requires_grad_()
    value, slope, curve = loss.quadratic_majorizer(first, target)
    expected = loss.compare(first, target)
    torch.testing.assert_close(value, expected)
    torch.testing.assert_close(slope, torch.autograd.grad(expected.sum(), first)[0])
    assert torch.linalg.eigvalsh(curve).min() > -1e-12
    if loss.difference.power == 1:  # type: ignore[attr-defined]
        step = 0.05 * torch.randn(first.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * first
        above = value + ((slope + 0.5 * torch.einsum("mpcd,mpd->mpc", curve, step)) * step).sum((1, 2))
        assert (loss.compare(first + step, target) <= above * (1 + 1e-3)).all()


@pytest.mark.parametrize(
    ("name", "kind"), [("delta_e76", "ward"), ("log_hdr", "cook_torrance"), ("ssim", "cook_torrance")]
)
def test_derivatives_by_responses_are_those_of_the_graph(small: Scene, name: str, kind: str) -> None:
    loss = RenderedLoss(small, name)
    model = make_model(kind, 2, dtype=torch.float64).batched(2)
    with torch.no_grad():
        for part, roughness in zip(model.components()[1:], (0.1, 0.3), strict=True):
            part.roughness.fill_(roughness)
    measured = Measured(Painted([mixture(0.2), mixture(0.3)])).to(dtype=torch.float64)
    problem = loss.problem(measured)
    objective = make_objective(model, problem, loss)
    assert isinstance(objective, ImageObjective)
    held, free, rows = (
        get_parameters(model),
        Parametrization(model, free_parameters(model, [0, 1, 2])),
        torch.tensor([1, 0]),
    )
    bound, scale = objective.bind(free, held), objective.zero_prediction_error
    x = free.encode(held)
    value, gradient = bound.value_and_gradient(x, rows)
    x = x[[1, 0]]
    torch.testing.assert_close(
        loss.finalize(value * scale[[1, 0]]), loss.error(model(problem.pairs), problem.target)[[1, 0]]
    )
    for p in range(x.shape[1]):
        step = torch.zeros_like(x)
        step[:, p] = 1e-5
        up, down = (bound.value_and_gradient(x + sign * step, rows)[0] for sign in (1, -1))
        torch.testing.assert_close(gradient[:, p], (up - down) / 2e-5, rtol=1e-4, atol=1e-8)
    if loss.has_majorizer:
        *both, matrix = bound.quadratic_model(x, rows)
        for one, other in zip(both, (value, gradient), strict=True):
            torch.testing.assert_close(one, other)
        assert torch.linalg.eigvalsh(matrix).min() > -1e-10 * matrix.abs().max()


@pytest.mark.parametrize(
    ("strategy", "name"), [("global", "delta_e76"), ("global", "log_hdr"), ("global", "ssim"), ("staged", "psnr")]
)
@pytest.mark.parametrize("kind", ["ward", pytest.param("cook_torrance", marks=pytest.mark.slow)])
def test_a_fit_finds_what_was_drawn(small: Scene, strategy: str, name: str, kind: str) -> None:
    """One lobe, so that there is one truth, and its albedo scalar, so that the staged procedure can reach it."""
    lobes = {
        "ward": [Ward(specular=0.3, roughness=0.08), Ward(specular=0.1, roughness=0.25)],
        "cook_torrance": [CookTorrance(specular=0.3, roughness=r, f0=0.4) for r in (0.1, 0.3)],
    }[kind]
    diffuse = [[0.3, 0.2, 0.1], [0.05, 0.1, 0.2]]
    truth = [Sum(Lambert(albedo=albedo), lobe) for albedo, lobe in zip(diffuse, lobes, strict=True)]
    measured = Measured(Painted(truth))  # type: ignore[arg-type]
    result = fit(make_model(kind, 1), measured, RenderedLoss(small, name), strategy=strategy, diffuse="fit")
    assert result.loss == f"rendered_{name}"
    found = [result.model.components()[1].roughness[k].item() for k in range(2)]
    for k, lobe in enumerate(lobes):
        assert found[k] == pytest.approx(lobe.roughness.item(), rel=2e-2)
    torch.testing.assert_close(result.model.components()[0].albedo, torch.tensor(diffuse), atol=5e-3, rtol=0)
    if strategy == "global" and name != "ssim":
        assert result.status == [Status.CONVERGED] * 2


class Bent(Lobe):
    """A lobe that is neither an albedo times a function nor a sum of terms."""

    tint: BoundedParameter = BoundedParameter(start=0.5, lower=0.01, upper=1.0, shape=(3,), doc="of the powers")

    @staticmethod
    def function(pairs: Pairs, tint: Tensor) -> Tensor:
        bent = pairs.cos_h[..., None] ** (1 / tint[..., None, :])
        return torch.where(pairs.above_horizon[..., None], bent, 0)


def test_models_without_columns_are_fitted_too(small: Scene) -> None:
    truth, model = Sum(Lambert(albedo=0.2), Bent(tint=0.6)), Sum(Lambert(albedo=0.3), Bent(tint=0.3))
    loss = RenderedLoss(small, "log_hdr")
    result = fit(model, Measured(Painted([truth])), loss, diffuse="fit", max_iterations=10)
    problem = loss.problem(Measured(Painted([truth])))
    with torch.no_grad():
        before = loss.error(model(problem.pairs), problem.target).item()
    assert result.error.item() < before / 2


def test_one_tone_map_for_all(small: Scene) -> None:
    first, second = values(small, mixture(0.1)), values(small, mixture(0.2))
    pictures = small.transport @ torch.cat([first, second])
    tone = ToneMap.from_images(pictures, small.mask.expand(2, 24, 24))
    found = RenderedLoss(small, "delta_e76", tone=tone)(first, second, small.pairs).item()
    shown = tone(pictures)
    expected = DIFFERENCES["delta_e76"]()(shown[:1], shown[1:], small.mask).item()
    assert found == pytest.approx(expected, rel=1e-4)


def test_the_reference_is_kept_but_never_stale(small: Scene) -> None:
    loss = RenderedLoss(small, "log_hdr")
    prediction, target = values(small, mixture(0.1)), values(small, mixture(0.2))
    first = loss(prediction, target, small.pairs).item()
    assert loss(prediction, target, small.pairs).item() == first
    target *= 2
    assert loss(prediction, target, small.pairs).item() != pytest.approx(first)
    assert copy.deepcopy(loss)(prediction, target, small.pairs).item() == loss(prediction, target, small.pairs).item()


def test_what_it_refuses(small: Scene) -> None:
    loss = RenderedLoss(small)
    target = values(small, mixture())
    with pytest.raises(UsageError, match="unknown difference"):
        RenderedLoss(small, "delta")
    with pytest.raises(UsageError, match="ms_ssim needs pictures of 161 pixels"):
        RenderedLoss(small, "ms_ssim")
    with pytest.raises(UsageError, match="without a reduction, found 'mean'"):
        RenderedLoss(small, DIFFERENCES["log_hdr"](reduction="mean"))
    with pytest.raises(UsageError, match="no subsets"):
        loss.problem(Measured(Painted([mixture()])), torch.arange(3))
    with pytest.raises(ShapeError, match="no weights"):
        loss(target, target, small.pairs, torch.ones(1, 1, 1))
    with pytest.raises(ShapeError, match="transport"):
        loss(target[:, 1:], target[:, 1:], small.pairs)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
@pytest.mark.parametrize("name", ["delta_e76", "ssim"])
def test_a_gpu_sees_what_the_cpu_sees(small: Scene, name: str) -> None:
    loss = RenderedLoss(small, name)
    prediction, target = values(small, mixture(0.2)), values(small, mixture(0.1))
    found = []
    for device in ("cpu", "cuda"):
        one = prediction.to(device).requires_grad_()
        error = loss(one, target.to(device), small.pairs.to(device))
        (gradient,) = torch.autograd.grad(error, one)
        found.append((error.item(), gradient.cpu()))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-4)
    torch.testing.assert_close(found[0][1], found[1][1], rtol=1e-3, atol=1e-6)
