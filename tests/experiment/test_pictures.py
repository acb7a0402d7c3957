"""Grids of fits and their pictures, on records that nobody had to fit."""

import json

import pytest
import torch

from torchbrdf.errors import DataError, UsageError
from torchbrdf.experiment import ONLY, FitGrid, Pictures
from torchbrdf.experiment.grid import picture_name
from torchbrdf.experiment.labels import difference_label
from torchbrdf.experiment.pictures import color_difference
from torchbrdf.images import DIFFERENCES, ToneMap, read_image
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, parameters, read_fits, write_fits
from torchbrdf.losses import LOSSES
from torchbrdf.measured import load_all
from torchbrdf.recipe import RunFolder, configure
from torchbrdf.recipes.image_vs_analytic import ImageVsAnalytic
from torchbrdf.render import Camera, Environment, Scene, sphere

SIZE = 16


def ward(albedo, roughness):
    return parameters(Sum(Lambert(albedo=albedo), Ward(specular=0.3, roughness=roughness)))


@pytest.fixture
def grid(tmp_path):
    """Two materials; fits of each under two losses by two strategies, those under rms being the material itself."""
    true = {"paint": ward([0.3, 0.2, 0.1], 0.2), "chalk": ward([0.7, 0.7, 0.6], 0.4)}
    write_fits(tmp_path / "materials.json", [FitRecord(name, "ward", 1, values) for name, values in true.items()])
    scored = {"errors": {"rms": 0.1, "log": 0.1}, "outlier": False}
    records = [
        FitRecord(name, "ward", 1, values if loss == "rms" else ward([0.4, 0.4, 0.4], 0.1), loss, strategy, **scored)
        for name, values in true.items()
        for loss in ("rms", "log")
        for strategy in ("global", "staged")
    ]
    out = tmp_path / "out"
    out.mkdir()
    write_fits(out / "fits.json", records)
    losses = {name: LOSSES[name]() for name in ("rms", "log")}
    groups = load_all([tmp_path / "materials.json"])
    made = FitGrid(RunFolder(out), groups, ["ward"], losses, lobes=(1,), compare_strategy="staged")
    made.fit()
    return made


def scene(turn=0.0):
    return Scene(sphere(), Camera(turn), Environment.default(), size=SIZE, light_samples=64)


def draw(grid, scenes, differences=("delta_e76", "log_hdr"), *, fits=True, **options):
    pictures = Pictures(grid, scenes, differences, **options)
    pictures.draw(fits=False)
    pictures.draw(materials=False)
    pictures.measure_tones(fits=fits)
    pictures.compare()
    return pictures


def test_what_is_fitted_is_not_fitted_again(grid):
    assert len(grid.records) == 8 and all(record.iterations == 0 for record in grid.records)
    assert [grid.picture(record) for record in grid.drawn[:2]] == ["paint-ward-rms", "paint-ward-log"]
    assert grid.picture(grid.record("chalk", "ward", "log", strategy="staged")) == "chalk-ward-log-staged"
    with pytest.raises(DataError, match="expected a fit paint, ward, rms, 2, global, found none"):
        grid.record("paint", "ward", "rms", 2)


def test_a_grid_that_cannot_be_is_refused(grid):
    folder, groups = grid.folder, grid.groups
    with pytest.raises(UsageError, match="compare_strategy: expected another strategy than global"):
        FitGrid(folder, groups, ["ward"], {}, compare_strategy="global")
    with pytest.raises(UsageError, match="materials: 'chalk' comes twice"):
        FitGrid(folder, groups * 2, ["ward"], {})
    with pytest.raises(UsageError, match="unknown lobe 'wart'"):
        FitGrid(folder, groups, ["wart"], {})


def test_one_scene_gives_differences_and_a_tone_map_of_all_pictures(grid):
    seen = scene()
    pictures = draw(grid, {ONLY: seen})
    renders = grid.folder.path / "renders"
    assert sorted(path.name for path in renders.glob("*.png")) == sorted(
        f"{material}-{name}.png"
        for material in ("paint", "chalk")
        for name in ("reference", "ward-rms", "ward-log", "ward-rms-staged", "ward-log-staged")
    )
    linear = torch.stack([read_image(path) for path in sorted(renders.glob("*.exr"))])
    tone = ToneMap.from_images(linear, seen.mask.expand(len(linear), SIZE, SIZE))
    assert json.loads((grid.folder.path / "tonemap.json").read_text()) == pytest.approx(tone.to_dict())
    for record in read_fits(grid.folder.path / "fits.json"):
        pair = torch.stack(
            [read_image(renders / f"{name}.exr") for name in (grid.picture(record), picture_name(record.material))]
        )
        shown = tone(pair)
        expected = {
            "delta_e76": DIFFERENCES["delta_e76"]()(shown[:1], shown[1:], seen.mask).item(),
            "log_hdr": DIFFERENCES["log_hdr"]()(pair[:1], pair[1:], seen.mask).item(),
        }
        assert record.differences == pytest.approx(expected, rel=1e-4, abs=1e-6) and not record.pictures
        assert (record.differences["delta_e76"] < 1e-6) == (record.loss == "rms")
    assert pictures.records_in(ONLY) == grid.shown


def test_two_scenes_have_folders_tone_maps_and_differences_of_their_own(grid):
    pictures = draw(grid, {"here": scene(), "there": scene(90.0)}, fits=False, maps=True)
    renders = grid.folder.path / "renders"
    tones = json.loads((grid.folder.path / "tonemap.json").read_text())
    assert set(tones) == {"here", "there"} and tones["here"] != tones["there"]
    for name in tones:
        references = torch.stack([read_image(pictures.path(f"{m}-reference", name, ".exr")) for m in grid.materials])
        mask = pictures.scenes[name].mask.expand(2, SIZE, SIZE)
        assert tones[name] == pytest.approx(ToneMap.from_images(references, mask).to_dict())  # and of no fit
        assert (renders / name / "map-paint-ward-log.png").stat().st_size > 0
    record = grid.record("paint", "ward", "log")
    assert set(record.pictures) == {"here", "there"} and not record.differences
    seen = next(one for one in pictures.records_in("there") if (one.material, one.loss) == ("paint", "log"))
    assert seen.differences == record.pictures["there"] != record.pictures["here"]


def test_what_is_drawn_is_not_drawn_again(grid):
    draw(grid, {ONLY: scene()})
    renders = grid.folder.path / "renders"
    before = {path: path.stat().st_mtime_ns for path in renders.glob("*.exr")}
    (renders / "paint-reference.exr").unlink()
    draw(grid, {ONLY: scene()})
    after = {path: path.stat().st_mtime_ns for path in renders.glob("*.exr")}
    assert {path.name for path in before if after[path] != before[path]} == {
        "paint-reference.exr",
        "chalk-reference.exr",
    }


def test_a_colour_difference_is_a_length_in_cielab():
    black, white = torch.zeros(2, 2, 3), torch.ones(2, 2, 3)
    torch.testing.assert_close(color_difference(black, white), torch.full((2, 2), 100.0), atol=0.1, rtol=0)
    assert (color_difference(white, white) == 0).all()


def test_differences_are_known_by_the_names_that_they_had(grid):
    assert Pictures(grid, {}, ("delta_e", "flip", "delta_e76")).differences == ["delta_e76", "flip"]
    assert ImageVsAnalytic(differences=("delta_e",)).differences == ("delta_e",)
    with pytest.raises(UsageError, match="expected delta_e76 among them"):
        ImageVsAnalytic(differences=("flip",))
    assert difference_label("delta_e") == difference_label("delta_e76")


def test_combined_losses_and_the_choice_by_pictures_can_be_left_out_losses_cannot():
    recipe = configure(ImageVsAnalytic, {"combined": "", "chosen_by": ""})
    assert recipe.combined == recipe.chosen_by == ()
    with pytest.raises(UsageError, match="rendered: expected at least one name, found none"):
        configure(ImageVsAnalytic, {"rendered": ""})
    with pytest.raises(UsageError, match="combined: expected each name once, found 'learned' twice"):
        configure(ImageVsAnalytic, {"combined": "learned,learned"})


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("material", "wood", "expected one of the materials of this run, found 'wood'"),
        ("model", "cook_torrance", "fit 1: "),
        ("loss", "cube_root", "expected one of the losses of this run, found 'cube_root'"),
        ("errors", {"rms": 0.1}, "expected its errors under rms, log, and outlier"),
        ("outlier", None, "expected its errors under rms, log, and outlier"),
    ],
)
def test_fits_of_something_else_are_refused(grid, key, value, said):
    path = grid.folder.path / "fits.json"
    values = json.loads(path.read_text())
    values[1][key] = value
    path.write_text(json.dumps(values))
    with pytest.raises(DataError, match=f"fits.json: fit 1: .*{said.removeprefix('fit 1: ')}"):
        grid.fit()
