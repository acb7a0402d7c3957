"""Meshes and the z-buffer, against ray casting and closed forms."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from torchbrdf.errors import DataError, UsageError
from torchbrdf.render import Mesh, View, blob, raster, sphere
from torchbrdf.render.mesh import make_blob
from torchbrdf.render.raster import rasterize


def rays(mesh: Mesh, view: View, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The eye, and the direction through each pixel's centre, `(size, size, 3)`."""
    eye, axes = view.camera(mesh)
    half = np.tan(np.radians(view.field_of_view) / 2)
    across = ((np.arange(size) + 0.5) / size * 2 - 1) * half
    x, y = np.meshgrid(across, -across)
    directions = np.stack([x, y, -np.ones_like(x)], -1) @ axes
    return eye, directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def soup(count: int = 60, seed: int = 0) -> Mesh:
    """Random triangles, of all sizes, through each other."""
    generator = np.random.default_rng(seed)
    middles = generator.uniform(-1, 1, (count, 1, 3))
    corners = middles + generator.normal(size=(count, 3, 3)) * generator.uniform(0.05, 0.8, (count, 1, 1))
    normals = generator.normal(size=(3 * count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), normals)


def test_the_nearest_triangle_is_the_one_that_a_ray_hits_first() -> None:
    mesh, size = soup(), 48
    view = View(rotation=33.0, field_of_view=40.0)
    seen = rasterize(mesh, view, size)
    eye, directions = rays(mesh, view, size)
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
    doubtful = (np.abs(inside) < 1e-6).any(-1)
    assert doubtful.sum() < 10
    np.testing.assert_array_equal(seen.triangle[~doubtful], expected[~doubtful])
    assert np.unique(expected).size > 20
    place = np.nonzero((expected >= 0) & ~doubtful)
    points = eye + hit.min(-1)[place][:, None] * directions[place]
    np.testing.assert_allclose(seen.position[place], points, atol=1e-9)
    barycentric = np.stack([1 - u - v, u, v], -1)[(*place, expected[place])]
    np.testing.assert_allclose(seen.barycentric[place], barycentric, atol=1e-9)


def test_the_sphere_has_its_outline_and_normals() -> None:
    mesh, size = sphere(6), 200
    view = View(field_of_view=50.0)
    seen = rasterize(mesh, view, size)
    eye, directions = rays(mesh, view, size)
    closest = np.linalg.norm(np.cross(eye, directions), axis=-1)
    pixel = 2 * np.tan(np.radians(25)) * np.linalg.norm(eye) / size
    assert seen.mask[closest < 1 - pixel / 4].all()
    assert not seen.mask[closest > 1].any()
    exact = seen.position / np.maximum(np.linalg.norm(seen.position, axis=-1, keepdims=True), 1e-9)
    assert np.degrees(np.linalg.norm(seen.normal - exact, axis=-1)[seen.mask].max()) < 0.02
    assert not seen.normal[~seen.mask].any()


def test_pictures_are_upright_and_not_mirrored() -> None:
    corners = np.array([[0.3, 0.3, 0], [0.9, 0.3, 0], [0.3, 0.9, 0.0], [-1, -1, -1], [-1, -1.01, -1], [-1.01, -1, -1]])
    mesh = Mesh(corners, np.array([[0, 1, 2], [3, 4, 5]]), np.tile([0.0, 0, 1], (6, 1)))
    rows, columns = np.nonzero(rasterize(mesh, View(0), 64).triangle == 0)
    assert rows.max() < 32
    assert columns.min() > 31
    rows, columns = np.nonzero(rasterize(mesh, View(180), 64).triangle == 0)
    assert rows.max() < 32
    assert columns.max() < 32
    # the camera goes toward +x, so that what is in front, at +z, moves to the left
    front = Mesh(corners[[0, 1, 2]] * [1, 1, 0] + [0, 0, 1.0], np.array([[0, 1, 2]]), np.tile([0.0, 0, 1], (3, 1)))
    both = Mesh(np.vstack([front.vertices, -front.vertices]), np.arange(6).reshape(2, 3), front.vertices.repeat(2, 0))
    columns = [np.nonzero(rasterize(both, View(angle), 64).triangle == 0)[1].mean() for angle in (0, 30)]
    assert columns[1] < columns[0]


def test_there_are_no_holes_between_triangles() -> None:
    mask = rasterize(blob(), View(15), 300).mask
    for row in mask[mask.any(1)]:
        columns = np.flatnonzero(row)
        assert np.diff(np.flatnonzero(np.diff(columns) > 1)).size == 0  # at most one gap: a hollow of the outline
    assert 0.3 < mask.mean() < 0.8


def test_parts_give_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = rasterize(soup(), View(), 40)
    monkeypatch.setattr(raster, "_CHUNK", 50)
    parts = rasterize(soup(), View(), 40)
    np.testing.assert_array_equal(parts.triangle, whole.triangle)
    np.testing.assert_array_equal(parts.normal, whole.normal)


@pytest.mark.filterwarnings("error")
def test_triangles_without_area_on_the_screen_do_no_harm() -> None:
    vertices = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, -1, 1], [0.5, 0.5, 0.5]])
    faces = np.array([[0, 1, 2], [3, 3, 3], [2, 3, 4], [5, 5, 0]])  # a good one, a point, edge on, a line
    mesh = Mesh(vertices, faces, np.tile([0.0, 0, 1], (6, 1)))
    seen = rasterize(mesh, View(), 65)
    assert (seen.triangle == 0).sum() > 100
    assert np.isfinite(seen.normal).all()


@pytest.mark.parametrize("rotation", [0.0, 15.0, 100.0, -250.0])
@pytest.mark.parametrize("shape", [blob, sphere])
def test_every_view_fits_the_object(shape: Callable[[], Mesh], rotation: float) -> None:
    mask = rasterize(shape(), View(rotation), 100).mask
    assert not mask[[0, -1]].any()
    assert not mask[:, [0, -1]].any()
    assert 0.7 < max(mask.any(0).mean(), mask.any(1).mean()) < 0.95


@pytest.mark.parametrize("wrong", [{"rotation": np.nan}, {"field_of_view": 0}, {"field_of_view": 170}])
def test_views_that_cannot_be(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        View(**wrong)


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
def test_meshes_of_other_makers(tmp_path: Path, ending: str, inside_out: bool) -> None:
    ball = trimesh.creation.icosphere(3)
    if inside_out:
        ball.invert()
    ball.export(tmp_path / f"ball.{ending}")
    mesh = Mesh.load(tmp_path / f"ball.{ending}")
    assert len(mesh.faces) == len(ball.faces)
    np.testing.assert_allclose((mesh.normals * mesh.vertices).sum(1), 1, atol=1e-3)


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


def test_opposite_faces_leave_a_normal(tmp_path: Path) -> None:
    """A fin: its two sides cancel in the average."""
    fin = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 1]], process=False)
    fin.export(tmp_path / "fin.off")
    np.testing.assert_allclose(np.abs(Mesh.load(tmp_path / "fin.off").normals), [[0, 0, 1]] * 3, atol=1e-9)


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
            "vertex 7|readable",
        ),
        ("nothing of the kind", "not a readable mesh"),
        ("", "not a readable mesh|no faces"),
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
    with pytest.raises(DataError, match="not a readable mesh"):
        Mesh.load(tmp_path / "mesh.xyzzy")


def test_a_real_mesh(data: Path) -> None:
    mesh = Mesh.load(data / "meshes" / "bunny_453v.ply")
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-6)
    assert rasterize(mesh, View(30), 64).mask.mean() > 0.2
