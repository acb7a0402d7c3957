"""Half precision: worked on in float32, and given back as it came."""

import warnings

import pytest
import torch
from helpers.directions import hemisphere
from helpers.picture_pairs import NAMES, pictures
from torch import Tensor

from torchbrdf import fit, load
from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes import LOBES, Lobe, make_model
from torchbrdf.losses import LOSSES, CosineRMSLoss
from torchbrdf.measured import standins
from torchbrdf.pairs import Pairs

HALVES = [torch.float16, torch.bfloat16]
halves = pytest.mark.parametrize("dtype", HALVES)


def directions(dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Near the mirror direction and far from it, grazing and below the horizon."""
    wi, wo = hemisphere(60, seed=1, dtype=torch.float32), hemisphere(60, seed=2, dtype=torch.float32)
    wo = torch.cat([wo[:20], wi[20:] * torch.tensor([-1.0, -1.0, 1.0])])
    wi[:2, 2], wo[2:4, 2] = 1e-6, -0.5
    return wi.to(dtype), wo.to(dtype)


@halves
@pytest.mark.parametrize("name", LOBES)
@pytest.mark.parametrize("where", ["lower", "start"])
def test_lobes(name: str, dtype: torch.dtype, where: str) -> None:
    """The values of float32 on the same numbers, rounded; as sharp as a lobe can be, too."""
    wi, wo = directions(dtype)
    lobe: Lobe = LOBES[name](
        dtype=dtype, **{key: getattr(spec, where) for key, spec in LOBES[name].parameter_specs.items()}
    )
    found = lobe(Pairs.from_directions(wi, wo))
    assert found.dtype == dtype and lobe(Pairs.from_directions(wi.float(), wo.float())).dtype == torch.float32
    expected = lobe.float()(Pairs.from_directions(wi.float(), wo.float()))
    torch.testing.assert_close(found, expected.to(dtype), rtol=0, atol=0)
    assert expected.isfinite().all() and (found.isfinite() | (expected > torch.finfo(dtype).max)).all()


@halves
@pytest.mark.parametrize("name", LOBES)
def test_functions_of_lobes(name: str, dtype: torch.dtype) -> None:
    """By position and by name; parameters alone in half precision are widened too."""
    pairs = Pairs.from_directions(*directions(dtype))
    values = {key: torch.full(spec.shape, spec.start).to(dtype) for key, spec in LOBES[name].parameter_specs.items()}
    function = LOBES[name].function
    assert torch.equal(function(pairs, *values.values()), function(pairs, **values))
    assert function(pairs, **values).dtype == dtype
    wide = pairs.widened()
    assert wide.dtype == torch.float32
    found = function(wide, **values)
    assert found.dtype == torch.float32
    assert torch.equal(found, function(wide, **{key: value.float() for key, value in values.items()}))


@halves
def test_pairs(dtype: torch.dtype) -> None:
    """Every quantity is that of float32, rounded, however the pairs were made."""
    wi, wo = directions(dtype)
    angles = torch.linspace(0, 1.5, 7).to(dtype)
    made = [
        (Pairs.from_directions(wi, wo), Pairs.from_directions(wi.float(), wo.float())),
        (Pairs.from_half_diff(*[angles] * 3), Pairs.from_half_diff(*[angles.float()] * 3)),
    ]
    for half, full in made:
        for name in ("cos_i", "cos_o", "cos_h", "cos_d", "tan2_h", "theta_h", "theta_d", "phi_d", "wi", "wo"):
            assert getattr(half, name).dtype == dtype, name
            torch.testing.assert_close(getattr(half, name), getattr(full, name).to(dtype), rtol=0, atol=0)
            torch.testing.assert_close(getattr(half.widened(), name), getattr(full, name), rtol=0, atol=0)
        assert torch.equal(half.above_horizon, full.above_horizon)
    cosines = Pairs.from_cosines(*[torch.tensor([0.25, 0.5]).to(dtype)] * 4)
    assert cosines.theta_h.dtype == dtype and cosines.widened().theta_h.dtype == torch.float32


@halves
@pytest.mark.parametrize("name", LOSSES)
def test_losses(name: str, dtype: torch.dtype) -> None:
    pairs = Pairs.from_directions(*directions(dtype))
    target = (10 ** (4 * torch.rand(2, 60, 3, generator=torch.Generator().manual_seed(0)))).to(dtype)
    found = LOSSES[name](reduction="none")(1.5 * target, target, pairs)
    expected = LOSSES[name](reduction="none")((1.5 * target).float(), target.float(), pairs.widened())
    assert found.dtype == dtype and found.isfinite().all()
    torch.testing.assert_close(found, expected.to(dtype), rtol=0, atol=0)


@halves
@pytest.mark.parametrize("name", NAMES)
def test_differences(name: str, dtype: torch.dtype) -> None:
    """Figure, loss and gradient."""
    difference = DIFFERENCES[name]()
    image, reference, mask = (x.to(dtype) if x.is_floating_point() else x for x in pictures(difference))
    for measure in (difference, difference.loss):
        point = image.clone().requires_grad_()
        found = measure(point, reference, mask)
        expected = measure(image.float(), reference.float(), mask)
        assert found.dtype == dtype and found.isfinite().all()
        torch.testing.assert_close(found.detach(), expected.to(dtype), rtol=0, atol=0)
        (slope,) = torch.autograd.grad(found.sum(), point)
        assert slope.dtype == dtype and slope.isfinite().all()
        with torch.autocast("cpu", dtype=torch.bfloat16):
            assert torch.equal(measure(image.float(), reference.float(), mask), expected)


@pytest.mark.parametrize("name", ["ssim", "ms_ssim"])
def test_similarities_end_at_1(name: str) -> None:
    """Also of pictures so nearly equal that rounding has a say."""
    difference = DIFFERENCES[name]()
    for seed in range(3):
        image = torch.rand(1, 176, 176, 3, generator=torch.Generator().manual_seed(seed))
        for dtype in (torch.float16, torch.bfloat16):
            assert (difference(image.to(dtype), image.to(dtype)) <= 1).all()
    assert (DIFFERENCES["ms_ssim"]()(image, image + 1e-4) <= 1).all()


@pytest.mark.parametrize("dtype", HALVES)
def test_fits(dtype: torch.dtype) -> None:
    """Of values, and of models, in half precision; under autocast, which would make least squares of bfloat16."""
    whole = load(standins(), dtype=torch.float32)
    measured = whole.batch([2, 6], torch.arange(0, len(whole.pairs), 900))
    model, settings = make_model("ward", 1), {"samples": 300, "max_iterations": 10}
    expected = fit(model, measured, CosineRMSLoss(), **settings)  # type: ignore[arg-type]
    with torch.autocast("cpu", dtype=torch.bfloat16), warnings.catch_warnings():
        warnings.simplefilter("error")
        found = fit(model, measured, CosineRMSLoss(), **settings)  # type: ignore[arg-type]
    assert torch.equal(found.error, expected.error) and found.status == expected.status
    half = fit(model.to(dtype=dtype), measured.to(dtype=dtype), CosineRMSLoss(), **settings)  # type: ignore[arg-type]
    assert next(half.model.parameters()).dtype == torch.float32
    torch.testing.assert_close(half.error, expected.error, rtol=0.03, atol=0)
