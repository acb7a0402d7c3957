"""10 - JOD by ColorVideoVDP, where that is installed, and what is said where it is not."""

import copy
import importlib
import math
import pickle
import sys
from types import ModuleType

import pytest
import torch
from helpers.color_video_vdp import color_video_vdp
from helpers.picture_pairs import gradient, pictures

from torchbrdf import images
from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.images import DIFFERENCES, pu21
from torchbrdf.images.differences.jod import JOD
from torchbrdf.lobes import Lambert
from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, blob


@pytest.fixture
def library() -> ModuleType:
    return color_video_vdp()


def test_it_is_listed_and_says_what_it_needs() -> None:
    assert DIFFERENCES["jod"] is JOD and JOD.extra == "cvvdp"
    assert not JOD.higher_is_better and not JOD.linear and JOD.unit == "JOD"


def test_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(name: str) -> ModuleType:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(importlib, "import_module", fails)
    with pytest.raises(UsageError, match=r"^jod: cvvdp is missing; pip install torchbrdf\[cvvdp\]$"):
        JOD()


def test_with_a_library_that_cannot_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(name: str) -> ModuleType:
        raise RuntimeError("operator torchvision::nms does not exist")

    monkeypatch.setattr(importlib, "import_module", fails)
    with pytest.raises(UsageError, match=r"expected torchvision of .* as torch .*, found operator torchvision::nms"):
        JOD()


def test_it_says_what_the_library_says(library: ModuleType) -> None:
    theirs = library.cvvdp(display_name="standard_4k", quiet=True, device=torch.device("cpu"))
    assert theirs.pix_per_deg == pytest.approx(JOD().pixels_per_degree, abs=0.01)
    image, reference = (x.float() for x in pictures(JOD())[:2])
    found = JOD(theirs.pix_per_deg)(image, reference)
    for k in range(2):
        quality, _ = theirs.predict(image[k], reference[k], dim_order="HWC")
        assert 9 < quality < 10 and found[k].item() == pytest.approx(10 - quality.item(), rel=1e-5)
    torch.testing.assert_close(JOD()(image, reference), found, rtol=1e-3, atol=0)


def test_pu21_is_theirs_too(library: ModuleType) -> None:
    x = torch.logspace(math.log10(0.005), 4, 4001, dtype=torch.float64)
    theirs = sys.modules["pycvvdp.utils"].PU()
    torch.testing.assert_close(pu21(x), theirs._encode_direct(x), rtol=1e-12, atol=1e-9)


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_it_keeps_the_contract(dtype: torch.dtype) -> None:
    difference = JOD()
    image, reference, mask = (x.to(dtype) if x.is_floating_point() else x for x in pictures(difference))
    steps = [difference.loss(torch.lerp(reference, image, t), reference, mask) for t in (1.0, 0.6, 0.3, 0.0)]
    losses = torch.stack(steps)
    assert losses.dtype == dtype and losses.shape == (4, 2)
    assert (losses.diff(dim=0) < 0).all() and (losses[-1] == 0).all()
    assert torch.equal(losses[0], difference(image, reference, mask))
    # each picture by itself, pixels outside the mask without effect
    assert torch.allclose(difference(image[1:], reference[1:], mask), losses[0, 1:], rtol=1e-3)
    rubbish = torch.where(mask[..., None], image, math.nan)
    assert torch.equal(difference(rubbish, reference, mask), losses[0])
    assert gradient(difference, rubbish, reference, mask).isfinite().all()
    assert difference(image, reference, torch.zeros_like(mask)).isnan().all()
    unknown = torch.where(torch.arange(2)[:, None, None, None] == 1, math.nan, image)
    assert difference(unknown, reference, mask).isnan().tolist() == [False, True]
    function = images.jod(image, reference, mask, pixels_per_degree=40, peak=500, reduction="mean")
    copied = pickle.loads(pickle.dumps(copy.deepcopy(JOD(40, 500, reduction="mean"))))
    assert torch.equal(copied(image, reference, mask), function)
    assert repr(copied) == "JOD(pixels_per_degree=40, peak=500, reduction='mean')"


@pytest.mark.usefixtures("library")
def test_its_gradient_is_finite_and_points_down() -> None:
    difference = JOD()
    image, reference, mask = (x.float() if x.is_floating_point() else x for x in pictures(difference, batch=1))
    black, white = torch.zeros_like(image), torch.ones_like(image)
    for first, second in [(image, reference), (reference, reference), (black, white), (white, black), (black, black)]:
        assert gradient(difference, first, second, mask).isfinite().all()
    image = torch.lerp(reference, image, 0.5)
    slope = gradient(difference, image, reference, mask).double()
    assert (slope[:, ~mask] == 0).all()
    # along a straight line, in steps that float32 sees
    way = (reference - image).double()
    ahead, behind = (difference(image + step * way, reference, mask).double() for step in (0.01, -0.01))
    assert ((ahead - behind) / 0.02).item() == pytest.approx((slope * way).sum().item(), rel=0.02)


@pytest.mark.usefixtures("library")
def test_it_depends_on_the_display() -> None:
    image, reference, _ = pictures(JOD())
    assert (JOD(peak=20)(image, reference) < JOD()(image, reference)).all()  # in the dark less is seen
    assert not torch.allclose(JOD(20)(image, reference), JOD()(image, reference), rtol=0.01)


@pytest.mark.usefixtures("library")
def test_it_is_a_rendered_loss() -> None:
    scene = Scene(blob(), Camera(15.0), Environment.default(), size=24, nodes=16, light_samples=32)
    loss = RenderedLoss(scene, "jod")
    with torch.no_grad():
        target, other = (Lambert(albedo=albedo)(scene.pairs) for albedo in (0.5, 0.3))
    assert loss(target, target, scene.pairs) == 0
    point = other.clone().requires_grad_()
    error = loss(point, target, scene.pairs)
    (slope,) = torch.autograd.grad(error, point)
    assert error > 0.1 and slope.isfinite().all() and slope.sum() < 0


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"pixels_per_degree": 1}, r"^JOD: expected pixels_per_degree of at least 2, found 1$"),
        ({"pixels_per_degree": math.nan}, "pixels_per_degree"),
        ({"peak": 0}, "peak in cd"),
        ({"reduction": "max"}, "^JOD: expected reduction"),
    ],
)
def test_settings_out_of_range(settings: dict, reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        JOD(**settings)


@pytest.mark.usefixtures("library")
def test_small_pictures_are_refused() -> None:
    with pytest.raises(ShapeError, match="at least 8 x 8"):
        JOD()(torch.zeros(1, 7, 9, 3), torch.zeros(1, 7, 9, 3))
