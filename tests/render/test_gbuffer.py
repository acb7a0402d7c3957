"""OpenGL and software see the same, and where OpenGL does not work there is a picture all the same."""

import logging
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.triangle_soup import soup

from torchbrdf.cli import main
from torchbrdf.errors import UsageError
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, parameters, write_fits
from torchbrdf.render import Camera, Mesh, Scene, blob, sphere
from torchbrdf.render.raster import backends, opengl
from torchbrdf.render.raster.raster import rasterize


@pytest.fixture
def gl() -> str:
    """The renderer's name."""
    found = backends.find_opengl()
    if not found.renderer:
        pytest.skip(f"needs OpenGL: {found.reason}")
    return found.renderer


@pytest.fixture
def no_gl(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """OpenGL does not work."""
    monkeypatch.setattr(backends, "find_opengl", lambda: backends.OpenGL(None, "NoSuchDisplay: none"))
    backends.has_fast_opengl.cache_clear()
    yield
    backends.has_fast_opengl.cache_clear()


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every picture is worth OpenGL's start."""
    monkeypatch.setattr(backends, "_START", 0.0)


def bunny(data: Path) -> Mesh:
    return Mesh.load(data / "meshes" / "bunny_453v.ply")


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(
    "camera", [pytest.param(Camera(15.0), marks=pytest.mark.slow), Camera(-60.0, 60.0, elevation=40.0, distance=1.2)]
)
@pytest.mark.parametrize("shape", [sphere, blob, soup, lambda: soup(3000, 1), bunny])
def test_both_see_the_same_but_at_edges(
    shape: Callable[..., Mesh], camera: Camera, request: pytest.FixtureRequest
) -> None:
    mesh = bunny(request.getfixturevalue("data")) if shape is bunny else shape()
    size = 400
    ours, theirs = rasterize(mesh, camera, size), rasterize(mesh, camera, size, "pyrender")
    differ = np.flatnonzero((ours.triangle != theirs.triangle).reshape(-1))
    assert len(differ) <= 0.001 * size**2
    # Each that differs is at an edge of what one of them sees there, nearer than OpenGL's steps of 1/256 of a pixel
    # are long, or both triangles are there at one depth.
    points = camera.project(mesh, size)
    seen = np.stack([ours.triangle.reshape(-1)[differ], theirs.triangle.reshape(-1)[differ]])
    corners = points[:, mesh.faces[seen]]  # (3, 2, d, 3)
    start = corners[:2] - np.stack([differ % size, differ // size])[:, None, :, None]
    along = np.roll(start, -1, -1) - start
    share = np.clip(-(start * along).sum(0) / np.maximum((along**2).sum(0), 1e-30), 0, 1)
    away = np.where(seen >= 0, np.linalg.norm(start + share * along, axis=0).min(-1), np.inf).min(0)
    depth = np.linalg.norm((ours.position - theirs.position).reshape(-1, 3)[differ], axis=-1)
    assert ((away < 1 / 128) | (depth < 1e-5)).all()
    # and where the triangle is the same, so is all else
    same = ours.triangle == theirs.triangle
    for name in ("position", "normal"):
        np.testing.assert_array_equal(getattr(ours, name)[same], getattr(theirs, name)[same])


@pytest.mark.parametrize("backend", ["software", "pyrender"])
def test_positions_are_in_their_triangles(backend: str, request: pytest.FixtureRequest) -> None:
    if backend == "pyrender":
        request.getfixturevalue("gl")
    for mesh in (blob(), soup(2000, 5)):
        seen = rasterize(mesh, Camera(10.0), 200, backend)
        corners, place = mesh.vertices[mesh.faces[seen.triangle[seen.mask]]], seen.position[seen.mask]
        toward = corners - place[:, None]
        parts = np.linalg.norm(np.cross(toward, np.roll(toward, -1, 1)), axis=-1).sum(-1)
        whole = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
        np.testing.assert_allclose(parts, whole, rtol=1e-9, atol=1e-12)  # outside, the three parts are larger
        assert not seen.position[~seen.mask].any()


@pytest.mark.parametrize("backend", ["software", "pyrender"])
def test_of_equal_triangles_the_first_is_seen(backend: str, request: pytest.FixtureRequest) -> None:
    if backend == "pyrender":
        request.getfixturevalue("gl")
    corners = np.array([[-1.0, -0.7, 0.1], [1, -0.6, 0], [0.1, 0.9, 0.2]])
    faces = np.array([[0, 1, 2], [0, 1, 2], [1, 0, 2]])
    for order in ([0, 1, 2], [2, 1, 0]):
        seen = rasterize(Mesh(corners, faces[order], corners), Camera(), 50, backend)
        assert set(np.unique(seen.triangle)) == {-1, 0}


@pytest.mark.usefixtures("large")
def test_auto_takes_opengl_where_a_graphics_card_draws(gl: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "find_opengl", lambda: backends.OpenGL("NVIDIA H100"))
    backends.has_fast_opengl.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(backends.zbuffer, "nearest_triangles", None)
        drawn = rasterize(sphere(3), Camera(), 50, "auto")
    backends.has_fast_opengl.cache_clear()
    assert gl
    np.testing.assert_array_equal(drawn.triangle, rasterize(sphere(3), Camera(), 50, "pyrender").triangle)


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize(
    "renderer",
    ["llvmpipe (LLVM 15.0.6, 256 bits)", "softpipe", "ANGLE (Google, SwiftShader Device)", "Software Rasterizer"],
)
def test_auto_takes_software_where_the_processor_draws(renderer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "find_opengl", lambda: backends.OpenGL(renderer))
    monkeypatch.setattr(opengl, "nearest_triangles", None)
    backends.has_fast_opengl.cache_clear()
    drawn = rasterize(sphere(3), Camera(), 50, "auto")
    backends.has_fast_opengl.cache_clear()
    np.testing.assert_array_equal(drawn.triangle, rasterize(sphere(3), Camera(), 50, "software").triangle)


def test_auto_does_not_try_opengl_for_what_software_has_drawn_before_it_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "find_opengl", None)
    backends.has_fast_opengl.cache_clear()
    assert rasterize(sphere(3), Camera(), 50, "auto").mask.any()
    assert not backends.is_opengl_faster(33_000, 1200)  # the blob, at 400 pixels
    with pytest.raises(TypeError):
        backends.is_opengl_faster(10_000_000, 6000)


@pytest.mark.usefixtures("no_gl", "large")
def test_auto_takes_software_where_opengl_does_not_work(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "torchbrdf")
    drawn = [rasterize(sphere(3), Camera(), 50, backend) for backend in ("auto", "auto", "software")]
    np.testing.assert_array_equal(drawn[0].triangle, drawn[2].triangle)
    np.testing.assert_array_equal(drawn[1].normal, drawn[2].normal)
    assert caplog.messages == ["torchbrdf: rasterizing in software; OpenGL: NoSuchDisplay: none"]
    assert caplog.records[0].levelno == logging.INFO


@pytest.mark.usefixtures("no_gl")
def test_opengl_by_name_where_it_does_not_work_is_refused_with_the_reason() -> None:
    with pytest.raises(UsageError, match=r"NoSuchDisplay: none; on Debian apt-get install libegl1 .*") as caught:
        rasterize(sphere(3), Camera(), 50, "pyrender")
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("large")
def test_a_drawing_that_fails_is_an_error_or_done_in_software(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> np.ndarray:
        raise OSError("out of\nmemory")

    monkeypatch.setattr(backends, "find_opengl", lambda: backends.OpenGL("something"))
    monkeypatch.setattr(opengl, "nearest_triangles", fail)
    backends.has_fast_opengl.cache_clear()
    with pytest.raises(UsageError, match="could not draw 50 x 50 pixels: OSError: out of memory"):
        rasterize(sphere(3), Camera(), 50, "pyrender")
    assert rasterize(sphere(3), Camera(), 50, "auto").mask.any()
    monkeypatch.setattr(opengl, "MOST_TRIANGLES", 100)
    with pytest.raises(UsageError, match="at most 100 faces and vertices, found 512"):
        rasterize(sphere(3), Camera(), 50, "pyrender")
    assert rasterize(sphere(3), Camera(), 50, "auto").mask.any()
    backends.has_fast_opengl.cache_clear()


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("raise SystemExit('OpenGL.error.Error: no\\n')", "ended with status 1"),
        ("print('GLError: no'); raise SystemExit(1)", "GLError: no"),
        ("import os; os.abort()", "ended with status -6"),
        ("import time; time.sleep(60)", "no picture within 0 s"),
        ("", "ended with status 0"),
    ],
)
def test_a_trial_that_fails_is_a_reason(
    program: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "trial.py"
    script.write_text(program)
    monkeypatch.setattr(opengl, "__file__", str(script))
    monkeypatch.setattr(backends, "_PATIENCE", 0.3 if "sleep" in program else 60.0)
    found = backends.find_opengl.__wrapped__()
    assert found.renderer is None
    assert reason in found.reason


def test_the_trial_is_real_and_a_platform_that_is_set_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYOPENGL_PLATFORM", "nonsense")
    found = backends.find_opengl.__wrapped__()
    assert found.renderer is None
    assert "Error" in found.reason
    assert "\n" not in found.reason


def test_an_unknown_backend_is_named_with_its_neighbour() -> None:
    with pytest.raises(UsageError, match=r"unknown backend 'pyrendr'; .*did you mean 'pyrender'"):
        rasterize(sphere(2), Camera(), 8, "pyrendr")


@pytest.mark.usefixtures("gl")
def test_threads_may_draw_at_once() -> None:
    mesh, drawn = blob(), {}

    def draw(thread: int) -> None:
        drawn[thread] = rasterize(mesh, Camera(15.0 * thread), 60, "pyrender").triangle

    threads = [threading.Thread(target=draw, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k in range(3):
        np.testing.assert_array_equal(drawn[k], rasterize(mesh, Camera(15.0 * k), 60, "pyrender").triangle)


@pytest.mark.usefixtures("gl")
def test_a_fork_draws_in_software(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would wait forever for the threads of OpenGL, which are not in it."""
    rasterize(sphere(2), Camera(), 8, "pyrender")
    monkeypatch.setattr(os, "getpid", lambda: -1)
    with pytest.raises(UsageError, match="forked"):
        rasterize(sphere(2), Camera(), 8, "pyrender")
    assert rasterize(sphere(2), Camera(), 8, "auto").mask.any()


def test_a_scene_passes_its_backend_on() -> None:
    with pytest.raises(UsageError, match="unknown backend 'hardware'"):
        Scene(sphere(2), Camera(), size=4, backend="hardware")
    assert Scene(sphere(2), Camera(), size=4, backend="software").coverage.any()


def test_the_command_line_has_backends_and_says_what_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paint = tmp_path / "paint.json"
    model = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.1, roughness=0.2))
    write_fits(paint, [FitRecord("paint", "ward", 1, parameters(model))])
    draw = ["render", str(paint), "--size", "16", "--shape", "sphere", "--out", str(tmp_path), "--backend"]
    assert main([*draw, "software"]) == 0
    assert main([*draw, "auto"]) == 0
    assert main([*draw, "hardware"]) == 2
    assert "unknown backend 'hardware'" in capsys.readouterr().err
    assert main(["info", "--system"]) == 0
    printed = capsys.readouterr().out
    for name in ("python", "torch", "cuda", "opengl", "embreex"):
        assert f"\n{name} " in "\n" + printed
    assert (backends.find_opengl().renderer or backends.find_opengl().reason) in printed
    assert main(["info"]) == 2
    assert "expected files, --zoo or --system" in capsys.readouterr().err
