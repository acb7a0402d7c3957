"""Fits of lobes with a grain: they find it, whichever way it lies, and say so where there is none."""

import logging
import math
from collections.abc import Callable
from functools import cache

import pytest
import torch
from helpers.directions import hemisphere

from torchbrdf import Measured, fit, load, memory
from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.fitting import Status
from torchbrdf.lobes import (
    GGX,
    LOBES,
    GGXAnisotropic,
    Lambert,
    Lobe,
    Sum,
    WardAnisotropic,
    make_model,
    read_fits,
)
from torchbrdf.losses import CombinedLoss, CompressedLoss, CosineRMSLoss, CubeRootLoss, LearnedLoss, Loss
from torchbrdf.measured import standins
from torchbrdf.pairs import Pairs
from torchbrdf.render import RenderedLoss, Scene, SideBySide, render, sphere

# Every direction of the grain, and those at which a lobe with both widths exchanged is as near.
TURNS = torch.tensor([-1.5, -math.pi / 4, -0.3, 0.0, 0.5, math.pi / 4, 1.2, math.pi / 2], dtype=torch.float64)[:, None]
WITH_GRAIN = [name for name, lobe in LOBES.items() if lobe.is_anisotropic and not lobe.is_material]


def scattered(count: int = 3000) -> Pairs:
    """Directions all over the hemisphere, half of the pairs near the mirror direction."""
    wi, wo = hemisphere(count, seed=1), hemisphere(count, seed=2)
    wi[:, 2] += 0.1
    wo[:, 2] += 0.1
    width = 10 ** (-2 + 2 * torch.rand(count, 1, generator=torch.Generator().manual_seed(3), dtype=torch.float64))
    wo[::2] = (wi * torch.tensor([-1.0, -1.0, 1.0]) + width * wo)[::2]
    wi, wo = (torch.nn.functional.normalize(one, dim=-1) for one in (wi, wo))
    return Pairs.from_directions(wi, wo)


def turned_by(name: str) -> Sum:
    """Materials that differ in the rotation alone."""
    kind, many = LOBES[name], len(TURNS)
    widths = (0.05, 0.2) if kind.rises_with_width else (500.0, 30.0)
    own = dict(zip(kind.axes, widths, strict=True)) | {"specular": torch.tensor([0.3, 0.5, 0.7])}
    model = Sum(Lambert(albedo=torch.tensor([0.2, 0.15, 0.1])), kind(**own)).double().batched(many)
    model.components()[1].rotation = TURNS
    return model


@pytest.mark.parametrize("strategy", ["global", "staged"])
@pytest.mark.parametrize("name", WITH_GRAIN)
def test_every_grain_is_found(name: str, strategy: str) -> None:
    """All parameters, in all channels: the staged procedure, which colours last, within a few per cent."""
    truth, pairs = turned_by(name), scattered()
    measured = Measured.from_samples(pairs, truth(pairs).detach())
    assert measured.may_be_anisotropic
    found = fit(make_model(name, 1), measured, CompressedLoss(), strategy=strategy, diffuse="fit")
    own, expected = found.model.components()[1], truth.components()[1]
    apart = (own.rotation - expected.rotation).detach()
    apart = (apart + math.pi / 2).remainder(math.pi) - math.pi / 2
    exact = strategy == "global"
    assert apart.abs().max() < (1e-4 if exact else 0.02)
    for axis in LOBES[name].axes:
        tolerance = 1e-3 if exact else 0.1
        torch.testing.assert_close(getattr(own, axis), getattr(expected, axis), rtol=tolerance, atol=0)
    if exact:
        assert found.status == [Status.CONVERGED] * len(TURNS)
        assert (found.error < 1e-5).all()
        torch.testing.assert_close(found.model(pairs), truth(pairs), rtol=1e-3, atol=1e-4)
        record = found.records()[0]
        low, high = (record.intervals["gauss_newton"][end]["rotation"][0] for end in ("low", "high"))
        assert low <= own.rotation[0].item() <= high


@pytest.mark.parametrize("loss", [CosineRMSLoss(), CubeRootLoss(), LearnedLoss()])
def test_under_other_losses(loss: torch.nn.Module) -> None:
    truth, pairs = turned_by("ggx_anisotropic"), scattered()
    measured = Measured.from_samples(pairs, truth(pairs).detach()).batch([1, 4])
    found = fit(make_model("ggx_anisotropic", 1), measured, loss, diffuse="fit")
    torch.testing.assert_close(found.model.components()[1].rotation.detach(), TURNS[[1, 4]], rtol=0, atol=2e-3)


def test_a_lobe_with_a_grain_beside_one_without() -> None:
    pairs = scattered()
    grain = GGXAnisotropic(specular=0.4, roughness_x=0.03, roughness_y=0.15, rotation=0.7)
    truth = Sum(Lambert(albedo=0.1), grain, GGX(specular=0.2, roughness=0.5)).double()
    measured = Measured.from_samples(pairs, truth(pairs).detach()[None])
    found = fit(make_model("ggx_anisotropic+ggx"), measured, CubeRootLoss(), diffuse="fit")
    assert found.model.components()[1].rotation.item() == pytest.approx(0.7, abs=1e-3)
    assert found.error.item() < 3e-3  # a long flat valley


def test_a_shared_grain_stays_shared() -> None:
    pairs = scattered()
    first, second = (GGXAnisotropic(specular=0.3, roughness_x=a, roughness_y=4 * a, rotation=0.7) for a in (0.02, 0.1))
    truth = Sum(Lambert(albedo=0.1), first, second).double()
    measured = Measured.from_samples(pairs, truth(pairs).detach()[None])
    found = fit(make_model("ggx_anisotropic:rotation"), measured, CompressedLoss(), diffuse="fit")
    one, other = (part.rotation.item() for part in found.model.components()[1:])
    assert one == other
    assert found.error.item() < 1e-3


def test_records_of_a_grain(tmp_path, caplog: pytest.LogCaptureFixture) -> None:
    """They are read back; a grain that is none is said."""
    pairs = scattered()
    truth = Sum(Lambert(albedo=0.1), GGX(specular=0.4, roughness=0.2)).double()
    values = truth(pairs).detach()[None]
    measured = Measured.from_samples(pairs, values, names=["isotropic"])
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        found = fit(make_model("ggx_anisotropic", 1), measured, CompressedLoss(), diffuse="fit")
    assert "isotropic: the direction of the grain is not determined" in caplog.text
    assert found.error.item() < 1e-5
    lobe = found.model.components()[1]
    torch.testing.assert_close(lobe.roughness_x, lobe.roughness_y, rtol=1e-2, atol=0)
    found.save(tmp_path / "fits.json")
    assert read_fits(tmp_path / "fits.json")[0].parameters["rotation"] == [lobe.rotation.item()]


def refusals() -> list[tuple[Measured, torch.nn.Module, str]]:
    pairs = scattered(400)
    plane = torch.nn.functional.normalize(pairs.wi * torch.tensor([1.0, 0.0, 1.0]), dim=-1)
    flat = Pairs.from_directions(plane, pairs.wo)
    angles = Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d)
    grey = torch.full((1, 400, 3), 0.3, dtype=torch.float64)
    scene = RenderedLoss(Scene(sphere(2), size=8, nodes=8, light_samples=4))
    known = Measured.from_samples(pairs, grey)
    isotropic = r"^ggx_anisotropic: expected an anisotropic measurement, found .*; fit an isotropic lobe$"
    pictures = r"^ggx_anisotropic: expected pictures of a scene whose pairs know the tangent, Scene\(..., oriented=True"
    return [
        (load(standins()).batch([6]), CompressedLoss(), isotropic),
        (Measured.from_samples(angles, grey), CompressedLoss(), isotropic),
        (Measured.from_samples(flat, grey), CompressedLoss(), isotropic),
        (Measured.from_samples(pairs, grey, anisotropic=False), CompressedLoss(), isotropic),
        (known, scene, pictures),
        (known, CombinedLoss(CompressedLoss(), scene), pictures),
    ]


def test_what_has_no_grain_is_refused_in_one_line() -> None:
    for measured, loss, message in refusals():
        with pytest.raises(UsageError, match=message):
            fit(make_model("ggx_anisotropic", 1), measured, loss)
        model: Lobe = make_model("ward", 1)
        if not isinstance(loss, RenderedLoss | CombinedLoss):
            assert fit(model, measured, loss, samples=200, max_iterations=2).names == measured.names


def test_samples_of_one_plane_can_be_said_to_be_anisotropic() -> None:
    pairs = scattered(2000)
    flat = torch.nn.functional.normalize(pairs.wi * torch.tensor([1.0, 0.0, 1.0]), dim=-1)
    pairs = Pairs.from_directions(flat, pairs.wo)
    truth = Sum(Lambert(albedo=0.1), WardAnisotropic(specular=0.4, roughness_x=0.1, roughness_y=0.4, rotation=0.6))
    measured = Measured.from_samples(pairs, truth.double()(pairs).detach()[None], anisotropic=True)
    assert measured.is_anisotropic and measured.batch([0]).is_anisotropic
    found = fit(make_model("ward_anisotropic", 1), measured, CubeRootLoss(), diffuse="fit")
    assert found.model.components()[1].rotation.item() == pytest.approx(0.6, abs=1e-3)
    angles = Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d)
    with pytest.raises(ShapeError, match=r"^Measured: anisotropic: expected pairs of directions, found cosines"):
        Measured.from_samples(angles, torch.ones(1, 2000, 3), anisotropic=True)


@cache
def seen() -> Scene:
    return Scene(sphere(4), size=12, nodes=32, light_samples=64, oriented=True)


def brushed() -> tuple[Lobe, Measured]:
    truth = Sum(
        Lambert(albedo=[0.2, 0.15, 0.1]),
        GGXAnisotropic(specular=[0.3, 0.5, 0.7], roughness_x=0.15, roughness_y=0.5, rotation=0.4, f0=0.8),
    ).double()
    pairs = scattered(6000)
    return truth, Measured.from_samples(pairs, truth(pairs).detach()[None])


@pytest.mark.parametrize(
    ("loss", "strategy"),
    [
        (lambda: RenderedLoss(seen()), "global"),
        (lambda: RenderedLoss(SideBySide([seen(), seen()]), "log_hdr"), "global"),
        (lambda: CombinedLoss(CompressedLoss(), RenderedLoss(seen())), "global"),
        (lambda: CombinedLoss(CompressedLoss(), RenderedLoss(seen())), "image_driven"),
    ],
    ids=["picture", "two pictures", "with a metric", "image-driven"],
)
def test_pictures_show_the_grain(loss: Callable[[], Loss], strategy: str) -> None:
    """A fit to values between samples, which are a few per cent off: the grain is found, and the picture is near."""
    truth, measured = brushed()
    found = fit(make_model("ggx_anisotropic", 1), measured, loss(), strategy=strategy)
    lobe = found.model.components()[1]
    assert found.status == [Status.CONVERGED]
    assert abs(math.remainder(lobe.rotation.item() - 0.4, math.pi)) < 0.1
    assert lobe.roughness_x.item() == pytest.approx(0.15, rel=0.15)
    assert lobe.roughness_y.item() == pytest.approx(0.5, rel=0.15)
    with torch.no_grad():
        one, other = (render(model, seen()) for model in (found.model, truth))
    assert (one - other).abs().mean() < 0.03 * other.mean()


def test_an_oriented_scene_makes_the_pictures_that_are_drawn() -> None:
    truth, _ = brushed()
    scene = seen()
    assert scene.pairs.is_oriented and scene.pairs.above_horizon.all()
    with torch.no_grad():
        picture = scene.transport @ truth.float()(scene.pairs).expand(1, -1, -1)
    torch.testing.assert_close(picture, render(truth, scene), rtol=1e-4, atol=1e-6)
    plain = Scene(sphere(4), size=12, nodes=32, light_samples=64)
    assert plain.summary != scene.summary and not plain.pairs.is_oriented


def test_a_scene_that_is_too_large_to_be_oriented_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "limit", lambda: 1 << 20)
    with pytest.raises(
        UsageError, match=r"^Scene: expected at most 2048 pairs of an oriented scene in memory, found \d+;"
    ):
        _ = Scene(sphere(4), size=12, nodes=32, light_samples=64, oriented=True).pairs
