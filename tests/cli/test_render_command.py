"""`torchbrdf render`: pictures that can be compared, each in a file of its own."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from helpers.measured_files import synthetic_bsdf, tensor_file
from PIL import Image

from torchbrdf.cli import main
from torchbrdf.images import DIFFERENCES, ToneMap, read_image
from torchbrdf.lobes import CookTorrance, FitRecord, Lambert, Sum, Ward, parameters, write_fits
from torchbrdf.render import Scene, find_mesh

PAINT = parameters(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), CookTorrance(specular=0.5, roughness=0.2, f0=0.2)))
DULL = parameters(Sum(Lambert(albedo=[0.6, 0.2, 0.1]), Ward(specular=0.1, roughness=0.4)))
SMALL = ["--size", "32", "--shape", "sphere"]


def fit(material, loss, values=DULL):
    model = "ward" if values is DULL else "cook_torrance"
    return FitRecord(material, model, 1, values, loss=loss, strategy="global")


def display(path):
    return torch.tensor(list(Image.open(path).convert("RGB").tobytes())).reshape(32, 32, 3)


def test_a_measurement_and_its_fits_share_a_tone_map_and_no_file(merl_file, tmp_path, capsys):
    """The fit has the name of the measurement, and another format's group of its own."""
    fits, out = tmp_path / "fits.json", tmp_path / "out"
    write_fits(fits, [fit("made-up", "rms"), fit("made-up", "cube_root"), fit("made-up", "rms")])
    assert main(["render", str(merl_file), str(fits), *SMALL, "--out", str(out)]) == 0
    printed = dict(line.split("  ", 1) for line in capsys.readouterr().out.splitlines())
    assert printed == {
        str(out / "made-up.png"): "made-up (measured)",
        str(out / "made-up-ward-1-lobe-rms-global.png"): "made-up: Ward, 1 lobe, RMS, global",
        str(out / "made-up-ward-1-lobe-cube_root-global.png"): "made-up: Ward, 1 lobe, cube root, global",
        str(out / "made-up-ward-1-lobe-rms-global-2.png"): "made-up: Ward, 1 lobe, RMS, global #2",
        str(out / "sheet.png"): "all of them, and where fits differ from their materials",
    }
    stems = [path.removesuffix(".png") for path in printed if "sheet" not in path]
    linear = torch.stack([read_image(f"{stem}.exr") for stem in stems])
    scene = Scene(find_mesh("sphere"), size=32)
    tone = ToneMap.from_images(linear, scene.mask.expand(4, 32, 32))
    assert json.loads((out / "tonemap.json").read_text()) == pytest.approx(tone.to_dict(), rel=1e-5)
    inside = scene.coverage == 1
    for stem, picture in zip(stems, linear, strict=True):
        torch.testing.assert_close(
            display(f"{stem}.png")[inside].float(), (tone(picture) * 255)[inside], atol=0.6, rtol=0
        )
    assert not torch.equal(linear[0], linear[1])  # the fit did not take the measurement's place


def test_the_sheet_says_how_far_fits_are(paint, tmp_path, monkeypatch):
    """The same numbers as the image difference of the pictures."""
    said = []
    monkeypatch.setattr("torchbrdf.report.sheet.write_sheet", lambda *arguments: said.append(arguments))
    fits, out = tmp_path / "fits.json", tmp_path / "out"
    write_fits(fits, [fit("paint", "rms"), fit("paint", "log", PAINT)])
    assert main(["render", str(paint), str(fits), *SMALL, "--out", str(out)]) == 0
    ((_, items, shown, maps, delta_e, _),) = said
    assert [item.reference for item in items] == [None, 0, 0]
    mask = Scene(find_mesh("sphere"), size=32).mask
    assert (
        delta_e[1] == pytest.approx(DIFFERENCES["delta_e76"]()(shown[1:2], shown[:1], mask).item()) and delta_e[1] > 3
    )
    assert maps[1][mask].mean().item() == pytest.approx(delta_e[1], rel=1e-5)
    assert delta_e[2] == 0 and (maps[2] == 0).all()


def test_two_files_of_one_stem_keep_both_pictures(tmp_path, capsys):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_fits(tmp_path / name / "fits.json", [FitRecord("paint?", "ward", 1, DULL)])
    files = [str(tmp_path / name / "fits.json") for name in ("one", "two")]
    out = tmp_path / "out"
    assert main(["render", *files, *SMALL, "--out", str(out)]) == 0
    names = sorted(re.sub("-[0-9a-f]{8}", "", path.name) for path in out.iterdir())
    assert names == ["paint_-2.exr", "paint_-2.png", "paint_.exr", "paint_.png", "sheet.png", "tonemap.json"]


@pytest.mark.parametrize(
    "name", ["../../escaped", "/tmp/escaped", "a\\b", "..", "", "a\nb", "\x1b]0;x\x07red", "a\0b", " a"]
)
def test_a_name_that_is_none_writes_nothing(name, tmp_path, capsys):
    folder = tmp_path / "deep" / "down"
    folder.mkdir(parents=True)
    write_fits(folder / "fits.json", [FitRecord(name, "ward", 1, DULL)])
    assert main(["render", str(folder / "fits.json"), *SMALL, "--out", str(folder / "out")]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "fit 0: material: expected a name" in said and len(said) <= 320
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["deep", "down", "fits.json"]


@pytest.mark.parametrize("name", ["gold $\\x{$ paint", "$a$", "-x", "=1+1", "_", "100 %", "中文", "x" * 190])
@pytest.mark.filterwarnings("error")
def test_odd_names_are_drawn_as_they_are(name, tmp_path, capsys):
    name = name.replace("\\", "")
    write_fits(tmp_path / "fits.json", [FitRecord(name, "ward", 1, DULL), fit(name, "rms", DULL)])
    assert main(["render", str(tmp_path / "fits.json"), *SMALL, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert name in printed[0] and f"{name}: Ward" in printed[1].replace("... ", "")
    assert all((tmp_path / line.split("  ")[0]).exists() for line in printed)


def test_files_of_odd_names_are_read(merl_file, tmp_path):
    """In a process of its own, whose terminal knows ASCII only."""
    stems = [b"\xff", b"a\nb", b"a$\\x{$", b"\x1b[31m", b"-dash", b'"', b"x" * 248, b" "]
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    small = tensor_file(synthetic_bsdf())
    for stem in stems:
        Path(os.fsdecode(os.fsencode(folder) + b"/" + stem + b".bsdf")).write_bytes(small)
    os.link(merl_file, os.fsencode(folder) + b"/\xfe\x1b.binary")
    environment = {**os.environ, "LC_ALL": "C", "PYTHONIOENCODING": "ascii", "OMP_NUM_THREADS": "1"}
    draw = ["render", folder, "--size", "8", "--shape", "sphere", "--backend", "software", "--out", out]
    for command in (["info", folder], draw):
        program = [sys.executable, "-m", "torchbrdf", *command]
        done = subprocess.run(program, capture_output=True, env=environment, timeout=200, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.isascii() and b"\x1b" not in done.stdout and b"Traceback" not in done.stderr
    assert len([*out.iterdir()]) == 2 * (len(stems) + 1) + 2  # with sheet.png and tonemap.json


@pytest.mark.parametrize(
    ("option", "value"),
    [("--size", "30000"), ("--size", "0"), ("--size", "nan"), ("--rotate", "nan"), ("--rotate", "1e300"),
     ("--elevation", "90"), ("--elevation", "inf")],
)  # fmt: skip
def test_options_have_bounds(option, value, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["render", "x", option, value])
    said = capsys.readouterr().err
    assert caught.value.code == 2 and said.count("\n") == 1 and option in said and "expected a" in said


def test_more_pictures_than_memory_holds_are_refused(monkeypatch, paint, tmp_path, capsys):
    monkeypatch.setattr("torchbrdf.report.limits.MOST_PIXELS", 32 * 32 - 1)
    assert main(["render", str(paint), *SMALL, "--out", str(tmp_path / "out")]) == 2
    assert "expected at most 1023 pixels in all, found 1 pictures of 32 x 32" in capsys.readouterr().err


def test_nothing_to_draw_writes_nothing(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["render", "nowhere.binary", *SMALL, "--out", str(out)]) == 1
    assert capsys.readouterr().err.count("\n") == 1 and not out.exists()


def test_real_files_of_another_format(data, tmp_path, capsys):
    files = sorted((data / "rgl").glob("*_rgb.bsdf"))[:1]
    if not files:
        pytest.skip(f"needs measured data: no .bsdf in {data / 'rgl'}")
    assert main(["render", *map(str, files), *SMALL, "--out", str(tmp_path)]) == 0
    assert re.search(r"\(measured\)", capsys.readouterr().out) and (tmp_path / "sheet.png").stat().st_size > 1000


def test_lamps_and_shadows(paint, tmp_path, capsys):
    arguments = ["render", str(paint), "--size", "40", "--environment", "none", "--elevation", "20"]
    assert main(arguments) == 2
    assert "an environment or a lamp" in capsys.readouterr().err
    assert main([*arguments, "--lamp", "directional:1,2", "--out", str(tmp_path)]) == 2
    assert "light directional:1,2" in capsys.readouterr().err
    pytest.importorskip("embreex")
    for name, more in (("plain", []), ("shadows", ["--shadows"])):
        out = tmp_path / name
        assert main([*arguments, "--lamp", "directional:1,0.2,-0.3:3", *more, "--out", str(out)]) == 0
    plain, shadows = (read_image(tmp_path / name / "paint.exr") for name in ("plain", "shadows"))
    assert (shadows <= plain).all() and shadows.sum() < plain.sum()
