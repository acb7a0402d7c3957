"""Meshes and what is seen of them, in software and by OpenGL, against ray casting and closed forms."""

import logging
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.triangle_soup import soup

from torchbrdf.assets.make_blob import make_blob
from torchbrdf.errors import DataError, UsageError
from torchbrdf.render import Camera, Mesh, blob, sphere
from torchbrdf.render.raster import raster, zbuffer
from torchbrdf.render.raster.backends import find_opengl
from torchbrdf.render.raster.raster import rasterize


@pytest.fixture(params=["software", "pyrender"])
def backend(request: pytest.FixtureRequest) -> str:
    """Each of what finds triangles, where it works."""
    if request.param == "pyrender" and not find_opengl().renderer:
        pytest.skip(f"needs OpenGL: {find_opengl().reason}")
    return str(request.param)


def rays(mesh: Mesh, camera: Camera, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The eye, and the direction through each pixel's centre, `(size, size, 3)`."""
    eye, axes = camera.pose(mesh)
    half = np.tan(np.radians(camera.field_of_view) / 2)
    across = ((np.arange(size) + 0.5) / size * 2 - 1) * half
    x, y = np.meshgrid(across, -across)
    directions = np.stack([x, y, -np.ones_like(x)], -1) @ axes
    return eye, directions / np.linalg.norm(directions, axis=-1, keepdims=True)


# How near to an edge, in barycentrics, a pixel may be counted to either side; OpenGL rounds to 1/256 of a pixel.
DOUBT = {"software": 1e-6, "pyrender": 2e-3}


@pytest.mark.parametrize("camera", [Camera(33.0, 40.0), Camera(-70.0, 60.0, elevation=50.0, distance=1.4)])
def test_the_nearest_triangle_is_the_one_that_a_ray_hits_first(backend: str, camera: Camera) -> None:
    mesh, size = soup(), 48
    seen = rasterize(mesh, camera, size, backend)
    eye, directions = rays(mesh, camera, size)
    # Moeller and Trumbore 1997, for all rays and triangles
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    p = np.cross(directions[..., None, :], c - a)
    scale = 1 / np.einsum("...k,...k", b - a, p)
    u = np.einsum("...k,...k", eye - a, p) * scale
    q = np.cross(eye - a, b - a)
    v = np.einsum("...k,fk->...f", directions, q) * scale
    distance = np.einsum("fk,fk->f", c - a, q) * scale
    inside = np.minimum(np.minimum(u, v), 1 - u - v)
    hit = np.where((inside >= 0) & (distance > 0), distance, np.inf)
    expected = np.where(np.isfinite(hit).any(-1), hit.argmin(-1), -1)
    doubtful = (np.abs(inside) < DOUBT[backend]).any(-1)
    assert doubtful.mean() < 10 * DOUBT[backend] + 0.004
    np.testing.assert_array_equal(seen.triangle[~doubtful], expected[~doubtful])
    assert np.unique(expected).size > 15
    place = np.nonzero((expected >= 0) & ~doubtful)
    points = eye + hit.min(-1)[place][:, None] * directions[place]
    np.testing.assert_allclose(seen.position[place], points, atol=1e-9)
    weights = np.stack([1 - u - v, u, v], -1)[(*place, expected[place])]
    smooth = np.einsum("pk,pkc->pc", weights, mesh.normals[mesh.faces[expected[place]]])
    smooth /= np.linalg.norm(smooth, axis=-1, keepdims=True)
    np.testing.assert_allclose(seen.normal[place], smooth, atol=1e-7)


@pytest.mark.parametrize(
    "camera", [Camera(0.0, 50.0), Camera(20.0, 50.0, elevation=-65.0), Camera(0.0, 80.0, distance=1.3)]
)
def test_the_sphere_has_its_outline_and_normals(backend: str, camera: Camera) -> None:
    mesh, size = sphere(6), 200
    seen = rasterize(mesh, camera, size, backend)
    eye, directions = rays(mesh, camera, size)
    closest = np.linalg.norm(np.cross(eye, directions), axis=-1)
    pixel = 2 * np.tan(np.radians(camera.field_of_view / 2)) * np.linalg.norm(eye) / size
    assert seen.mask[closest < 1 - pixel / 4].all()
    assert not seen.mask[closest > 1].any()
    exact = seen.position / np.maximum(np.linalg.norm(seen.position, axis=-1, keepdims=True), 1e-9)
    assert np.degrees(np.linalg.norm(seen.normal - exact, axis=-1)[seen.mask].max()) < 0.02
    assert not seen.normal[~seen.mask].any()
    # against the sphere itself, where the ray hits it; at the outline the ray hits the triangles, inside, elsewhere
    along = -(directions @ eye)
    hit = eye + (along - np.sqrt(np.maximum(1 - closest**2, 0)))[..., None] * directions
    clear = seen.mask & (-(hit * directions).sum(-1) > 0.15)
    assert clear.sum() > 0.97 * seen.mask.sum()
    assert np.degrees(np.linalg.norm(seen.normal - hit, axis=-1)[clear].max()) < 0.11


def test_pictures_are_upright_and_not_mirrored(backend: str) -> None:
    corners = np.array([[0.3, 0.3, 0], [0.9, 0.3, 0], [0.3, 0.9, 0.0], [-1, -1, -1], [-1, -1.01, -1], [-1.01, -1, -1]])
    mesh = Mesh(corners, np.array([[0, 1, 2], [3, 4, 5]]), np.tile([0.0, 0, 1], (6, 1)))
    rows, columns = np.nonzero(rasterize(mesh, Camera(0), 64, backend).triangle == 0)
    assert rows.max() < 32
    assert columns.min() > 31
    rows, columns = np.nonzero(rasterize(mesh, Camera(180), 64, backend).triangle == 0)
    assert rows.max() < 32
    assert columns.max() < 32
    # the camera goes toward +x, so that what is in front, at +z, moves to the left
    front = Mesh(corners[[0, 1, 2]] * [1, 1, 0] + [0, 0, 1.0], np.array([[0, 1, 2]]), np.tile([0.0, 0, 1], (3, 1)))
    both = Mesh(np.vstack([front.vertices, -front.vertices]), np.arange(6).reshape(2, 3), front.vertices.repeat(2, 0))
    columns = [np.nonzero(rasterize(both, Camera(angle), 64, backend).triangle == 0)[1].mean() for angle in (0, 30)]
    assert columns[1] < columns[0]
    # and upward, so that it moves down
    raised = [Camera(0, elevation=angle) for angle in (0, 30)]
    rows = [np.nonzero(rasterize(both, camera, 64, backend).triangle == 0)[0].mean() for camera in raised]
    assert rows[1] > rows[0]


def test_there_are_no_holes_between_triangles(backend: str) -> None:
    mask = rasterize(blob(), Camera(15), 300, backend).mask
    for row in mask[mask.any(1)]:
        columns = np.flatnonzero(row)
        assert np.diff(np.flatnonzero(np.diff(columns) > 1)).size == 0  # at most one gap: a hollow of the outline
    assert 0.3 < mask.mean() < 0.8


def test_parts_give_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = rasterize(soup(), Camera(), 40)
    monkeypatch.setattr(raster, "_PIXELS", 50)
    for name, most in {"_FACES": 7, "_SPANS": 20, "_PIXELS": 50}.items():
        monkeypatch.setattr(zbuffer, name, most)
    parts = rasterize(soup(), Camera(), 40)
    np.testing.assert_array_equal(parts.triangle, whole.triangle)
    np.testing.assert_array_equal(parts.normal, whole.normal)


@pytest.mark.filterwarnings("error")
def test_triangles_without_area_on_the_screen_do_no_harm(backend: str) -> None:
    vertices = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, -1, 1], [0.5, 0.5, 0.5]])
    faces = np.array([[0, 1, 2], [3, 3, 3], [2, 3, 4], [5, 5, 0]])  # a good one, a point, edge on, a line
    mesh = Mesh(vertices, faces, np.tile([0.0, 0, 1], (6, 1)))
    seen = rasterize(mesh, Camera(), 65, backend)
    assert (seen.triangle == 0).sum() > 100
    assert np.isfinite(seen.normal).all()
    assert set(np.unique(seen.triangle)) == {-1, 0}


@pytest.mark.parametrize("camera", [Camera(-250), Camera(40, 60, elevation=89)])
@pytest.mark.parametrize("shape", [blob, sphere])
def test_every_view_fits_the_object(shape: Callable[[], Mesh], camera: Camera, backend: str) -> None:
    mask = rasterize(shape(), camera, 100, backend).mask
    assert not mask[[0, -1]].any()
    assert not mask[:, [0, -1]].any()
    assert 0.7 < max(mask.any(0).mean(), mask.any(1).mean()) < 0.95


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"rotation": np.nan}, "degrees"),
        ({"field_of_view": 0}, "1 to 120"),
        ({"field_of_view": 170}, "1 to 120"),
        ({"elevation": 90}, "-89 to 89"),
        ({"elevation": np.nan}, "-89 to 89"),
        ({"distance": 1.0}, "the camera would be inside the object"),
        ({"distance": -3.0}, "the camera would be inside the object"),
        ({"distance": np.nan}, "bounding sphere"),
        ({"distance": np.inf}, "bounding sphere"),
    ],
)
def test_views_that_cannot_be(wrong: dict[str, float], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        Camera(**wrong)
    point = Mesh(np.ones((3, 3)), np.array([[0, 1, 2]]), np.ones((3, 3)))
    with pytest.raises(DataError, match="extent"):
        Camera().pose(point)
    with pytest.raises(UsageError, match="size >= 1, found 0"):
        rasterize(sphere(1), Camera(), 0)


@pytest.mark.parametrize(
    "camera", [Camera(), Camera(200, elevation=-89), Camera(31, 50, 62, 1.001), Camera(-7, elevation=12.5)]
)
def test_the_camera_looks_at_the_middle_from_where_it_is_asked_to(camera: Camera) -> None:
    mesh = soup()
    center, radius = mesh.bounding_sphere
    eye, axes = camera.pose(mesh)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1)
    distance = np.linalg.norm(eye - center)
    np.testing.assert_allclose(axes[2], (eye - center) / distance, atol=1e-12)
    assert np.degrees(np.arcsin(axes[2, 1])) == pytest.approx(camera.elevation)
    assert axes[0, 1] == 0  # the horizon is level
    assert axes[1, 1] > 0
    assert camera.distance is None or distance == pytest.approx(camera.distance * radius)
    assert camera.project(mesh, 10)[2].min() > 0


@pytest.mark.parametrize("distance", [1.0001, 1e6])
def test_from_next_to_the_object_and_from_afar_there_is_a_picture(backend: str, distance: float) -> None:
    camera = Camera(field_of_view=1.0 if distance > 2 else 120.0, distance=distance)
    seen = rasterize(sphere(4), camera, 101, backend)
    assert np.isfinite(seen.position).all()
    if distance < 2:
        assert seen.mask[50, 50]
        np.testing.assert_allclose(seen.position[50, 50], [0, 0, 1], atol=0.1)


@pytest.mark.slow
def test_a_million_triangles_are_seen_within_bounded_memory(backend: str) -> None:
    outer = sphere(8)
    inner = len(outer.vertices)
    mesh = Mesh(
        np.vstack([0.9 * outer.vertices, outer.vertices]),
        np.vstack([outer.faces, outer.faces + inner]),
        np.vstack([outer.normals, outer.normals]),
    )
    assert len(mesh.faces) > 1_000_000
    tracemalloc.start()
    try:
        seen = rasterize(mesh, Camera(30.0), 300, backend)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 400e6
    assert (seen.triangle[seen.mask] >= len(outer.faces)).all()
    np.testing.assert_allclose(np.linalg.norm(seen.position[seen.mask], axis=-1), 1, atol=1e-4)
    np.testing.assert_allclose(seen.normal[seen.mask], seen.position[seen.mask], atol=1e-3)


def test_the_blob_is_the_generators() -> None:
    kept, made = blob(), make_blob()
    np.testing.assert_array_equal(kept.faces, made.faces)
    np.testing.assert_allclose(kept.vertices, made.vertices, atol=1e-6)
    np.testing.assert_allclose(kept.normals, made.normals, atol=1e-6)


def test_the_blob_is_a_closed_surface_with_hills_and_hollows() -> None:
    mesh = blob()
    other = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert other.is_watertight
    assert other.volume > 0
    # analytic normals against those of the triangles around
    assert (other.vertex_normals * mesh.normals).sum(1).min() > 0.999
    # on a hill the neighbours lie below the tangent plane, in a hollow above
    edge = mesh.vertices[other.edges[:, 1]] - mesh.vertices[other.edges[:, 0]]
    height = np.bincount(other.edges[:, 0], (edge * mesh.normals[other.edges[:, 0]]).sum(1), len(mesh.vertices))
    assert 0.02 < (height > 0).mean() < 0.5


@pytest.mark.parametrize("ending", ["stl", "obj", "glb", "off", "ply"])
@pytest.mark.parametrize("inside_out", [False, True])
def test_meshes_of_other_makers(
    tmp_path: Path, ending: str, inside_out: bool, caplog: pytest.LogCaptureFixture
) -> None:
    ball = trimesh.creation.icosphere(3)
    if inside_out:
        ball.invert()
    ball.export(tmp_path / f"ball.{ending}")
    mesh = Mesh.load(tmp_path / f"ball.{ending}")
    assert len(mesh.faces) == len(ball.faces)
    np.testing.assert_allclose((mesh.normals * mesh.vertices).sum(1), 1, atol=1e-3)
    said = f"torchbrdf: {tmp_path}/ball.{ending}: closed and inside out; turned its 1280 triangles"
    assert caplog.messages == ([said] if inside_out else [])


def test_normals_of_the_file_are_kept(tmp_path: Path) -> None:
    mesh = make_blob(3)
    mesh.save(tmp_path / "blob.ply")
    loaded = Mesh.load(tmp_path / "blob.ply")
    np.testing.assert_allclose(loaded.normals, mesh.normals, atol=1e-6)


def test_scenes_are_put_together(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box())
    scene.add_geometry(trimesh.creation.box(), transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.export(tmp_path / "two.glb")
    mesh = Mesh.load(tmp_path / "two.glb")
    assert len(mesh.faces) == 24
    assert np.ptp(mesh.vertices[:, 0]) == pytest.approx(6)


def test_opposite_faces_leave_a_normal(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A fin: its two sides cancel in the average."""
    fin = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 1]], process=False)
    fin.export(tmp_path / "fin.off")
    np.testing.assert_allclose(np.abs(Mesh.load(tmp_path / "fin.off").normals), [[0, 0, 1]] * 3, atol=1e-9)
    assert caplog.messages[0].endswith("3 of 3 vertices have no normal; each took that of one of its faces")


def test_triangles_without_area_are_dropped_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ball = trimesh.creation.icosphere(2)
    faces = np.vstack([[[5, 5, 5], [1, 1, 2]], ball.faces, [[3, 4, 3]]])
    trimesh.Trimesh(ball.vertices, faces, process=False).export(tmp_path / "ball.ply")
    mesh = Mesh.load(tmp_path / "ball.ply")
    np.testing.assert_array_equal(mesh.faces, ball.faces)
    assert caplog.messages == [f"torchbrdf: {tmp_path}/ball.ply: dropped 3 of 323 triangles without area"]
    assert caplog.records[0].levelno == logging.WARNING


def test_an_open_mesh_is_left_as_it_is(tmp_path: Path, caplog: pytest.LogCaptureFixture, backend: str) -> None:
    """Whether half a ball is inside out cannot be known, and it is seen either way."""
    ball = trimesh.creation.icosphere(3)
    seen = []
    for order in ([0, 1, 2], [2, 1, 0]):
        half = trimesh.Trimesh(ball.vertices, ball.faces[::2][:, order], process=False)
        half.export(tmp_path / "half.ply")
        mesh = Mesh.load(tmp_path / "half.ply")
        np.testing.assert_array_equal(mesh.faces, half.faces)
        seen.append(rasterize(mesh, Camera(20), 100, backend))
    assert (seen[0].triangle != seen[1].triangle).sum() < 5
    assert caplog.messages == []


def test_parts_without_faces_are_left_out_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = trimesh.Scene([trimesh.creation.box(), trimesh.PointCloud(np.eye(3))])
    scene.export(tmp_path / "both.glb")
    assert len(Mesh.load(tmp_path / "both.glb").faces) == 12
    assert caplog.messages == [f"torchbrdf: {tmp_path}/both.glb: left out 1 of 2 parts without faces"]


PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (PLY + "element face 0\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n", "no faces"),
        (PLY + "end_header\n0 0 0\n1 0 0\n0 1 0\n", "no faces"),
        (
            PLY + "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n",
            "no area",
        ),
        (
            PLY
            + "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\nnan 1 0\n3 0 1 2\n",
            "not finite",
        ),
        (
            PLY + "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
            "name one of 3 vertex entries, found index 7",
        ),
        ("nothing of the kind", "expected a PLY header"),
        ("", "expected a PLY header"),
    ],
)
def test_bad_meshes_are_refused_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "mesh.ply"
    path.write_text(text)
    with pytest.raises(DataError, match=reason) as caught:
        Mesh.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_mesh_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        Mesh.load(tmp_path / "mesh.ply")
    (tmp_path / "mesh.xyzzy").write_text("?")
    with pytest.raises(DataError, match=r"ends in '\.xyzzy'"):
        Mesh.load(tmp_path / "mesh.xyzzy")


def test_a_real_mesh(data: Path, backend: str) -> None:
    mesh = Mesh.load(data / "meshes" / "bunny_453v.ply")
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-6)
    assert rasterize(mesh, Camera(30), 64, backend).mask.mean() > 0.2
