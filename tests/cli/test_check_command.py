"""`torchbrdf check`."""

import json
import struct

from torchbrdf.cli import main
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, parameters, write_fits
from torchbrdf.report.style import DPI


def test_it_says_what_is_odd_and_draws_it(paint, tmp_path, capsys):
    bright, out = tmp_path / "bright.json", tmp_path / "out"
    model = Sum(Lambert(albedo=0.9), Ward(specular=0.9, roughness=0.1))
    write_fits(bright, [FitRecord("bright", "ward", 1, parameters(model))])
    assert main(["check", str(paint), str(bright), "--out", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("material") and lines[1].startswith("paint")
    # Cook and Torrance's lobe gives out more than it takes in near the horizon.
    assert "! reflects 104 % of the light from 80 degrees" in lines[2]
    assert (
        lines[3].startswith("bright")
        and "! reflects 1" in lines[4]
        and lines[-2:] == [str(out / "albedo.png"), str(out / "check.json")]
    )
    first, second = json.loads((out / "check.json").read_text())
    assert len(first["warnings"]) == 1 and second["largest_albedo"] > 1.5
    assert (out / "albedo.png").read_bytes().startswith(b"\x89PNG")


def test_it_says_which_of_several_models_of_a_material(tmp_path, capsys):
    assert main(["check", "zoo:nickel", "zoo:nickel:gltf", "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    labels = ["nickel: GGX, 2 lobes (model)", "nickel: glTF (model)"]
    assert [one for one in labels if any(line.startswith(one) for line in lines)] == labels
    assert [one["label"] for one in json.loads((tmp_path / "check.json").read_text())] == labels


def test_many_materials_leave_the_figure_room(tmp_path):
    model = parameters(Sum(Lambert(albedo=0.5), Ward(specular=0.1, roughness=0.1)))
    names = [f"a material with a rather long name, number {k}" for k in range(20)]
    write_fits(tmp_path / "fits.json", [FitRecord(name, "ward", 1, model) for name in names])
    assert main(["check", str(tmp_path / "fits.json"), "--out", str(tmp_path)]) == 0  # no warning of matplotlib's
    (width,) = struct.unpack(">I", (tmp_path / "albedo.png").read_bytes()[16:20])
    assert width > 2 * 7 * DPI


def test_bad_files_do_not_spoil_the_others(paint, tmp_path, capsys):
    bad = tmp_path / "broken.json"
    bad.write_text("[{")
    assert main(["check", str(paint), str(bad)]) == 1
    printed = capsys.readouterr()
    assert "paint" in printed.out and "broken.json" in printed.err
    (tmp_path / "file").write_text("")
    assert main(["check", str(paint), "--out", str(tmp_path / "file")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
