"""Materials for Mitsuba: the same function where they are exact, and the same picture."""

import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import BINS, merl_centres, synthetic_bsdf, tensor_file
from helpers.mitsuba_pictures import Studio, likeness, mitsuba, obstacle

from torchbrdf.errors import DataError
from torchbrdf.export import Exported, export
from torchbrdf.export.mitsuba import mitsuba_dict
from torchbrdf.lobes import GGX, Lambert, Principled, RoughConductor, RoughPlastic, Sum
from torchbrdf.measured import Measured, load, standins, write_merl
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, Environment, Scene, blob, render, sphere

SIZE, CAMERA, SAMPLES = 64, Camera(20.0), 32**2
MITSUBA = pytest.mark.skipif(bool(obstacle()), reason=str(obstacle()))

METAL = RoughConductor(specular=[0.9, 0.6, 0.3], roughness=0.25, eta=0.2, k=3.0)
PLASTIC = Principled(base_color=[0.3, 0.2, 0.1], metallic=0.0, roughness=0.5, specular=0.6, clearcoat=0.5)
# Colours that together are above 1, and a lobe that is black.
BRIGHT = Sum(
    Lambert(albedo=[0.5, 0.3, 0.1]),
    RoughConductor(specular=[0.9, 0.6, 0.3], roughness=0.25, eta=0.2, k=3.0),
    RoughConductor(specular=0.0),
    RoughConductor(specular=[0.2, 0.8, 0.4], roughness=0.5, eta=1.2, k=2.0),
)
CHALK = Lambert(albedo=[0.8, 0.5, 0.2])
COATED = RoughPlastic(base_color=[0.8, 0.3, 0.1], specular=0.9, roughness=0.2, ior=1.6)
EXACT = {"diffuse": CHALK, "roughconductor": METAL, "principled": PLASTIC, "blend": BRIGHT, "roughplastic": COATED}
# Mitsuba's shares of light below a coat are by few facets; tests/lobes/test_roughplastic.py.
TOLERANCES = {"roughplastic": 1.3e-3}


@cache
def scene_of(shape: str) -> Scene:
    made = sphere(6) if shape == "sphere" else blob()
    return Scene(made, CAMERA, Environment.default(), size=SIZE, shadows=shape == "blob")


@cache
def studio(shape: str) -> Studio:
    scene = scene_of(shape)
    return Studio(scene.mesh, CAMERA, Environment.default(), scene.coverage == 1)


def loaded(done: Exported) -> Any:
    """The BSDF of an exported file, by Mitsuba."""
    return mitsuba().load_file(str(done.files[0]))


def values(bsdf: Any, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
    """Without the cosine; the viewer is Mitsuba's wi, the light its wo."""
    mi = mitsuba()
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = mi.Vector3f(*wo.T.float().numpy())
    found = bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(*wi.T.float().numpy()))
    return torch.from_numpy(found.numpy().T.copy()).double() / wi[:, 2:]


@MITSUBA
@pytest.mark.parametrize("name", EXACT)
def test_a_file_gives_the_bsdf(name: str, tmp_path: Path) -> None:
    done = export(EXACT[name], "mitsuba", tmp_path, name="a <paint>")
    assert done.exact and done.files == [tmp_path / done.files[0].name]
    bsdf = loaded(done)
    assert bsdf.id() == "a <paint>"
    wi, wo = (hemisphere(2000, seed=seed, dtype=torch.float32).double() for seed in (3, 4))
    pairs = Pairs.from_directions(wi, wo)
    away = (pairs.theta_h.rad2deg() > 3) & (torch.minimum(wi[:, 2], wo[:, 2]) > 1e-3)
    with torch.no_grad():
        expected = EXACT[name].double()(pairs)
    torch.testing.assert_close(values(bsdf, wi, wo)[away], expected[away], rtol=TOLERANCES.get(name, 1e-4), atol=1e-7)


@MITSUBA
def test_a_dict_is_the_same(tmp_path: Path) -> None:
    done = export(BRIGHT, "mitsuba", tmp_path)
    assert done.notes == ["exact: Mitsuba's diffuse + roughconductor + roughconductor"]
    wi, wo = (hemisphere(100, seed=seed, dtype=torch.float32).double() for seed in (3, 4))
    found = values(mitsuba().load_dict(mitsuba_dict(BRIGHT)), wi, wo)
    torch.testing.assert_close(found, values(loaded(done), wi, wo))


@MITSUBA
@pytest.mark.parametrize(
    ("shape", "name"),
    [
        ("sphere", "blend"),
        *(pytest.param("sphere", name, marks=pytest.mark.slow) for name in EXACT if name != "blend"),
        pytest.param("blob", "blend", marks=pytest.mark.slow),  # a shape and its shadows know nothing of materials
    ],
)
def test_exact_ones_have_the_same_picture(shape: str, name: str, tmp_path: Path) -> None:
    if shape == "blob":
        pytest.importorskip("embreex", reason="shadows need embreex: pip install torchbrdf[shadows]")
    bsdf = loaded(export(EXACT[name], "mitsuba", tmp_path))
    ours = render(EXACT[name], scene_of(shape))[0]
    theirs = [studio(shape).picture(bsdf, SAMPLES, seed) for seed in (0, 1)]
    found = likeness(ours, theirs, studio(shape).where)
    assert found.noise > 50, found
    assert found.psnr > 45, found
    assert found.ratio == pytest.approx(1, abs=5e-3), found


def test_what_is_black_is_left_out() -> None:
    """So that a metal beside a black diffuse term is the metal."""
    metal = mitsuba_dict(Sum(Lambert(albedo=0.0), METAL, GGX(specular=0.0)))
    assert metal == mitsuba_dict(METAL)
    assert metal["type"] == "roughconductor" and metal["alpha"] == 0.25
    assert metal["specular_reflectance"] == {"type": "rgb", "value": [0.9, 0.6, 0.3]}
    black = {"type": "rgb", "value": [0.0, 0.0, 0.0]}
    assert mitsuba_dict(Sum(Lambert(albedo=0.0), GGX(specular=0.0))) == {"type": "diffuse", "reflectance": black}


def test_a_blend_within_one_has_plain_colours() -> None:
    blend = mitsuba_dict(Sum(Lambert(albedo=0.25), RoughConductor(specular=0.5)))
    assert blend["weight"] == pytest.approx(2 / 3)
    assert [
        blend[name][key]["value"] for name, key in (("bsdf_0", "reflectance"), ("bsdf_1", "specular_reflectance"))
    ] == [
        pytest.approx([0.75] * 3),
        pytest.approx([0.75] * 3),
    ]


@MITSUBA
def test_a_blend_of_very_bright_and_very_dark_is_exact(tmp_path: Path) -> None:
    lobes = [RoughConductor(specular=value, roughness=0.3) for value in (1.0, 1e-9, 0.5)]
    model = Sum(Lambert(albedo=1e-12), *lobes).double()
    wi, wo = (hemisphere(200, seed=seed, dtype=torch.float32).double() for seed in (3, 4))
    found = values(loaded(export(model, "mitsuba", tmp_path)), wi, wo)
    torch.testing.assert_close(found, model(Pairs.from_directions(wi, wo)).detach(), rtol=1e-4, atol=1e-7)


def merl_table(name: str, folder: Path) -> Measured:
    """A stand-in for a measured material as a MERL table."""
    stand_in = load(standins(), dtype=torch.float64)
    values = stand_in.batch([stand_in.names.index(name)]).at(
        Pairs.from_half_diff(*(torch.from_numpy(centre.reshape(1, -1)) for centre in merl_centres()))
    )
    write_merl(folder / f"{name}.binary", values.reshape(*BINS, 3))
    return load(folder / f"{name}.binary")


@MITSUBA
@pytest.mark.slow
@pytest.mark.parametrize("name", ["nickel", "nylon", "alum-bronze", "light-red-paint", "blue-acrylic"])
def test_measured_ones_have_the_same_picture(name: str, tmp_path: Path) -> None:
    measured = merl_table(name, tmp_path)
    done = export(measured, "mitsuba", tmp_path / "out")
    assert not done.exact and [path.name for path in done.files] == [f"{name}.xml", f"{name}.bsdf"]
    ours = render(measured, scene_of("sphere"))[0]
    theirs = [studio("sphere").picture(loaded(done), SAMPLES, seed) for seed in (0, 1)]
    found = likeness(ours, theirs, studio("sphere").where)
    assert found.psnr > 40, found
    assert found.ratio == pytest.approx(1, abs=0.01), found


@MITSUBA
def test_a_table_lies_beside_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From wherever the file is loaded, whatever else of that name is there."""
    model = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=0.4, roughness=0.3))
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "paint.bsdf").write_text("something else")
    done = export(model, "mitsuba", tmp_path / "there", name="paint")
    assert not done.exact and done.shown is not None
    monkeypatch.chdir(tmp_path / "here")
    wi, wo = (hemisphere(200, seed=seed, dtype=torch.float32).double() for seed in (3, 4))
    found, expected = values(loaded(done), wo, wi), model(Pairs.from_directions(wi, wo)).detach()
    assert ((found - expected).abs() / expected).median() < 0.01
    (tmp_path / "there").rename(tmp_path / "moved")
    assert str(mitsuba().load_file(str(tmp_path / "moved" / "paint.xml"))).startswith("Measured")


@MITSUBA
@pytest.mark.parametrize("name", ["$5 & <more>", "€", "a b"])
def test_any_name_is_loaded(name: str, tmp_path: Path) -> None:
    assert loaded(export(GGX(roughness=0.5), "mitsuba", tmp_path, name=name)).id() == name.replace("$", "_")
    assert loaded(export(CHALK, "mitsuba", tmp_path / "chalk", name=name)).id() == name.replace("$", "_")


def test_a_file_of_rgl_is_copied(tmp_path: Path) -> None:
    """It is exact, and never written over itself."""
    own = export(GGX(roughness=0.5), "rgl", tmp_path / "rgl", name="mine").files[0]
    done = export(own, "mitsuba", tmp_path)
    assert done.exact and done.files[1].read_bytes() == own.read_bytes()
    with pytest.raises(DataError, match=r"mine.bsdf: expected another folder or name, found the file that is exported"):
        export(own, "mitsuba", own.parent)
    assert not (own.parent / "mine.xml").exists()


def test_a_measurement_that_mitsuba_shows_the_other_way_round_is_not_exact(tmp_path: Path) -> None:
    path = tmp_path / "noisy.bsdf"
    path.write_bytes(tensor_file(synthetic_bsdf()))
    done = export(path, "mitsuba", tmp_path / "out")
    assert done.files[1].read_bytes() == path.read_bytes() and not done.exact
    assert any(
        re.match(r"Mitsuba exchanges light and viewer: values there differ by \d+ %", note) for note in done.notes
    )


def test_a_dict_has_the_path_of_its_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert mitsuba_dict(GGX(roughness=0.5)) == {"type": "measured", "filename": str(tmp_path / "material.bsdf")}
    found = mitsuba_dict(GGX(roughness=0.5), "there")
    assert Path(found["filename"]) == tmp_path / "there" / "material.bsdf" and Path(found["filename"]).exists()
