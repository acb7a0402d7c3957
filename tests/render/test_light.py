"""Shadows against other ways to find them, and punctual lights."""

import math
import sys

import numpy as np
import pytest
import torch
from torch import Tensor

from torchbrdf.assets.make_blob import BUMPS
from torchbrdf.errors import UsageError
from torchbrdf.parallel import thread_map
from torchbrdf.render import Mesh, blob, sphere
from torchbrdf.render.light.punctual import NEAREST, DirectionalLight, PointLight, parse_light
from torchbrdf.render.transport.shadows import Occluder

Points = tuple[Tensor, Tensor, Tensor]


def needs_embreex() -> None:
    pytest.importorskip("embreex", reason="shadows need embreex: pip install torchbrdf[shadows]")


def surface_points(mesh: Mesh, count: int, lights: int, seed: int = 0) -> Points:
    """Random points `(p, 3)`, corners and edges among them, normals, and directions above the horizon `(p, L, 3)`."""
    rng = np.random.default_rng(seed)
    face, weight = rng.integers(0, len(mesh.faces), count), rng.dirichlet((1, 1, 1), count)
    weight[: count // 20], weight[-(count // 20) :] = [1, 0, 0], [0.5, 0.5, 0]
    point, normal = (np.einsum("pk,pkc->pc", weight, part[mesh.faces[face]]) for part in (mesh.vertices, mesh.normals))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    direction = rng.normal(size=(count, lights, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    direction *= np.where(np.einsum("pc,plc->pl", normal, direction) < 0, -1, 1)[..., None]
    return tuple(torch.from_numpy(part).to(torch.float32) for part in (point, normal, direction))  # type: ignore


def joined(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    first = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    faces = [mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(faces),
        np.concatenate([mesh.normals for mesh in meshes]),
    )


def moved(mesh: Mesh, scale: float, shift: tuple[float, float, float]) -> Mesh:
    return Mesh(mesh.vertices * scale + np.array(shift), mesh.faces, mesh.normals)


def two_spheres(levels: int) -> Mesh:
    """The unit sphere, and one of radius 1/2 at (1.6, 0.4, 0)."""
    return joined(sphere(levels), moved(sphere(levels), 0.5, (1.6, 0.4, 0.0)))


def faceted(mesh: Mesh) -> Mesh:
    """The same triangles, each with its own flat normal."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), np.repeat(normal, 3, 0))


def nearest_hit(mesh: Mesh, start: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rays `(n, 3)`: the distance to the mesh, infinite if there is none, and how near any ray comes to an edge.

    T. Möller, B. Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, 1997, doi:10.1080/10867651.1997.10487468.
    """
    distance, margin = np.full(len(start), np.inf), np.full(len(start), np.inf)
    for a, b, c in mesh.vertices[mesh.faces]:
        p = np.cross(direction, c - a)
        determinant = p @ (b - a)
        q = np.cross(start - a, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = ((start - a) * p).sum(1) / determinant
            v = (direction * q).sum(1) / determinant
            t = q @ (c - a) / determinant
        inside = np.minimum(np.minimum(u, v), 1 - u - v)
        margin = np.fmin(margin, np.where(t > 0, np.abs(inside), np.inf))
        distance = np.where((inside > 0) & (t > 0) & (t < distance), t, distance)
    return distance, margin


def test_shadows_by_brute_force() -> None:
    """On flat triangles, where rays start at the surface itself."""
    needs_embreex()
    mesh = faceted(two_spheres(1))
    point, normal, direction = surface_points(mesh, 400, 50)
    seen = Occluder(mesh).visible(point, direction).numpy()
    start = (point + 1e-5 * normal).double().numpy()
    distance, margin = nearest_hit(mesh, start.repeat(50, 0), direction.double().reshape(-1, 3).numpy())
    clear = (margin > 1e-3).reshape(seen.shape)
    assert clear.mean() > 0.9
    assert 0.05 < (~seen).mean() < 0.5
    assert (seen == np.isinf(distance).reshape(seen.shape))[clear].all()


def test_shadows_up_to_a_distance() -> None:
    needs_embreex()
    mesh = faceted(two_spheres(1))
    point, normal, direction = surface_points(mesh, 200, 20)
    occluder = Occluder(mesh)
    start = (point + 1e-5 * normal).double().numpy()
    distance, _ = nearest_hit(mesh, start.repeat(20, 0), direction.double().reshape(-1, 3).numpy())
    exact = torch.from_numpy(distance).reshape(200, 20)
    hit = ~occluder.visible(point, direction)
    known = hit & exact.isfinite()
    assert known.sum() > 200
    # A light on the surface that is met is seen, one behind it is not.
    assert occluder.visible(point, direction, limit=exact * 0.999)[known].all()
    assert occluder.visible(point, direction, limit=exact)[known].float().mean() > 0.99
    assert not occluder.visible(point, direction, limit=exact * 1.001 + 1e-4)[known].any()
    assert torch.equal(occluder.visible(point, direction, limit=math.inf), ~hit)
    assert occluder.visible(point, direction, limit=0.0).all()


@pytest.mark.parametrize("levels", [0, 1, 2, 4, 6])
@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1000.0, 0.0), (0.001, 0.0), (1.0, 30.0)])
def test_a_sphere_casts_no_shadow_on_itself(levels: int, scale: float, shift: float) -> None:
    """However coarse it is: what is above the horizon of the smooth normal is seen."""
    needs_embreex()
    mesh = moved(sphere(levels), scale, (shift, -shift, 0.0))
    point, _, direction = surface_points(mesh, 500, 100)
    assert Occluder(mesh).visible(point, direction).all()


def test_two_spheres_as_their_formulas_say() -> None:
    needs_embreex()
    mesh = two_spheres(6)
    point, _, direction = surface_points(mesh, 2000, 100)
    seen = Occluder(mesh).visible(point, direction)
    expected, doubtful = torch.ones_like(seen), torch.zeros_like(seen)
    on_first = point.norm(dim=1) < 1.01
    for center, radius, others in (((1.6, 0.4, 0.0), 0.5, on_first), ((0.0, 0.0, 0.0), 1.0, ~on_first)):
        way = torch.tensor(center) - point
        along = torch.einsum("pc,plc->pl", way, direction)
        passed = (way.square().sum(-1, keepdim=True) - along.square()).clamp_min(0).sqrt()
        expected &= ~((passed < radius) & (along > 0) & others[:, None])
        doubtful |= ((passed - radius).abs() < 2e-3) & others[:, None]
    assert 0.02 < (~expected).float().mean() < 0.2
    assert doubtful.float().mean() < 0.01
    assert torch.equal(seen | doubtful, expected | doubtful)


def test_the_blob_as_its_formula_says() -> None:
    """A ray meets the blob where its points are nearer to the middle than the surface in their direction."""
    needs_embreex()
    axes = BUMPS[:, :3] / np.linalg.norm(BUMPS[:, :3], axis=1, keepdims=True)
    height, concentration = BUMPS[:, 3], BUMPS[:, 4]
    mesh = blob()
    point, _, direction = surface_points(mesh, 600, 20)
    seen = Occluder(mesh).visible(point, direction).numpy().reshape(-1)
    start, way = point.double().numpy().repeat(20, 0), direction.double().numpy().reshape(-1, 3)
    depth = np.full(len(start), -np.inf)
    for step in np.linspace(0.02, 3, 300):
        at = start + step * way
        distance = np.linalg.norm(at, axis=1)
        radius = 1 + (height * np.exp(concentration * (at @ axes.T / distance[:, None] - 1))).sum(1)
        depth = np.maximum(depth, radius - distance)
    clear = np.abs(depth) > 2e-3
    assert clear.mean() > 0.9
    assert (~seen).mean() > 0.01
    assert (seen == (depth < 0))[clear].mean() > 0.999


def test_only_what_is_wanted_and_in_any_thread() -> None:
    needs_embreex()
    mesh = two_spheres(4)
    point, _, direction = surface_points(mesh, 300, 100)
    occluder = Occluder(mesh)
    whole = occluder.visible(point, direction)
    wanted = torch.rand(300, 100, generator=torch.Generator().manual_seed(0)) < 0.3
    assert torch.equal(occluder.visible(point, direction, wanted), whole & wanted)
    assert not occluder.visible(point, direction, torch.zeros_like(wanted)).any()
    assert occluder.visible(point[:0], direction[:0]).shape == (0, 100)
    parts = [rows for _ in range(5) for rows in torch.arange(300).split(20)]
    found = list(thread_map(lambda rows: occluder.visible(point[rows], direction[rows]), parts))
    assert torch.equal(torch.cat(found), whole.repeat(5, 1))


def test_both_sides_of_a_sheet_are_lit() -> None:
    """An open sheet with normals to +z, bent so that its edges shade each other on the other side only."""
    needs_embreex()
    x = np.linspace(-1, 1, 21)
    vertices = np.array([(a, b, -(a**2)) for a in x for b in (-1, 1)])
    faces = np.array([f for k in range(0, 40, 2) for f in ((k, k + 2, k + 1), (k + 1, k + 2, k + 3))])
    normals = np.array([(2 * a, 0, 1) for a in x for _ in (-1, 1)]) / np.hypot(1, 2 * x).repeat(2)[:, None]
    mesh = Mesh(vertices, faces, normals)
    point, _, direction = surface_points(mesh, 400, 50)
    occluder = Occluder(mesh)
    assert occluder.visible(point, direction).all()
    below = occluder.visible(point, -direction)
    assert 0.5 < below.float().mean() < 0.95
    straight = torch.tensor([0.0, 0.0, -1.0]).expand(400, 1, 3)
    assert occluder.visible(point, straight).all()


@pytest.mark.parametrize("levels", [2, 5])
def test_it_does_not_matter_which_way_round_the_corners_go(levels: int) -> None:
    needs_embreex()
    mesh = sphere(levels)
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.normals)
    inward = Mesh(mesh.vertices, mesh.faces, -mesh.normals)
    point, _, direction = surface_points(mesh, 300, 50)
    for other in (turned, inward):
        assert Occluder(other).visible(point, direction).all()
        assert not Occluder(other).visible(point, -direction).any()


def test_shadows_without_embreex(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    with pytest.raises(UsageError, match=r"pip install torchbrdf\[shadows\]") as caught:
        Occluder(sphere(1))
    assert "\n" not in str(caught.value)


def test_a_directional_light_is_the_same_everywhere() -> None:
    light = DirectionalLight((0.0, 3.0, 4.0), 2)
    assert light.direction == (0.0, 0.6, 0.8)
    assert light.irradiance == (2.0, 2.0, 2.0)
    direction, irradiance, distance = light.at(torch.randn(5, 3))
    assert torch.equal(direction, torch.tensor([0.0, 0.6, 0.8]).expand(5, 3))
    assert torch.equal(irradiance, torch.full((5, 3), 2.0))
    assert torch.equal(distance, torch.full((5,), math.inf))
    assert DirectionalLight((0.0, 1e-200, 0.0)).direction == (0.0, 1.0, 0.0)
    assert DirectionalLight((1e300, 1e300, 0.0)).direction == pytest.approx((0.5**0.5, 0.5**0.5, 0.0))


def test_a_point_light_falls_with_the_square_of_the_distance() -> None:
    light = PointLight((1.0, 2.0, 3.0), (8, 4, 0))
    position = torch.tensor([[1.0, 2.0, 1.0], [1.0, 6.0, 3.0]], dtype=torch.float64)
    direction, irradiance, distance = light.at(position)
    assert distance.tolist() == [2.0, 4.0]
    assert direction.tolist() == [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    assert irradiance.tolist() == [[2.0, 1.0, 0.0], [0.5, 0.25, 0.0]]
    assert irradiance.dtype == torch.float64


def test_a_point_light_at_the_surface_gives_finite_numbers() -> None:
    light = PointLight((0.5, 0.0, 0.0), 1)
    direction, irradiance, distance = light.at(torch.tensor([[0.5, 0.0, 0.0], [0.5, 1e-8, 0.0]]))
    assert direction.tolist() == [[0.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    assert irradiance.flatten().tolist() == pytest.approx([NEAREST**-2] * 6)
    assert distance.tolist() == pytest.approx([0, 1e-8])


def test_punctual_lights_from_the_command_line() -> None:
    assert parse_light("directional:0,2,0:2.5") == DirectionalLight((0, 1, 0), 2.5)
    assert parse_light("directional:0,-1,0") == DirectionalLight((0, -1, 0), 1)
    assert parse_light("point:1,2,3:5,5,4") == PointLight((1, 2, 3), (5, 5, 4))
    assert parse_light("point: 1, -2e-1, 3") == PointLight((1, -0.2, 3))
    assert hash(parse_light("point:1,2,3")) == hash(PointLight((1, 2, 3)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("spot:1,2,3", "expected directional:X,Y,Z:COLOR or point:X,Y,Z:COLOR"),
        ("", "expected directional:X,Y,Z:COLOR"),
        ("point", "expected directional:X,Y,Z:COLOR"),
        ("point:1,2,3:1:2", "expected directional:X,Y,Z:COLOR"),
        ("point:1,2,x", "point:1,2,x: expected numbers with commas"),
        ("point:1,2", "PointLight.position: expected three finite numbers"),
        ("point:5", "PointLight.position: expected three finite numbers"),
        ("point:1,2,nan", "PointLight.position: expected three finite numbers"),
        ("point:1,2,3:1,2", "PointLight.intensity: expected one or three finite numbers"),
        ("point:1,2,3:-1", "PointLight.intensity: .*from 0 to 1e.15, found -1"),
        ("point:1,2,3:1e39", "PointLight.intensity: .*from 0 to 1e.15, found 1e.39"),
        ("point:1,1e23,3", "PointLight.position: expected at most 1e.09 from 0"),
        ("directional:0,1,0:1e39", "DirectionalLight.irradiance: .*from 0 to 1e.15"),
        ("directional:0,0,0", "DirectionalLight.direction: expected a vector other than 0"),
        ("directional:0,inf,0", "DirectionalLight.direction: expected three finite numbers"),
        ("directional:0,1,0:1,inf,1", "DirectionalLight.irradiance: expected one or three finite numbers"),
    ],
)
def test_punctual_lights_that_cannot_be(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        parse_light(text)
    assert "\n" not in str(caught.value)
