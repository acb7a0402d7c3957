"""Pictures against those of another renderer: the same object, camera, light and BRDF in Mitsuba 3."""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.measured_files import BINS, merl_centres
from helpers.mitsuba_pictures import (
    METAL,
    Beckmann,
    Bsdf,
    Likeness,
    Studio,
    brushed,
    conductor,
    diffuse,
    lathe,
    likeness,
    obstacle,
    table,
)
from torch import Tensor

from torchbrdf.lobes import CookTorrance, Lambert, RoughConductorAnisotropic, Sum
from torchbrdf.measured import load
from torchbrdf.measured.merl import write_merl
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, Environment, Mesh, Scene, blob, render, sphere
from torchbrdf.render.draw import Brdf
from torchbrdf.render.light.punctual import DirectionalLight, PointLight, PunctualLight

SIZE, CAMERA = 64, Camera(20.0)
# Mitsuba's noise is then 8 dB or more below what is asked of us.
SAMPLES = 32**2


@pytest.fixture(scope="module", autouse=True)
def _mitsuba() -> None:
    reason = obstacle()
    if reason:
        pytest.skip(reason)


@pytest.fixture(scope="module")
def merl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A MERL table of a coloured plastic."""
    plastic = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), CookTorrance(specular=0.3, roughness=0.15, f0=0.3)).double()
    path = tmp_path_factory.mktemp("merl") / "plastic.binary"
    with torch.no_grad():
        values = plastic(Pairs.from_half_diff(*(torch.from_numpy(centre.reshape(1, -1)) for centre in merl_centres())))
    write_merl(path, values.reshape(*BINS, 3))
    return path


@cache
def surroundings() -> Environment:
    return Environment.default()


def two_spheres() -> Mesh:
    """The unit sphere, and a smaller one before it that keeps light off it."""
    one = sphere(6)
    vertices = np.concatenate([one.vertices, one.vertices * 0.4 + np.array([0.8, 0.9, 0.8])])
    return Mesh(vertices, np.concatenate([one.faces, one.faces + len(one.vertices)]), np.tile(one.normals, (2, 1)))


@cache
def materials(name: str, merl: Path) -> tuple[Bsdf, Brdf]:
    """The same in Mitsuba and here."""
    made: dict[str, Callable[[], tuple[Bsdf, Brdf]]] = {
        "diffuse": lambda: (diffuse(0.5), Lambert(albedo=0.5)),
        "rough": lambda: (conductor(0.3), Beckmann(0.3)),
        "glossy": lambda: (conductor(0.1), Beckmann(0.1)),
        "table": lambda: (table(merl, 0.15), load(merl)),
    }
    return made[name]()


@cache
def scene_of(shape: str, shadows: bool) -> Scene:
    mesh = {"sphere": lambda: sphere(6), "blob": blob, "two spheres": two_spheres}[shape]()
    return Scene(mesh, CAMERA, surroundings(), size=SIZE, shadows=shadows)


@cache
def studio(shape: str) -> Studio:
    scene = scene_of(shape, False)
    return Studio(scene.mesh, CAMERA, surroundings(), scene.coverage == 1)


@cache
def theirs(shape: str, name: str, merl: Path) -> list[Tensor]:
    bsdf, _ = materials(name, merl)
    return [studio(shape).picture(bsdf, SAMPLES, seed) for seed in (0, 1)]


def compared(shape: str, shadows: bool, name: str, merl: Path) -> Likeness:
    _, brdf = materials(name, merl)
    ours = render(brdf, scene_of(shape, shadows))[0]
    return likeness(ours, theirs(shape, name, merl), studio(shape).where)


def check(found: Likeness) -> None:
    assert found.noise > 52, found
    assert found.psnr > 45, found
    assert found.ratio == pytest.approx(1, abs=5e-3), found


def slow(*values: str) -> object:
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize("material", [slow("diffuse"), slow("rough"), slow("glossy"), "table"])
def test_a_sphere_as_mitsuba_draws_it(material: str, merl: Path) -> None:
    check(compared("sphere", False, material, merl))


@pytest.mark.parametrize(
    ("shape", "material"),
    [slow("blob", "glossy"), slow("blob", "table"), ("two spheres", "diffuse")],
)
def test_shadows_as_mitsuba_draws_them(shape: str, material: str, merl: Path) -> None:
    pytest.importorskip("embreex", reason="shadows need embreex: pip install torchbrdf[shadows]")
    check(compared(shape, True, material, merl))


def test_shadows_are_seen(merl: Path) -> None:
    """Without them the two spheres are not alike."""
    assert compared("two spheres", False, "diffuse", merl).psnr < 35


@pytest.mark.parametrize(
    "light",
    [DirectionalLight((0.5, 1.0, 0.4), (3.0, 2.0, 1.0)), PointLight((-1.5, 1.5, 2.5), (1.0, 2.0, 3.0))],
    ids=["directional", "point"],
)
@pytest.mark.parametrize("material", ["glossy", slow("table")])
def test_punctual_lights_as_mitsuba_draws_them(material: str, light: PunctualLight, merl: Path) -> None:
    """One direction a pixel: nothing is left to chance, and nothing to a quadrature."""
    pytest.importorskip("embreex", reason="shadows need embreex: pip install torchbrdf[shadows]")
    mesh, (bsdf, brdf) = two_spheres(), materials(material, merl)
    scene = Scene(mesh, CAMERA, size=SIZE, punctual_lights=[light], shadows=True)
    where = scene.coverage == 1
    expected = Studio(mesh, CAMERA, [light], where).picture(bsdf, 1)
    found = render(brdf, scene)[0]
    away = ((found - expected).abs() / expected.amax()).amax(-1)[where]
    # Where a shadow begins, a pixel may be in the light or not.
    assert (away < 1e-4).float().mean() > 0.99
    assert (expected[where].sum(-1) == 0).float().mean() > 0.1


@pytest.mark.parametrize("widths", [(0.05, 0.3), pytest.param((0.3, 0.1), marks=pytest.mark.slow)])
def test_a_brushed_sphere_as_mitsuba_draws_it(widths: tuple[float, float]) -> None:
    """Turned on a lathe: the grain of its parallels, or across them; Mitsuba's own sphere has the same tangents."""
    where = scene_of("sphere", False).coverage == 1
    brush = Studio(sphere(6), CAMERA, surroundings(), where, shape=lathe())
    bsdf = brushed(*widths)
    names = dict(zip(("roughness_x", "roughness_y", "eta", "k"), (*widths, *METAL), strict=True))
    ours = render(RoughConductorAnisotropic(specular=1.0, **names), scene_of("sphere", False))[0]
    check(likeness(ours, [brush.picture(bsdf, SAMPLES, seed) for seed in (0, 1)], where))
    across = render(RoughConductorAnisotropic(specular=1.0, **names, rotation=math.pi / 2), scene_of("sphere", False))
    assert likeness(across[0], [brush.picture(bsdf, 64, seed) for seed in (0, 1)], where).psnr < 35
