"""`torchbrdf texels`: a folder of pictures and a table of lights."""

import re

import numpy as np
import pytest
import torch

from torchbrdf.cli import main
from torchbrdf.images import write_exr
from torchbrdf.texels import fit_texels, open_texels


@pytest.fixture
def table(scene, tmp_path):
    lines = ["file,x,y,z,irradiance"]
    for k, (light, picture) in enumerate(zip(scene.lights.tolist(), scene.stack, strict=True)):
        write_exr(tmp_path / f"{k}.exr", torch.from_numpy(2 * picture))
        lines.append(f"{k}.exr,{','.join(map(repr, light))},2")
    write_exr(tmp_path / "normals.exr", torch.from_numpy(scene.surface.normals))
    (tmp_path / "lights.csv").write_text("\n".join(lines))
    return tmp_path / "lights.csv"


def run(table, *arguments):
    return main(["texels", str(table), "--tile", "16", "--out", str(table.parent / "out"), *arguments])


def test_the_command_writes_the_maps_of_the_library(scene, table, capsys):
    normals = str(table.parent / "normals.exr")
    assert run(table, "--normals", normals, "--hold", "f0=0.5", "--formats", "exr") == 0
    assert "texels converged" in capsys.readouterr().out
    found = open_texels(table.parent / "out")
    wanted = fit_texels(
        2 * scene.stack, scene.lights, normals=scene.surface.normals, irradiance=2.0, tile=16, held=("f0",),
        model=found.model,
    )  # fmt: skip
    assert (found["f0"] == 0.5).all()
    assert np.median(np.abs(found["error"] / wanted["error"] - 1)) < 1e-4
    assert sorted(one.name for one in (table.parent / "out").iterdir()) == sorted(
        ["texels.json", "tiles", *(f"{name}.exr" for name in found.names if name != "status")]
    )


def test_a_picture_that_is_damaged_is_left_out(table, capsys, caplog):
    (table.parent / "3.exr").write_bytes(b"v/1\x01nothing")
    write_exr(table.parent / "4.exr", torch.ones(3, 5, 3))
    assert run(table) == 1
    assert "3.exr: expected" in caplog.text and "4.exr: expected 16 x 16 pixels" in caplog.text
    assert open_texels(table.parent / "out").counts()["CONVERGED"] > 200


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected columns file, x, y, z, found"),
        ("file,x,y\n0.exr,1,2", "expected columns file, x, y, z, found"),
        ("file,x,y,z\n", "expected a light a line, found none"),
        ("file,x,y,z\n0.exr,1,2", "line 2: z: expected a finite number, found None"),
        ("file,x,y,z\n0.exr,1,2,nan", "line 2: z: expected a finite number, found 'nan'"),
        ("file,x,y,z\n,1,2,3", "line 2: expected the name of a picture, found ''"),
        ("file,x,y,z,irradiance\n0.exr,1,2,3,0", r"line 2: expected an irradiance from 1e-12 to 1e\+12, found 0 0 0"),
        ("file,x,y,z,r,g,b\n0.exr,1,2,3,1,1,1e-50", "line 2: expected an irradiance from .*, found 1 1 1e-50"),
        ("file,x,y,z\n0.exr,0,0,0", "line 2: expected the direction to a light, found 0 0 0"),
        ("file,x,y,z\n0.exr,1e300,0,1e300", r"expected the direction to a light, found 1e\+300 0 1e\+300"),
        ("file,x,y,z\nnone.exr,1,2,3", "none.exr: expected an OpenEXR .* no picture of 1 could be read"),
    ],
)
def test_tables_that_are_none_are_said_in_a_line(table, capsys, text, said):
    table.write_text(text)
    assert run(table) == 1
    error = capsys.readouterr().err
    assert re.search(said, error) and "Traceback" not in error


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--hold", "depth"), "--hold: expected one of albedo, specular, roughness, f0, found 'depth'"),
        (("--hold", "f0=7"), "--hold: f0: expected a number from 0.02 to 1, found '7'"),
        (("--view", "up"), "--view: expected X,Y,Z, found 'up'"),
        (("--model", "gggx"), "unknown lobe"),
        (("--formats", "tif"), "formats: expected some of exr, png, zarr, found 'tif'"),
        (("--loss", "learned"), "loss: expected a mean over pairs"),
    ],
)
def test_options_that_cannot_be_are_refused(table, capsys, arguments, said):
    assert run(table, *arguments) == 2
    assert said in capsys.readouterr().err
