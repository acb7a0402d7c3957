"""Pictures, against brute force, closed forms, and another renderer."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest
import torch
from helpers.painted import MATERIALS, Painted
from torch import Tensor

from torchbrdf import memory
from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.lobes import Lambert, Sum, Ward
from torchbrdf.lobes.parameter_dict import with_parameters
from torchbrdf.measured import Measured, load, standins
from torchbrdf.pairs import Pairs
from torchbrdf.parallel import thread_map
from torchbrdf.render import Camera, Environment, Mesh, Scene, blob, draw, render, sphere
from torchbrdf.render.draw import render_directly
from torchbrdf.render.light.octahedral import texel_centers
from torchbrdf.render.transport.quadrature import FAR, NEAR, HalfVectorQuadrature


@pytest.fixture(scope="module")
def grove() -> Environment:
    return Environment.default()


@pytest.fixture(scope="module")
def small(grove: Environment) -> Scene:
    return Scene(blob(), Camera(15.0), grove, size=12)


def constant(value: float = 1.0) -> Environment:
    return Environment.from_image(torch.full((8, 16, 3), value))


def brute_force(materials: Sequence[Callable[[Pairs], Tensor]], scene: Scene) -> Tensor:
    """Every texel of the environment as a light, for every pixel."""
    side = scene.environment.texels.shape[0]
    lights = texel_centers(side).reshape(-1, 3)
    flux = scene.environment.texels.reshape(-1, 3) * (4 * math.pi / side**2)

    def light(k: int) -> Tensor:
        incident = lights @ scene._pixels.frame[k].T
        above = incident[:, 2] > 0
        pairs = Pairs.from_directions(incident[None, above], scene._pixels.outgoing[:, k])
        weight = flux[above] * incident[above, 2:]
        return torch.stack([(material(pairs)[0] * weight).sum(0) for material in materials])

    pictures = torch.zeros(len(materials), scene.size**2, 3)
    pictures[:, scene._pixels.index] = torch.stack(list(thread_map(light, range(len(scene._pixels.index)))), 1)
    return pictures.unflatten(1, (scene.size, scene.size))


@pytest.mark.parametrize(("lights", "tolerance"), [(1024, 2e-3), (4096, 5e-4)])
def test_furnace(lights: int, tolerance: float) -> None:
    """A white Lambert object under constant light is everywhere as bright as the light."""
    scene = Scene(blob(), Camera(), constant(3.0), size=40, light_samples=lights)
    picture = render(Lambert(albedo=1.0), scene)[0]
    np.testing.assert_allclose(picture[scene.mask].numpy(), 3, rtol=tolerance)
    assert not picture[~scene.mask].any()
    assert picture[scene.mask].mean().item() == pytest.approx(3, rel=5e-4)


@pytest.mark.parametrize("roughness", [0.001, 0.003, 0.01, 0.1])
def test_the_nodes_hold_a_sharp_lobe(roughness: float) -> None:
    """exp(-tan^2 theta / alpha^2) over the half vectors near the normal, by a fine sum over theta."""
    scene = Scene(sphere(2), Camera(), constant(), size=4)
    mirror = scene._quadratures[0]
    assert isinstance(mirror, HalfVectorQuadrature)
    _, tan2_h, solid, share = mirror.nodes
    found = (torch.exp(-tan2_h / roughness**2) * solid * share).sum() / 4
    theta = (np.arange(400_000) + 0.5) / 400_000 * math.radians(FAR)
    near, far = np.cos(np.radians([NEAR, FAR]))
    t = np.clip((np.cos(theta) - far) / (near - far), 0, 1)
    lobe = np.exp(-(np.tan(theta) ** 2) / roughness**2) * (3 * t**2 - 2 * t**3)
    expected = (lobe * 2 * math.pi * np.sin(theta)).sum() * math.radians(FAR) / 400_000
    assert found.item() == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize(
    ("level", "size", "least"),
    [(2, 12, {"lambert": 55, "glossy": 45, "rough": 50, "metal": 45}), (0, 6, {"sharp": 38, "glossy": 45})],
)
def test_pictures_against_brute_force(grove: Environment, level: int, size: int, least: dict[str, float]) -> None:
    """dB after tone mapping; as many lights as texels, many pixels of a coarse map and few of the full one."""
    scene = Scene(blob(), Camera(15.0), Environment(grove._pyramid[level]), size=size)
    materials = [MATERIALS[name] for name in least]
    found, expected = render(materials, scene), brute_force(materials, scene)
    tone = ToneMap.from_images(expected, scene.mask)
    quality = DIFFERENCES["psnr"]()(tone(found), tone(expected), scene.mask)
    assert (quality > torch.tensor([*least.values()])).all(), dict(zip(least, quality.tolist(), strict=True))
    ratio = found.mean((1, 2, 3)) / expected.mean((1, 2, 3))
    np.testing.assert_allclose(ratio.numpy(), 1, rtol=1e-2)


def test_a_mirror_shows_its_surroundings_the_right_way_round() -> None:
    directions = texel_centers(512)
    colors = torch.stack([directions[..., 0] > 0.7, directions[..., 1] > 0.7, directions[..., 2] > 0.9], -1)
    scene = Scene(sphere(), Camera(), Environment(colors.float() + 0.01), size=61)
    picture = render(Ward(specular=1.0, roughness=0.02), scene)[0]
    reach = 0.5 * 0.92 * math.sin(math.pi / 4) * 61  # where a sphere far away shows what lies to its side
    middle, side = 30, 30 + round(reach)
    assert picture[middle, middle].argmax() == 2
    assert picture[middle, side].argmax() == 0
    assert picture[60 - side, middle].argmax() == 1
    assert picture[middle, 60 - side].max() < 0.1 * picture[middle, side].max()
    assert picture[side, middle].max() < 0.1 * picture[60 - side, middle].max()


def test_turning_everything_changes_nothing(grove: Environment) -> None:
    still = render(MATERIALS["glossy"], Scene(sphere(), Camera(), grove, size=40))[0]
    turned = render(MATERIALS["glossy"], Scene(sphere(), Camera(70.0), Environment(grove.texels, 70.0), size=40))[0]
    relative = (still - turned).abs().sum() / still.sum()
    assert relative < 0.01


def test_geometry_is_shared_and_the_order_kept(small: Scene) -> None:
    materials = list(MATERIALS.values())
    together = render_directly(materials, small)
    assert together.shape == (5, 12, 12, 3)
    assert together.dtype == torch.float32
    for picture, material in zip(together, materials, strict=True):
        assert torch.equal(render(material, small)[0], picture)


def test_batched_lobes_draw_every_material(small: Scene) -> None:
    lobe = Sum(Lambert(), Ward()).batched(3).double()
    with torch.no_grad():
        for part, value in zip(lobe.components(), (0.1, 0.2), strict=True):
            for name in part.parameter_specs:
                getattr(part, name).copy_(torch.tensor([[1.0], [2.0], [3.0]]) * value / 3)
    pictures = render(lobe, small)
    assert pictures.shape == (3, 12, 12, 3)
    for k, row in enumerate(pictures):
        alone = with_parameters(lobe, {name: value[k] for name, value in lobe.named_parameters()})
        assert torch.equal(render(alone, small)[0], row)
    assert not torch.allclose(pictures[0], pictures[1])


def test_measured_materials_and_plain_functions(small: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draw, "_TABLES", 2)
    lobes = [Lambert(albedo=(k + 1) / 8) for k in range(5)]
    measured = Measured(Painted(lobes))
    calls: list[tuple[int, int]] = []
    mixed = [lobes[2], measured, lambda pairs: lobes[4](pairs)[0]]
    pictures = render(mixed, small, progress=lambda done, total: calls.append((done, total)))
    order = [lobes[2], *lobes, lobes[4]]
    assert torch.equal(pictures, render_directly(order, small))
    assert calls[-1] == (6 * int(small.mask.sum()), 6 * int(small.mask.sum()))
    assert all(done < more for (done, _), (more, _) in pairwise(calls))


def test_the_threads_are_given_back(small: Scene) -> None:
    threads = torch.get_num_threads()
    first, second = (render(MATERIALS["glossy"], small) for _ in range(2))
    assert torch.equal(first, second)
    assert torch.get_num_threads() == threads

    def broken(pairs: Pairs) -> Tensor:
        raise ShapeError("no such BRDF")

    with pytest.raises(ShapeError, match="no such BRDF"):
        render(broken, small)
    assert torch.get_num_threads() == threads


def test_what_the_pairs_know_fits_together(small: Scene) -> None:
    for _, known, weight in (job() for job in small.jobs()):
        known = known.select(samples=(weight.flatten(0, 1) > 0).any(-1).nonzero()[:, 0])
        derived = Pairs.from_directions(known.wi, known.wo)
        torch.testing.assert_close(known.wi.norm(dim=-1), torch.ones(1, len(known)))
        for name, tolerance in {"cos_i": 0, "cos_o": 0, "cos_h": 1e-6, "cos_d": 1e-6, "theta_d": 2e-3}.items():
            torch.testing.assert_close(getattr(known, name), getattr(derived, name), atol=tolerance, rtol=0)
        torch.testing.assert_close(known.tan2_h, derived.tan2_h, atol=1e-6, rtol=1e-3)
        # phi_d has a period of pi, and no meaning where the half vector is the normal
        steep = (known.tan2_h > 1e-4) & (known.theta_d > 1e-2)
        away = (known.phi_d - derived.phi_d)[steep]
        assert (2 * away).sin().abs().max() < 2e-2
        assert known.phi_d.min() >= 0


def test_coverage_is_smooth_at_the_outline(grove: Environment) -> None:
    scene = Scene(sphere(), Camera(), grove, size=50, nodes=8, light_samples=4)
    assert torch.equal(scene.mask, scene.coverage > 0)
    edge = scene.coverage[scene.mask & (scene.coverage < 1)]
    assert len(edge.unique()) > 4
    area = math.pi * (0.92 / 2 * 50) ** 2
    assert scene.coverage.sum().item() == pytest.approx(area, rel=0.02)


def test_surfaces_have_two_sides() -> None:
    """A square whose normals and corners point away from the viewer is lit from the side that is seen."""
    corners = np.array([[-1, -1, 0], [-1, 1, 0], [1, 1, 0], [1, -1, 0.0]])
    picture = torch.zeros(32, 64, 3)
    picture[:, :16] = 1.0
    picture[:, -16:] = 1.0  # all from +z, where the camera is
    environment = Environment.from_image(picture)
    for sign in (1, -1):
        mesh = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0.0, 0, sign], (4, 1)))
        scene = Scene(mesh, Camera(), environment, size=15)
        middle = render(Lambert(albedo=1.0), scene)[0, 7, 7]
        np.testing.assert_allclose(middle.numpy(), 1, rtol=5e-3)


def test_every_pixel_faces_the_viewer(small: Scene) -> None:
    assert small._pixels.outgoing[2].min() >= 0.02 - 1e-6
    identity = small._pixels.frame @ small._pixels.frame.transpose(1, 2)
    torch.testing.assert_close(identity, torch.eye(3).expand_as(identity), atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(small._pixels.frame), torch.ones(len(small._pixels.frame)))


def test_scenes_that_cannot_be(grove: Environment) -> None:
    with pytest.raises(UsageError, match="size"):
        Scene(sphere(2), Camera(), grove, size=0)
    with pytest.raises(UsageError, match="nodes"):
        Scene(sphere(2), Camera(), grove, size=4, nodes=0)
    with pytest.raises(UsageError, match="at least one"):
        render([], Scene(sphere(2), Camera(), grove, size=4))
    corners = np.array([[0, 0, 0], [1e-5, 0, 0], [0, 1e-5, 0], [9, 9, 9.0]])
    speck = Mesh(corners, np.array([[0, 1, 2], [3, 3, 3]]), np.ones((4, 3)), "speck.ply")
    with pytest.raises(DataError, match=r"speck\.ply: nothing to see"):
        Scene(speck, Camera(), grove, size=4)


def test_several_pictures_come_from_one_transport_and_are_as_good(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(sphere(3), size=24, nodes=32, light_samples=128)
    rough = torch.tensor([[0.02], [0.1], [0.4]])
    lobes = Sum(Lambert(albedo=0.2), Ward(specular=0.3, roughness=rough))
    tables = load(standins()).batch([6, 5])
    pairs = len(scene.pairs)
    monkeypatch.setattr(memory, "limit", lambda: 2 * 24 * 2 * (pairs + 500))  # two at a time
    seen: list[tuple[int, int]] = []
    found = render([lobes, tables], scene, lambda *numbers: seen.append(numbers))
    direct = render_directly([lobes, tables], scene)
    assert found.shape == (5, 24, 24, 3) and seen[-1][0] == seen[-1][1]
    for one, other in zip(found, direct, strict=True):
        shown, expected = (part / (part + direct[0].mean()) for part in (one, other))
        assert -10 * (shown - expected)[scene.mask].square().mean().log10() > 45


def test_what_is_not_reciprocal_is_drawn_pair_by_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    class Tilted(Lambert):
        def forward(self, pairs: Pairs) -> Tensor:
            return super().forward(pairs) * (1 + pairs.cos_i[..., None])

    def never(*_: object) -> Tensor:
        raise AssertionError

    monkeypatch.setattr(draw, "render_by_transport", never)
    scene = Scene(sphere(2), size=8, nodes=8, light_samples=16)
    render([Tilted(albedo=0.5)] * 4, scene)
    with pytest.raises(AssertionError):
        render([Lambert(albedo=0.5)] * 4, scene)
