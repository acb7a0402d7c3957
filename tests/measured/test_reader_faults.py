"""Faults of files that readers say or refuse in one line, and what Python's entrances refuse."""

import logging
import subprocess
import sys

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.listed_files import angles, astm, bird, columns, values
from helpers.measured_files import synthetic_bsdf, tensor_file

from torchbrdf.cli import main
from torchbrdf.errors import LONGEST_MESSAGE, DataError, ShapeError, UsageError
from torchbrdf.export import export
from torchbrdf.measured import Measured, describe, load
from torchbrdf.measured.tables import measured_up_to
from torchbrdf.pairs import Pairs

TABLE = {"theta_i": np.zeros(3), "theta_o": np.zeros(3), "phi": np.zeros(3), "f": np.ones(3)}


def pairs_of(count):
    return Pairs.from_directions(hemisphere(1, count), hemisphere(1, count, seed=1))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("theta_i,phi,r,g,b\n1,2,3,4,5\n", "found columns 'theta_i phi r g b' without theta_o"),
        ("r;g;b\n1;2;3\n", "found columns 'r g b' without theta_i, theta_o"),
        ("theta_in,theta_out,phi,r,g,b\n", "without theta_i, theta_o"),
        ("angle,value\n1,2\n", "found columns 'angle value' without theta_i, theta_o"),
        (
            "theta_i,theta_o,phi,x,y\n0,0,0,1,1\n",
            "expected r, g, b, or bands such as 465nm, which names their wavelengths, or f, found 'x y'",
        ),
        ("theta_i,theta_o,r,g,b\n0,0,0,1,1\n", "expected a column phi, or phi_i and phi_o, found"),
        (
            "theta_i,theta_o,phi\n0,0,0\n",
            "expected r, g, b, or bands such as 465nm, which names their wavelengths, or f, found ''",
        ),
    ],
)
def test_a_table_that_lacks_columns_says_which(text, found, tmp_path):
    path = tmp_path / "near.csv"
    path.write_text(text)
    with pytest.raises(DataError) as error:
        load(path)
    assert found in str(error.value) and len(str(error.value)) <= LONGEST_MESSAGE


def test_an_archive_that_lacks_arrays_says_which(tmp_path):
    np.savez(tmp_path / "near.npz", theta_i=np.zeros(3), f=np.zeros(3))
    with pytest.raises(DataError, match=r"found arrays 'theta_i f' without theta_o$"):
        load(tmp_path / "near.npz")
    np.savez(tmp_path / "whole.npz", **TABLE)
    (tmp_path / "cut.npz").write_bytes((tmp_path / "whole.npz").read_bytes()[:-40])
    with pytest.raises(DataError, match="found an archive that is damaged, or has no arrays"):
        load(tmp_path / "cut.npz")


def test_files_of_a_folder_that_are_passed_over_are_said(tmp_path, caplog):
    np.savez(tmp_path / "whole.npz", **TABLE)
    np.savez(tmp_path / "other.npz", weights=np.ones(3))
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "picture.png").write_bytes(b"png")
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        assert load(tmp_path).names == ["whole"]
    expected = "passed over 3 files: 2 of no known format (notes.txt, ...), 1 pictures or pages (picture.png)"
    assert expected in caplog.text
    caplog.clear()
    (tmp_path / "notes.txt").unlink()
    (tmp_path / "picture.png").unlink()
    (tmp_path / "log.txt").write_text("hello")
    load(tmp_path)
    assert "passed over 2 files: 1 of no known format (other.npz), 1 that a command wrote (log.txt)" in caplog.text


def test_a_folder_of_fits_passes_over_what_commands_wrote(tmp_path, caplog):
    (tmp_path / "paint.astm").write_text(astm())
    assert main(["fit", str(tmp_path / "paint.astm"), "--loss", "rms", "--out", str(tmp_path / "out")]) == 0
    caplog.clear()
    load(tmp_path / "out")
    assert "passed over" not in caplog.text


def test_a_text_is_no_bad_rgl_file(tmp_path):
    (tmp_path / "odd.bsdf").write_text("SomeProgram 1.0\n1 2 3\n")
    with pytest.raises(
        DataError, match=r"expected a measured BRDF \(.*\), found a file that begins with b'SomeProgram"
    ):
        load(tmp_path / "odd.bsdf")
    with pytest.raises(DataError, match=r"odd\.bsdf: expected a measured BRDF"):  # and is not passed over
        load(tmp_path)
    (tmp_path / "odd.bsdf").write_bytes(b"\0" * 200)
    with pytest.raises(DataError, match="expected an RGL file"):
        load(tmp_path / "odd.bsdf")


def test_repeated_directions_are_said(tmp_path, caplog):
    rows = astm().splitlines()
    again = rows[12].split(",")
    path = tmp_path / "paint.astm"
    path.write_text("\n".join([*rows, ",".join([*again[:4], *(str(1.2 * float(one)) for one in again[4:])])]))
    said = describe(path)["repeated directions"]
    assert said.startswith("2 samples at 1 places, half of them 18 % apart or more, at most 18 %")
    assert f"{path}: repeated directions: {said}" in caplog.text
    path.write_text("\n".join([*rows, rows[12]]))
    assert describe(path)["repeated directions"] == "2 samples at 1 places, with the same values"


def test_angles_in_the_wrong_unit_are_doubted(tmp_path, caplog):
    path = tmp_path / "paint.csv"
    path.write_text(columns())  # degrees, and so they are taken
    describe(path)
    assert "may be radians" not in caplog.text
    rows = angles()
    table = np.concatenate([np.radians(rows[:, [2, 0]]), np.radians(rows[:, 3:] - rows[:, 1:2]), values(rows)], 1)
    head = "theta_o,theta_i,phi,r,g,b\n"
    path.write_text(head + "\n".join(",".join(f"{one:.6g}" for one in row) for row in table))
    assert describe(path)["angles"].startswith("radians")
    assert "they may be radians" in describe(path, {"angles": "degrees"})["angles"]
    assert "none from the normal is above 1.396: they may be radians" in caplog.text
    mixed = np.concatenate([rows[:, [2, 0]], np.radians(rows[:, 3:] - rows[:, 1:2]), values(rows)], 1)
    path.write_text(head + "\n".join(",".join(f"{one:.6g}" for one in row) for row in mixed))
    assert "azimuths may be radians" in describe(path)["angles"]
    path.write_text(columns())
    with pytest.raises(DataError, match=r"up to 3\.142 radians, found 80 \(are they degrees\?"):
        load(path, settings={"angles": "radians"})
    said = bird().replace('"unit": "°"', '"unit": "\\u00b0"')
    path.write_text(said)
    assert "may be" not in describe(path)["angles"]


def test_tensors_that_are_no_measurement():
    pairs, ones = pairs_of(4), torch.ones(1, 4, 3)
    with pytest.raises(DataError, match="expected finite ones above the horizon, found none of 4"):
        Measured.from_samples(pairs, ones * torch.nan)
    long = Pairs.from_directions(2 * pairs.wi, pairs.wo)
    with pytest.raises(ShapeError, match="wi: expected unit vectors, found 4 of 4 others, the first of the length 2"):
        Measured.from_samples(long, ones)
    with pytest.raises(UsageError, match="pairs: expected Pairs, found"):
        Measured.from_samples(pairs.wi, ones)
    with pytest.raises(ShapeError, match=r"expected a tensor of floats \(M, N, C\), found torch.int64"):
        Measured.from_samples(pairs, ones.long())
    half = Pairs.from_directions(pairs.wi.half(), pairs.wo.half())
    assert Measured.from_samples(half, ones.half()).values.shape == (1, 4, 3)


@pytest.mark.parametrize(
    ("samples", "found"),
    [
        ([0, 1], r"found \[0, 1\]"),
        (3, "found 3"),
        ("all", "found 'all'"),
        (torch.tensor([0.5]), r"found torch.float32 \(1,\)"),
        (torch.tensor(2), r"found torch.int64 \(\)"),
        (torch.tensor([[0]]), r"found torch.int64 \(1, 1\)"),
        (torch.tensor([True]), "found 1 truths"),
    ],
)
def test_samples_of_a_batch_are_an_index(samples, found):
    measured = Measured.from_samples(pairs_of(4), torch.ones(1, 4, 3))
    with pytest.raises(UsageError, match=f"batch: samples: expected a tensor of whole numbers .*{found}"):
        measured.batch(samples=samples)
    assert len(measured.batch(samples=torch.tensor([True, False, True, False])).pairs) == 2


def test_python_exports_take_the_readers_settings(tmp_path):
    (tmp_path / "paint.astm").write_text(astm())
    shown = [
        export(tmp_path / "paint.astm", "rgl", tmp_path / light, settings={"illuminant": light}).shown
        for light in ("D65", "E")
    ]
    pairs = pairs_of(20)
    assert not torch.allclose(shown[0].at(pairs), shown[1].at(pairs), rtol=1e-3)
    with pytest.raises(UsageError, match="expected one that astm has"):
        export(tmp_path / "paint.astm", "rgl", tmp_path / "out", settings={"unit": "m"})


def test_light_and_viewer_of_a_table_reach_as_far_as_they_do(tmp_path):
    (tmp_path / "felt.bsdf").write_bytes(tensor_file(synthetic_bsdf()))
    found = measured_up_to(load(tmp_path / "felt.bsdf"))
    assert found.light == pytest.approx(67.5, abs=0.1) and found.viewer > 80


@pytest.mark.parametrize("command", ["fit", "info", "match", "render", "view", "check", "export"])
def test_files_that_are_not_there_are_answered_without_torch(command, tmp_path):
    more = {"export": ["--to", "mitsuba", "--out", "x"], "render": ["--out", "x"], "view": ["--out", "x.html"]}
    arguments = [command, "missing.binary", "other.binary", *more.get(command, [])]
    code = f"import sys; from torchbrdf.cli import main; s = main({arguments!r}); print('torch' in sys.modules)"
    code += "; sys.exit(s)"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stdout.strip() == "False"
    assert done.stderr == "torchbrdf: missing.binary: no such file or folder, nor any of 1 others\n"
    assert not any(tmp_path.iterdir())
