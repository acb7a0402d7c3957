"""The command line: what it prints, its exit status, and what bad input gets."""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys

import pytest

from torchbrdf.cli import main
from torchbrdf.cli.commands import build_parser
from torchbrdf.cli.common import number
from torchbrdf.lobes import FitRecord, read_fits, write_fits


def test_fit_prints_and_writes(paint, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["fit", str(paint), "--model", "ward", "--lobes", "1", "--samples", "500", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert "paint" in printed.out and "roughness" in printed.out
    assert re.search(r"told apart by .*\npaint +\S+ +<?\d+ % \(<?\d+ to >?\d+\)", printed.out)
    assert "the others guess" in printed.out
    assert printed.err == ""  # no progress bar where there is no terminal
    (record,) = json.loads((out / "fits.json").read_text())
    assert record["material"] == "paint" and record["model"] == "ward" and record["loss"] == "learned"
    assert (out / "fits.csv").read_text().count("\n") == 2


def test_fit_is_taken_up_where_it_stopped(paint, tmp_path, capsys):
    arguments = ["fit", str(paint), "--lobes", "1", "--samples", "300", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    before = (tmp_path / "out" / "fits.json").stat().st_mtime_ns
    assert main(arguments) == 0
    assert (tmp_path / "out" / "fits.json").stat().st_mtime_ns == before
    assert main([*arguments, "--loss", "rms"]) == 1
    assert "give another folder" in capsys.readouterr().err


def test_one_bad_file_is_reported_and_the_others_are_done(paint, tmp_path, capsys):
    bad = tmp_path / "broken.binary"
    bad.write_bytes(b"\x5a\x00\x00\x00\x5a\x00\x00\x00\xb4\x00\x00\x00" + bytes(100))
    assert main(["fit", str(paint), str(bad), "--samples", "300", "--lobes", "1"]) == 1
    printed = capsys.readouterr()
    assert "paint" in printed.out
    assert "broken.binary" in printed.err and "truncated" in printed.err and printed.err.count("\n") == 1


def test_pictures_are_a_loss(paint, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "cache"))
    out = tmp_path / "out"
    arguments = [
        "fit",
        str(paint),
        "--model",
        "cook_torrance",
        "--lobes",
        "1",
        "--diffuse",
        "fit",
        "--loss",
        "rendered",
    ]
    arguments += ["--difference", "delta_e76", "--size", "24", "--lights", "64", "--out", str(out)]
    assert main(arguments) == 0
    (record,) = json.loads((out / "fits.json").read_text())
    assert record["loss"] == "rendered_delta_e76" and record["error"] < 0.05
    assert record["parameters"]["roughness"] == pytest.approx([0.2], rel=1e-2)
    assert record["scene"].startswith("24 x 24 pixels") and "64 lights" in record["scene"]
    assert len(list((tmp_path / "cache").iterdir())) == 1
    assert main(arguments) == 0  # taken up
    capsys.readouterr()
    assert main([*arguments, "--size", "25"]) == 1
    assert "give another folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "loss", "said"),
    [
        (["--loss", "combined"], "learned+rendered_delta_e76", ""),
        (["--loss", "rendered", "--strategy", "image_driven"], "rendered_delta_e76", "(under "),
    ],
)
def test_fit_sees_pictures_in_other_ways(paint, options, loss, said, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "cache"))
    arguments = ["fit", str(paint), "--model", "ward", "--lobes", "1", "--samples", "500", "--max-theta", "30"]
    arguments += ["--size", "12", "--lights", "16", "--out", str(tmp_path / "out"), *options]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "pictures of 12 x 12 pixels" in printed and said in printed
    (record,) = json.loads((tmp_path / "out" / "fits.json").read_text())
    assert record["loss"] == loss and record["scene"].startswith("12 x 12 pixels")
    assert ("chosen" in record) == bool(said)
    assert main(arguments) == 0  # taken up
    assert json.loads((tmp_path / "out" / "fits.json").read_text()) == [record]


def test_info_says_what_a_file_holds(paint, capsys):
    assert main(["info", str(paint)]) == 0
    assert "distinctness of image" in capsys.readouterr().out


def test_run_lists_recipes_and_settings(capsys):
    assert main(["run", "list"]) == 0
    assert main(["run", "fores2012", "help="]) == 0
    printed = capsys.readouterr().out
    assert "fores2012" in printed and "environment=grove" in printed


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["fit", "nowhere.binary"], 1, "nowhere.binary"),
        (["fit", "PAINT", "--model", "wardd"], 2, "unknown lobe 'wardd'.*did you mean 'ward'"),
        (["fit", "PAINT", "--loss", "cube"], 2, "unknown loss 'cube'"),
        (["fit", "PAINT", "--strategy", "luck"], 2, "unknown strategy 'luck'"),
        (["fit", "PAINT", "--diffuse", "90:0"], 2, "unknown --diffuse '90:0'; expected one of 45:0, fit"),
        (
            ["fit", "PAINT", "--difference", "flip"],
            2,
            "--difference: expected only with --loss rendered or combined, found --loss le",
        ),
        (["fit", "PAINT", "--size", "64", "--loss", "rms"], 2, "--size: expected only with --loss rendered"),
        (["fit", "PAINT", "--loss", "rendered", "--difference", "nope"], 2, "unknown difference 'nope'"),
        (["fit", "BAD", "--loss", "rendered"], 1, "bad.json: fit 0: material: expected a name .*, found '../../x'"),
        (["fit", "PAINT", "--out", "BADOUT"], 1, "fits.json: fit 0: material: expected a name"),
        (["render", "BAD"], 1, "bad.json: fit 0: material: expected a name"),
        (["info", "BAD"], 1, "bad.json: fit 0: material: expected a name"),
        (["run", "fores2012", "materials=BAD", "--out", "OUT"], 1, "bad.json: fit 0: material: expected a name"),
        (["run", "fores2012", "quick=true", "quick=false"], 2, "'quick': expected once, found twice"),
        (["run", "fores2012", "seed=" + "1" * 23], 2, "seed: expected a whole number from 0 to 9223372036854775807"),
        (["run", "fores2012", "models=ward,ward"], 2, "models: expected each name once, found 'ward' twice"),
        (["run", "fores2012", "diffuse=90:0"], 2, "unknown diffuse of fores2012 '90:0'"),
        (["run", "fores2021"], 2, "unknown recipe 'fores2021'.*did you mean 'fores2012'"),
        (["run", "fores2012", "quik=true"], 2, "unknown setting of fores2012 'quik'"),
        (["run", "fores2012", "quick"], 2, "expected key=value, found 'quick'"),
        (["run", "fores2012", "max_theta=120"], 2, "max_theta: expected a number from 1 to 90, found '120'"),
        (["run", "image_vs_analytic", "rendered="], 2, "rendered: expected at least one name, found none"),
        (["run", "fores2012", "size=huge"], 2, "size: expected a whole number from 16 to 4096, found 'huge'"),
        (["run", "fores2012", "models=phong", "--out", "OUT"], 2, "unknown lobe 'phong'"),
        (["run", "fores2012", "materials=nowhere", "--out", "OUT"], 1, "nowhere"),
        (["run", "fores2012", "environment=PAINT", "--out", "OUT"], 1, "expected an OpenEXR or a Radiance picture"),
        (["run", "fores2012", "shape=PAINT", "--out", "OUT"], 1, "mesh"),
        (["render", "PAINT", "--environment", "nowhere.hdr"], 1, "nowhere.hdr"),
        (["info", "nowhere.binary"], 1, "nowhere.binary"),
        (["fit", "PAINT", "--out", "PAINT/out"], 1, "cannot be written"),
        (["render", "PAINT", "--out", "PAINT/out"], 1, "cannot be written"),
        (["run", "fores2012", "--out", "PAINT/out"], 1, "cannot be written"),
    ],
)
def test_bad_input_gets_one_line(paint, tmp_path, capsys, arguments, status, said):
    values = [{**json.loads(paint.read_text())[0], "material": "../../x"}]
    (tmp_path / "bad").mkdir()
    for path in (tmp_path / "bad.json", tmp_path / "bad" / "fits.json"):
        path.write_text(json.dumps(values))
    places = {"PAINT": paint, "BADOUT": tmp_path / "bad", "BAD": tmp_path / "bad.json", "OUT": tmp_path / "out"}
    filled = [re.sub("PAINT|BADOUT|BAD|OUT", lambda found: str(places[found[0]]), a) for a in arguments]
    assert main(filled) == status
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and printed.err.startswith("torchbrdf: ")
    assert re.search(said, printed.err)


@pytest.mark.parametrize(
    ("arguments", "fifo"),
    [
        (["view", "FILE", "--out", "OUT"], "out"),
        (["view", "FILE", "--out", "OUT/view.html"], "out/view.html"),
        (["fit", "FILE", "--out", "OUT"], "out"),
        (["fit", "FILE", "--out", "OUT"], "out/fits.json"),
        (["fit", "FILE", "--out", "OUT"], "out/fits.csv"),
        (["render", "FILE", "--out", "OUT"], "out"),
        (["render", "FILE", "--out", "OUT"], "out/sheet.png"),
        (["render", "FILE", "--out", "OUT"], "out/tonemap.json"),
        (["run", "fores2012", "--out", "OUT"], "out"),
    ],
)
def test_what_is_no_file_is_not_written_over_and_that_is_said_before_there_is_work(tmp_path, capsys, arguments, fifo):
    path = tmp_path / fifo
    path.parent.mkdir(exist_ok=True)
    os.mkfifo(path)
    (tmp_path / "bad.binary").write_text("no measurement")
    places = {"OUT": tmp_path / "out", "FILE": tmp_path / "bad.binary"}
    assert main([re.sub("OUT|FILE", lambda found: str(places[found[0]]), a) for a in arguments]) == 1
    kind = "a folder" if arguments[0] != "view" and fifo == "out" else "a file"
    assert capsys.readouterr().err == f"torchbrdf: {path}: expected {kind} or a new name, found a FIFO\n"
    assert path.is_fifo() and not list(tmp_path.glob("**/.*"))


def test_fits_that_are_links_are_written_where_they_lead(paint, tmp_path, capsys):
    out, there = tmp_path / "out", tmp_path / "there"
    out.mkdir()
    for name in ("fits.json", "fits.csv"):
        (out / name).symlink_to(there / name)
    assert main(["fit", str(paint), "--samples", "200", "--lobes", "1", "--out", str(out)]) == 0
    links = {"fits.json": True, "fits.csv": True, "manifest.json": False, "fits": False}
    assert {path.name: path.is_symlink() for path in out.iterdir()} == links
    assert {path.name: path.is_symlink() for path in there.iterdir()} == {"fits.json": False, "fits.csv": False}
    assert read_fits(there / "fits.json")[0].material == "paint"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "torchbrdf: .*COMMAND; see torchbrdf --help"),
        (["fti"], "torchbrdf: COMMAND: invalid choice: 'fti'"),
        (["fit"], "torchbrdf fit: the following arguments are required: files; see torchbrdf fit --help"),
        (["fit", "x", "--lobes", "0"], "torchbrdf fit: --lobes: expected a whole number from 1 to 8, found '0'; see"),
        (["fit", "x", "--lobes", "9" * 9000], r"expected a whole number from 1 to 8, found '9+ \.\.\. 9+'; see"),
        (["fit", "x", "--max-theta", "nan"], "--max-theta: expected a number from 1 to 90, found 'nan'"),
        (["fit", "x", "--max-theta", "120"], "--max-theta: expected a number from 1 to 90, found '120'"),
        (["fit", "x", "--samples", "-1"], "--samples: expected a whole number from 1 to 10000000, found '-1'"),
        (["fit", "x", "--seed", "1" * 23], "--seed: expected a whole number from 0 to 9223372036854775807, found"),
        (["fit", "x", "--size", "30000"], "--size: expected a whole number from 8 to 1024, found '30000'"),
        (["fit", "x", "--lights", "0"], "--lights: expected a whole number from 1 to 16384, found '0'"),
        (["fit", "x", "--lbes", "1"], "torchbrdf fit: unknown option or word '--lbes'; see"),
        (["fit", "x", "--" + "l" * 9000], "torchbrdf fit: unknown option or word '--l.*; see"),
        (["study", "serve", "here", "there"], "torchbrdf study serve: unknown option or word 'there'; see"),
    ],
)
def test_usage_errors_of_the_parser_exit_2_with_one_line(capsys, arguments, said):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and len(printed.err) <= 301 and printed.out == ""
    assert re.match(f".*{said}", printed.err)


@pytest.mark.parametrize("text", ["0", "all", "none", "ALL"])
def test_all_pairs_have_several_words(text):
    assert build_parser().parse_args(["fit", "x", "--samples", text]).samples is None


def test_what_older_fits_do_not_say_is_called_so(paint, tmp_path, capsys):
    arguments = ["fit", str(paint), "--lobes", "1", "--samples", "300", "--out", str(tmp_path)]
    assert main(arguments) == 0
    (record,) = json.loads((tmp_path / "fits.json").read_text())
    del record["diffuse"]
    shutil.rmtree(tmp_path / "fits")
    (tmp_path / "manifest.json").unlink()  # which older folders do not have
    (tmp_path / "fits.json").write_text(json.dumps([record]))
    assert main(arguments) == 1
    assert "was fitted with diffuse that the file does not say, not 'fit'" in capsys.readouterr().err


def test_words_may_stand_behind_options(paint, tmp_path, capsys):
    assert main(["run", "fores2012", "--out", str(tmp_path / "out"), "quik=true"]) == 2
    assert "unknown setting of fores2012 'quik'" in capsys.readouterr().err
    assert main(["fit", "nowhere", "--lobes", "1", str(paint), "--samples", "300"]) == 1
    assert "paint" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e400", "2", "", "x", "1" * 5000])
def test_options_of_numbers_are_finite_and_bounded(text):
    with pytest.raises(argparse.ArgumentTypeError, match=r"expected a number from 0 to 1, found .{2,40}$"):
        number(0, 1)(text)
    assert number(0, 1)("0.5") == 0.5


def test_what_the_system_says_is_one_line(tmp_path, capsys):
    assert main(["fit", str(tmp_path / ("x" * 5000))]) == 1
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and len(printed.err) <= 330


def test_help_teaches():
    done = subprocess.run([sys.executable, "-m", "torchbrdf", "--help"], capture_output=True, text=True, check=True)
    assert "torchbrdf run fores2012" in done.stdout and "torchbrdf fit nickel.binary" in done.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "BAD", "--out", "OUT/a/b"],
        ["export", "BAD", "--to", "mitsuba", "--out", "OUT"],
        ["export", "PAINT", "--to", "gltf", "--mesh", "nowhere.ply", "--out", "OUT"],
        ["match", "BAD", "--budget", "quick", "--out", "OUT"],
        ["render", "BAD", "--out", "OUT"],
        ["render", "PAINT", "--environment", "nowhere.hdr", "--out", "OUT"],
        ["view", "BAD", "--out", "OUT/view.html"],
        ["check", "BAD", "--out", "OUT"],
        ["study", "scale", "nowhere.csv", "--out", "OUT"],
        ["study", "export", "nowhere", "--out", "OUT/answers.csv"],
        ["study", "simulate", "nowhere", "--out", "OUT/answers.csv"],
        ["run", "fores2012", "sise=3", "--out", "OUT"],
    ],
)
def test_no_empty_folder_is_left_where_nothing_came_of_it(paint, tmp_path, capsys, arguments):
    bad = tmp_path / "broken.binary"
    bad.write_bytes(b"\x5a\x00\x00\x00\x5a\x00\x00\x00\xb4\x00\x00\x00" + bytes(100))
    places = {"PAINT": paint, "BAD": bad, "OUT": tmp_path / "out"}
    assert main([re.sub("PAINT|BAD|OUT", lambda found: str(places[found[0]]), a) for a in arguments]) > 0
    assert not (tmp_path / "out").exists()
    assert capsys.readouterr().err.startswith("torchbrdf")


def test_a_black_material_is_fitted_and_that_is_said(tmp_path, capsys):
    path = tmp_path / "black.json"
    write_fits(
        path, [FitRecord("black", "ward", 1, {"diffuse": [0.0] * 3, "specular": [[0.0] * 3], "roughness": [0.1]})]
    )
    assert main(["fit", str(path), "--lobes", "1", "--samples", "300", "--loss", "rms"]) == 0
    assert "(no value is above 0, which every model fits)" in capsys.readouterr().out
    assert main(["render", str(path), "--size", "16", "--out", str(tmp_path / "out")]) == 1
    said = "expected pictures with some light, found nothing but black, as of materials whose values are all 0"
    assert capsys.readouterr().err == f"torchbrdf: ToneMap: {said}\n" and not (tmp_path / "out").exists()
