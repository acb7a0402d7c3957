"""Scenes that judge fits, and several scenes as one."""

import math

import pytest
import torch

from torchbrdf.errors import UsageError
from torchbrdf.lobes import GGX, Lambert
from torchbrdf.render import Camera, RenderedLoss, Scene, SideBySide, sphere, unseen_scenes
from torchbrdf.render.unseen import evening, knot, room, torus

SMALL = {"nodes": 8, "light_samples": 16}


@pytest.fixture(scope="module")
def two():
    return [Scene(sphere(2), size=8, **SMALL), Scene(sphere(2), Camera(90, elevation=30), size=10, **SMALL)]


def test_pictures_side_by_side_are_those_of_each_scene(two):
    both = SideBySide(two)
    own = [scene.transport.pixels(GGX()(scene.pairs))[0] for scene in two]
    white = [scene.transport.pixels(Lambert(albedo=1.0)(scene.pairs)).mean() for scene in two]
    expected = torch.cat([picture / unit for picture, unit in zip(own, white, strict=True)])
    torch.testing.assert_close(both.transport.pixels(GGX()(both.pairs))[0], expected, rtol=1e-4, atol=1e-6)
    assert int(both.mask.sum()) == len(expected) and both.mask.shape == (both.size, both.size)


def test_a_loss_of_several_scenes_is_0_for_the_target_alone(two):
    loss = RenderedLoss(SideBySide(two), "delta_e76")
    values = GGX()(loss.pairs).detach()
    assert loss(values, values, loss.pairs) == 0
    assert loss(0.5 * values, values, loss.pairs) > 1
    assert loss.scene_summary.startswith("2 scenes: ")


def test_what_cannot_be_side_by_side(two):
    with pytest.raises(UsageError, match="expected at least one scene"):
        SideBySide([])
    with pytest.raises(UsageError, match="ssim is no mean over pixels"):
        RenderedLoss(SideBySide(two), "ssim")


@pytest.mark.parametrize("mesh", [torus(), knot()])
def test_tubes_are_closed_and_face_outward(mesh):
    corners = mesh.vertices[mesh.faces]
    volume = (corners[:, 0] * torch.linalg.cross(*torch.from_numpy(corners[:, 1:]).unbind(1)).numpy()).sum() / 6
    assert volume > 0
    edges = {(a, b) for face in mesh.faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}
    assert all((b, a) in edges for a, b in edges)


def test_lights_are_pictures():
    for picture in (evening(32), room(32)):
        assert picture.shape == (32, 64, 3) and picture.dtype == torch.float32
        assert bool((picture > 0).all() and picture.isfinite().all())


def test_unseen_scenes_show_something_from_every_side():
    for scene in unseen_scenes(size=16).values():
        shown = scene.view_cosine[scene.mask]
        assert 0 < shown.min() < math.cos(math.radians(60)) < shown.max() <= 1
        assert not scene.view_cosine[~scene.mask].any()
