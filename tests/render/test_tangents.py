"""Pictures of materials with a grain: in the frames of the mesh's tangents."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchbrdf import load
from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.lobes import GGX, FitRecord, GGXAnisotropic, Lambert, Sum, WardAnisotropic, write_fits
from torchbrdf.pairs import Pairs
from torchbrdf.render import Environment, Mesh, Scene, blob, render, sphere
from torchbrdf.render.draw import render_by_transport
from torchbrdf.render.light.punctual import DirectionalLight
from torchbrdf.render.raster.mesh import level_tangents

BRUSHED = GGXAnisotropic(specular=[0.9, 0.6, 0.3], roughness_x=0.08, roughness_y=0.3, rotation=0.3, f0=0.8)


def turned(mesh: Mesh, angle: float) -> Mesh:
    """With tangents that lie counterclockwise of the level ones."""
    level = level_tangents(mesh.normals)
    across = np.cross(mesh.normals, level)
    return replace(mesh, tangents=2.5 * (math.cos(angle) * level + math.sin(angle) * across))


@cache
def scene_of(angle: float | None = None) -> Scene:
    mesh = sphere(5) if angle is None else turned(sphere(5), angle)
    lights = [DirectionalLight((0.5, 1.0, 0.4), (3.0, 2.0, 1.0))]
    return Scene(mesh, None, Environment.default(), size=24, nodes=64, light_samples=128, punctual_lights=lights)


def alike(one: Tensor, other: Tensor, within: float = 1e-3) -> None:
    assert (one - other).abs().max() < within * other.abs().max()


def test_level_tangents_lie_in_the_surface() -> None:
    normals = np.vstack([sphere(3).normals, [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    found = level_tangents(normals)
    np.testing.assert_allclose((found * normals).sum(1), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-12)
    assert not found[:, 1].any()
    # To the right of somebody in front of it.
    np.testing.assert_allclose(level_tangents(np.array([[0.0, 0.0, 1.0]])), [[1.0, 0.0, 0.0]])


def test_equal_widths_are_drawn_as_the_isotropic_lobe() -> None:
    colour = [0.9, 0.6, 0.3]
    grain = GGXAnisotropic(specular=colour, roughness_x=0.2, roughness_y=0.2, rotation=0.7, f0=0.8)
    alike(render(grain, scene_of()), render(GGX(specular=colour, roughness=0.2, f0=0.8), scene_of()))


@pytest.mark.parametrize("angle", [0.0, 0.5, -1.2])
def test_turning_the_tangents_is_turning_the_grain(angle: float) -> None:
    """As is one vector for another; and a whole turn of the grain is none."""
    expected = render(BRUSHED, scene_of())
    other = GGXAnisotropic(specular=[0.9, 0.6, 0.3], roughness_x=0.08, roughness_y=0.3, f0=0.8, rotation=0.3 - angle)
    alike(render(other, scene_of(angle)), expected, 5e-3)
    if angle:
        assert (render(BRUSHED, scene_of(angle)) - expected).abs().max() > 0.05 * expected.max()


def test_the_highlight_is_drawn_out_across_the_grain() -> None:
    """A light at the camera, on a level grain: a streak up and down the sphere."""
    scene = Scene(sphere(5), size=33, punctual_lights=[DirectionalLight((0.0, 0.35, 1.0))])
    lobe = WardAnisotropic(specular=1.0, roughness_x=0.05, roughness_y=0.4)
    picture = render(lobe, scene)[0, :, :, 0]
    bright = (picture > 0.3 * picture.max()).nonzero().double().std(0)
    assert bright[0] > 3 * bright[1]
    turned_by_a_quarter = WardAnisotropic(specular=1.0, roughness_x=0.4, roughness_y=0.05)
    picture = render(turned_by_a_quarter, scene)[0, :, :, 0]
    bright = (picture > 0.3 * picture.max()).nonzero().double().std(0)
    assert bright[1] > 3 * bright[0]


def test_many_pictures_and_mixed_ones() -> None:
    """Where isotropic ones would be drawn by a transport, and when one is there."""
    brdfs = [BRUSHED, Lambert(albedo=0.5), BRUSHED, GGX(roughness=0.3), BRUSHED.batched(2)]
    alone = torch.cat([render(one, scene_of()) for one in (BRUSHED, Lambert(albedo=0.5))])
    assert scene_of().compact.pairs is not None
    found = render(brdfs, scene_of())
    assert found.shape[0] == 6
    for k, expected in ((0, 0), (1, 1), (2, 0), (4, 0), (5, 0)):
        alike(found[k], alone[expected], 1e-2)


def test_what_a_transport_cannot_draw_is_refused() -> None:
    scene = scene_of()
    assert not scene.pairs.is_oriented
    with pytest.raises(ShapeError, match=r"^Pairs: slope_x is needed, but only"):
        BRUSHED(scene.pairs)
    with pytest.raises(
        UsageError, match=r"^transport: expected isotropic BRDFs, found one with a grain; `render` draws"
    ):
        render_by_transport([Lambert(), BRUSHED], scene)


def test_functions_get_directions_in_the_tangents_frame() -> None:
    def shader(pairs: Pairs) -> Tensor:
        assert pairs.is_oriented
        with torch.no_grad():
            return BRUSHED(pairs)

    alike(render(shader, scene_of(0.5)), render(BRUSHED, scene_of(0.5)), 1e-6)


def test_isotropic_ones_are_drawn_without_tangents(monkeypatch: pytest.MonkeyPatch) -> None:
    """As quickly as ever."""
    scene = Scene(sphere(3), size=12, nodes=8, light_samples=16)
    monkeypatch.setattr("torchbrdf.render.scene.turned", None)
    monkeypatch.setattr("torchbrdf.render.raster.pixels.level_tangents", None)
    assert render(GGX(), scene).shape == (1, 12, 12, 3)
    with pytest.raises(TypeError):
        render(BRUSHED, scene)


def test_fits_of_a_grain_are_drawn(tmp_path: Path) -> None:
    """A `fits.json` in a material's place, also on MERL's bins, whose half vectors then lie all round."""
    values = {"diffuse": [0.1] * 3, "specular": [[0.9, 0.6, 0.3]], "f0": [0.8]}
    values |= {"roughness_x": [0.08], "roughness_y": [0.3], "rotation": [0.3]}
    record = FitRecord("brushed", "ggx_anisotropic", 1, values)
    write_fits(tmp_path / "fits.json", [record])
    stand_in = load(tmp_path / "fits.json")
    assert stand_in.is_anisotropic
    model = Sum(Lambert(albedo=0.1), BRUSHED)
    alike(render(stand_in, scene_of()), render(model, scene_of()), 1e-5)
    assert stand_in.pairs.is_oriented and stand_in.batch([0], torch.arange(100)).values.isfinite().all()
    assert stand_in.diffuse_45_0().isfinite().all()


def test_tangents_that_are_none() -> None:
    """0 and along the normal: level ones in their place."""
    ball = sphere(5)
    useless = replace(ball, tangents=np.where(np.arange(len(ball.vertices))[:, None] >= 0, 3 * ball.normals, 0))
    scene = Scene(useless, size=24, nodes=16, light_samples=32)
    expected = Scene(ball, size=24, nodes=16, light_samples=32)
    alike(render(BRUSHED, scene), render(BRUSHED, expected), 1e-5)
    nothing = Scene(replace(ball, tangents=np.zeros_like(ball.vertices)), size=24, nodes=16, light_samples=32)
    alike(render(BRUSHED, nothing), render(BRUSHED, expected), 1e-5)


@pytest.mark.parametrize(
    ("tangents", "message"),
    [
        (np.zeros((3, 3)), r"^blob: expected tangents \(\d+, 3\), found \(3, 3\)$"),
        (
            np.full_like(blob().vertices, np.nan),
            r"^blob: expected finite vertices, normals and tangents, found others$",
        ),
    ],
)
def test_bad_tangents(tangents: np.ndarray, message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        replace(blob(), tangents=tangents)


def lathe(columns: int = 96, rows: int = 48, swapped: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sphere of quads: vertices, texture coordinates with u around the axis (or, swapped, along it), and faces."""
    theta, phi = (
        np.linspace(end, stop, n + 1) for end, stop, n in ((0.03, np.pi - 0.03, rows), (0, 2 * np.pi, columns))
    )
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    x, y, z = np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)
    places = np.stack([x, y, z], -1).reshape(-1, 3)
    u, v = phi / (2 * np.pi), 1 - theta / np.pi
    coordinates = np.stack([v, u] if swapped else [u, v], -1).reshape(-1, 2)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    quads = np.stack([first, first + columns + 1, first + columns + 2, first + 1], 1)
    return places, coordinates, quads


def as_obj(path: Path, swapped: bool = False) -> Path:
    places, coordinates, quads = lathe(swapped=swapped)
    lines = [f"v {x} {y} {z}" for x, y, z in places] + [f"vt {u} {v}" for u, v in coordinates]
    lines += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in quad) for quad in quads]
    path.write_text("\n".join(lines))
    return path


def as_ply(path: Path, names: str = "s t") -> Path:
    places, coordinates, quads = lathe()
    header = ["ply", "format ascii 1.0", f"element vertex {len(places)}"]
    header += [f"property float {name}" for name in ["x", "y", "z", *names.split()]]
    header += [f"element face {len(quads)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(map(str, row)) for row in np.hstack([places, coordinates])]
    path.write_text("\n".join([*header, *rows, *("4 " + " ".join(map(str, quad)) for quad in quads)]))
    return path


@pytest.mark.parametrize("kind", ["obj", "s t", "u v", "texture_u texture_v"])
def test_tangents_lie_where_u_grows(kind: str, tmp_path: Path) -> None:
    mesh = Mesh.load(as_obj(tmp_path / "a.obj") if kind == "obj" else as_ply(tmp_path / "a.ply", kind))
    assert mesh.tangents is not None
    np.testing.assert_allclose((mesh.tangents * mesh.normals).sum(1), 0, atol=1e-9)
    inner = np.abs(mesh.vertices[:, 1]) < 0.95
    along = (mesh.tangents * level_tangents(mesh.normals)).sum(1)
    assert (along[inner] > 0.99).all()
    scene = Scene(mesh, size=24, nodes=16, light_samples=32)
    level = Scene(replace(mesh, tangents=None), size=24, nodes=16, light_samples=32)
    found, expected = (render(BRUSHED, one)[0] for one in (scene, level))
    assert (found - expected).abs().mean() < 0.02 * expected.mean()


def test_u_along_the_axis_is_a_quarter_of_a_turn(tmp_path: Path) -> None:
    mesh = Mesh.load(as_obj(tmp_path / "a.obj", swapped=True))
    assert mesh.tangents is not None
    assert (np.abs((mesh.tangents * level_tangents(mesh.normals)).sum(1)) < 0.1).all()
    quarter = GGXAnisotropic(
        specular=[0.9, 0.6, 0.3], roughness_x=0.08, roughness_y=0.3, rotation=0.3 - math.pi / 2, f0=0.8
    )
    one = Scene(mesh, size=24, nodes=16, light_samples=32)
    other = Scene(replace(mesh, tangents=None), size=24, nodes=16, light_samples=32)
    found, expected = render(quarter, one)[0], render(BRUSHED, other)[0]
    assert (found - expected).abs().mean() < 0.02 * expected.mean()


@pytest.mark.parametrize(
    "text",
    ["vt x y\n", "vt nan inf\n", "vt 0.5 0.5\n", "vt\n"],
    ids=["no numbers", "not finite", "one for all", "none"],
)
def test_texture_coordinates_that_say_nothing(text: str, tmp_path: Path) -> None:
    """The mesh is drawn as without them."""
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n"
    path = tmp_path / "a.obj"
    path.write_text(f"{corners}{text}f 1/1 2/1 3/1\nf 2/1 4/1 3/7\nf 2/1 4/-9 3/x\n")
    mesh = Mesh.load(path)
    assert mesh.tangents is None and len(mesh.faces) == 3
    assert not np.isnan(mesh.normals).any()


def test_a_mesh_is_saved_with_its_tangents(tmp_path: Path) -> None:
    """In single precision; a vertex without one has none again, and texture coordinates count for less."""
    mesh = turned(sphere(3), 0.4)
    mesh.tangents[5] = 0  # type: ignore[index]
    mesh.save(tmp_path / "ball.ply")
    again = Mesh.load(tmp_path / "ball.ply")
    assert again.tangents is not None
    np.testing.assert_allclose(again.unit_tangents(), mesh.unit_tangents(), atol=1e-6)
    assert not again.tangents[5].any()
    sphere(3).save(tmp_path / "plain.ply")
    assert Mesh.load(tmp_path / "plain.ply").tangents is None and b"tx" not in (tmp_path / "plain.ply").read_bytes()


def test_tangents_of_a_file_count_before_texture_coordinates(tmp_path: Path) -> None:
    names = ["x", "y", "z", "u", "v", "tx", "ty", "tz"]
    rows = [[0, 0, 0, 0, 0, 0, 2, 0.5], [1, 0, 0, 1, 0, "nan", 0, 0], [0, 1, 0, 0, 1, 0, 0, 0]]
    (tmp_path / "flat.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\n"
        + "".join(f"property float {name}\n" for name in names)
        + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        + "\n".join(" ".join(map(str, row)) for row in rows)
        + "\n3 0 1 2\n"
    )
    np.testing.assert_allclose(Mesh.load(tmp_path / "flat.ply").tangents, [[0, 1, 0], [1, 0, 0], [1, 0, 0]])


def test_other_formats_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"ball.obj: expected a name that ends in .ply, found '.obj'$"):
        sphere(1).save(tmp_path / "ball.obj")
    assert not [*tmp_path.iterdir()]


def test_unit_tangents_are_those_that_are_drawn() -> None:
    mesh = turned(sphere(3), 0.4)
    found = mesh.unit_tangents()
    np.testing.assert_allclose((found * mesh.normals).sum(1), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    np.testing.assert_allclose(found, mesh.tangents / 2.5, atol=1e-12)  # type: ignore[operator]
    along_normals = replace(mesh, tangents=3 * mesh.normals)
    np.testing.assert_allclose(along_normals.unit_tangents(), level_tangents(mesh.normals))
