"""Formats that list directions and values: what they hold, what is mended, and what is refused."""

import json
import math
import os
import pickle
import subprocess
import sys
import tarfile

import numpy as np
import pytest
import torch
from helpers.listed_files import (
    BANDS,
    COLOR,
    alta,
    angles,
    astm,
    bird,
    columns,
    cornell,
    fred,
    known,
    openmaterial,
    ssdd,
    zemax,
)

from torchbrdf.cli import main
from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.export.materials import find_materials
from torchbrdf.export.tables import reach
from torchbrdf.measured import Measured, check, describe, load
from torchbrdf.measured.bands import rgb_weights
from torchbrdf.pairs import Pairs

TEXTS = {
    "alta": alta,
    "astm": astm,
    "bird": bird,
    "columns": columns,
    "cornell": cornell,
    "fred": fred,
    "openmaterial": openmaterial,
    "ssdd": ssdd,
    "zemax": zemax,
}


def written(folder, text, name="made-up.dat"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def opened(folder, text):
    return load(written(folder, text), dtype=torch.float64)


def expected(measured):
    """The known BRDF at the pairs of what was read, `(N,)`."""
    pairs = measured.pairs
    polar = [
        torch.atan2((1 - cosine**2).clamp_min(0).sqrt(), cosine)[0].numpy() for cosine in (pairs.cos_i, pairs.cos_o)
    ]
    wi, wo = pairs.wi[0], pairs.wo[0]
    turn = torch.atan2(wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0], (wi[:, :2] * wo[:, :2]).sum(-1)).numpy()
    return torch.from_numpy(known(*polar, turn))


@pytest.mark.parametrize("name", TEXTS)
def test_values_are_where_they_were_measured(name, tmp_path):
    """The mirror direction, and so the lobe, is where the format has it."""
    measured = opened(tmp_path, TEXTS[name]())
    assert measured.source.format == name
    scale = (
        torch.tensor(COLOR @ rgb_weights(BANDS)) if name in ("astm", "openmaterial") else torch.tensor([COLOR[0]] * 3)
    )
    scale = torch.ones(3, dtype=torch.float64) if name in ("cornell", "zemax") else scale
    scale = torch.tensor(COLOR) if name in ("alta", "columns", "ssdd") else scale
    good = measured.weight[0, :, 0] > 0
    assert good.sum() > 100
    wanted = expected(measured)[:, None] * scale
    torch.testing.assert_close(measured.values[0, good], wanted[good].double(), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("change", ["crlf", "cr", "bom"])
def test_lines_of_other_systems(name, change, tmp_path):
    text = TEXTS[name]()
    changed = {"crlf": text.replace("\n", "\r\n"), "cr": text.replace("\n", "\r"), "bom": "\ufeff" + text}[change]
    again = load(written(tmp_path, changed, "changed"), dtype=torch.float64)
    assert torch.equal(again.values, opened(tmp_path, text).values)


@pytest.mark.parametrize("name", TEXTS)
def test_samples_are_materials(name, tmp_path):
    measured = opened(tmp_path, TEXTS[name]())
    again = pickle.loads(pickle.dumps(measured))
    assert torch.equal(again.values, measured.values) and len(pickle.dumps(measured)) < 20_000
    assert measured.has_45_0.all() and measured.source.is_reciprocal
    assert 0 < measured.diffuse_45_0().min() < 1
    facts = describe(tmp_path / "made-up.dat")
    assert facts["format"] == name and facts["quantity"] == "BRDF, 1/sr" and "angles" in facts and "colours" in facts


def test_what_info_says(tmp_path):
    rows = angles()
    path = written(tmp_path, astm(rows, names="theta_i,phi_i,theta_s", points=7))
    facts = describe(path)
    assert facts["columns"] == "the header names 6, the rows have 7: phi_s behind theta_s"
    assert facts["rows"] == f"{len(rows)}, and the header says '7'; the rows were believed"
    assert facts["angles of the light, degrees"] == "0 20 40 60"
    assert facts["angles"].startswith("radians (the file does not say; the largest from the normal is 1.396)")
    assert "CIE 1931 observer under illuminant D65, interpolated between 3 bands" in facts["colours"]
    assert facts["reciprocity error"].startswith("0") or "e-" in facts["reciprocity error"]
    assert facts["negative share"] == 0 == facts["invalid share"]


def test_angles_in_degrees_are_told_and_can_be_said(tmp_path):
    path = written(tmp_path, astm(unit=np.array))
    facts = describe(path)
    assert facts["angles"] == "degrees (the file does not say; one of 80 from the normal cannot be radians)"
    told = load(path, settings={"angles": "degrees"}, dtype=torch.float64)
    assert torch.equal(told.values, load(path, dtype=torch.float64).values)
    assert pickle.loads(pickle.dumps(told)).source.told == {"angles": "degrees"}
    with pytest.raises(
        DataError, match=r"made-up\.dat: expected angles from the normal up to 3\.142 radians, found 80"
    ):
        load(path, settings={"angles": "radians"})
    with pytest.raises(UsageError, match="unknown angles 'grad'"):
        load(path, settings={"angles": "grad"})
    with pytest.raises(UsageError, match="expected one that astm has"):
        load(path, settings={"units": "grad"})


def test_illuminants_and_quantities(tmp_path):
    path = written(tmp_path, astm())
    plain = load(path, dtype=torch.float64)
    other = load(path, settings={"illuminant": "E"}, dtype=torch.float64)
    assert not torch.allclose(plain.values, other.values, rtol=1e-3)
    factor = load(path, settings={"quantity": "reflectance_factor"}, dtype=torch.float64)
    torch.testing.assert_close(factor.values * math.pi, plain.values)
    cosine = load(path, settings={"quantity": "brdf_cosine"}, dtype=torch.float64)
    torch.testing.assert_close(cosine.values * plain.pairs.cos_o[..., None], plain.values)


def test_repetitions_noise_and_what_is_missing(tmp_path):
    rows = astm().splitlines()
    rows[8] = ",".join([*rows[8].split(",")[:4], "nan", "1", "1"])
    rows[9] = ",".join([*rows[9].split(",")[:4], "-0.01", "-0.01", "-0.01"])
    rows.append(rows[12])
    measured = opened(tmp_path, "\n".join(rows))
    assert (measured.weight == 0).sum() == 1
    assert measured.values.min() < 0 and measured.at(measured.pairs).isfinite().all()
    facts = describe(tmp_path / "made-up.dat")
    assert facts["invalid share"] > 0 and facts["negative share"] > 0


NO_NUMBER = "line 10: expected a number in column 6, found 'x'"
BAD = {
    "a row is short": (lambda text: text.replace(text.splitlines()[-1], "0.1,0.2"), "expected 7 numbers, found 2"),
    "no number": (lambda text: text.replace(text.splitlines()[9], "0,0,0,0,0.1,x,0.1"), NO_NUMBER),
    "no rows": (lambda text: "\n".join(text.splitlines()[:6]), "expected samples, found none"),
    "two angles": (lambda text: text.replace(",theta_s,phi_s", ""), "expected theta_i, phi_i, theta_s, phi_s once"),
    "a band twice": (lambda text: text.replace("525nm", "465nm"), "expected bands such as 465nm"),
    "no lengths": (lambda text: text.replace("465nm,525nm,630nm", "b1,b2,b3"), "expected bands such as 465nm"),
    "too large": (
        lambda text: text + "200,0,0.1,0,1,1,1\n",
        "expected angles from the normal up to 180 degrees, found",
    ),
    "an angle that is none": (lambda text: text + "nan,0,0.1,0,1,1,1\n", "found nan"),
    "an underscore": (lambda text: text + "1_0,0,0.1,0,1,1,1\n", "expected a number in column 1, found '1_0'"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_astm_files_are_refused(kind, tmp_path):
    change, says = BAD[kind]
    with pytest.raises(DataError) as caught:
        opened(tmp_path, change(astm()))
    assert says in str(caught.value) and "made-up.dat" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (cornell().replace("# num wls\n4", "# num wls\nx"), "# num wls: expected a count"),
        (cornell().replace("600 700", "600 500"), "# wls: expected 4 growing wavelengths"),
        (cornell().replace("600 700", "600"), "# wls: expected 4 growing wavelengths"),
        (fred().replace("angles=deg", "angles=gon"), "expected angles=deg or angles=rad"),
        (fred() + "5 9\n", "expected rows of this light behind it, found none"),
        (fred() + "1 2 3 4\n", "expected two angles of a light, or a row of 3"),
        (columns().replace("phi", "chi"), "expected a column phi, or phi_i and phi_o"),
        (columns().replace("r,g,b", "x,y,z"), "expected r, g, b, or bands such as 465nm, which"),
        (columns().replace("r,g,b", "r,g,g"), "expected each column once"),
        (bird().replace('"sr^-1"', '"%"'), "expected angles in"),
        (bird().replace('"theta_r"', '"theta_x"'), "theta_r"),
        (bird().replace('"unit": "nm"', '"unit": "m"'), "wavelength: expected nm"),
        (openmaterial().replace('"brdf"', '"emp"'), "expected a measured BRDF"),
        (openmaterial().replace('"lookupTable"', '"table"'), "missing required field `lookupTable`"),
        (openmaterial().replace("[[", "[[1, "), "lookupTable[0]: expected 5 numbers, found 6"),
        (openmaterial(bands=(0,)), "wavelengths: expected some of light, 0 to 1e+06 nm, found 0 to 0"),
        (openmaterial(bands=(3e6,)), "wavelengths: expected some of light"),
        (openmaterial().replace("1.39", "139", 1), "radians, found 1.39626e+16"),
        (zemax().replace("BRDF", "BTDF"), "ScatterType: expected BRDF, found 'BTDF'"),
        (zemax().replace("TIS\t0.1\n", "TIS\t0.1\n1 2 3\n", 1), "expected 10 numbers, found 3"),
        (
            zemax().replace("AngleOfIncidence\t2\n10\t40", "AngleOfIncidence\t3\n10\t40\t50"),
            "expected 30 rows of values",
        ),
        (zemax().replace("ScatterRadial\t10", "ScatterRadial\t-1"), "expected a count of angles"),
        (zemax().replace("DataBegin", ""), "expected DataBegin"),
    ],
)
def test_bad_files_are_refused(text, says, tmp_path):
    with pytest.raises(DataError) as caught:
        opened(tmp_path, text)
    assert says in str(caught.value) and "made-up.dat" in str(caught.value)


def test_azimuths_of_isotropic_samples_are_read_as_their_mean(tmp_path):
    rows = np.concatenate([angles(), angles() + np.array([0, 90, 0, 90])])
    path = written(tmp_path, astm(rows))
    said = describe(path)["azimuths of the light"]
    assert said.startswith("2: read as isotropic, by the mean over them; samples that are left out")
    assert not load(path).is_anisotropic


def test_files_of_one_geometry_share_their_pairs(tmp_path):
    for name in "ab":
        written(tmp_path, astm(), f"{name}.astm")
    both = load(tmp_path)
    assert both.pairs.shape[0] == 1 and len(both) == 2
    written(tmp_path, astm(angles(20)), "c.astm")
    three = load(tmp_path)
    assert three.pairs.shape[0] == 3 == len(three)
    torch.testing.assert_close(three.batch([0]).at(both.pairs), both.batch([0]).at(both.pairs))


def test_columns_in_an_npz_and_with_decimal_commas(tmp_path):
    plain = opened(tmp_path, columns())
    table = np.loadtxt(tmp_path / "made-up.dat", delimiter=",", skiprows=2)
    np.savez(tmp_path / "x.npz", **dict(zip(["theta_o", "theta_i", "phi", "r", "g", "b"], table.T, strict=True)))
    assert torch.equal(load(tmp_path / "x.npz", dtype=torch.float64).values, plain.values)
    commas = columns(mark=";").replace(".", ",")
    assert torch.equal(load(written(tmp_path, commas, "commas"), dtype=torch.float64).values, plain.values)
    assert describe(tmp_path / "commas")["mended"] == "decimal commas"
    np.savez(tmp_path / "x.npz", theta_i=np.zeros(3), theta_o=np.zeros(2), phi=np.zeros(3), f=np.ones(3))
    with pytest.raises(DataError, match=r"x\.npz: 'theta_o': expected 3 numbers"):
        load(tmp_path / "x.npz")


def test_real_paints(data, tmp_path):
    archive = data / "goniometer" / "paints_astm.tar.xz"
    if not archive.exists():
        pytest.skip("needs measured data: no paints_astm.tar.xz")
    with tarfile.open(archive) as files:
        member = next(one for one in files if one.name.endswith("C1_White.astm"))
        text = files.extractfile(member).read()
    measured = opened(tmp_path, text)
    assert measured.weight.mean() > 0.98 and measured.has_45_0.all()
    assert measured.diffuse_45_0()[0].tolist() == pytest.approx([0.82, 0.84, 0.86], abs=0.02)


@pytest.mark.parametrize("name", ["garnet_red", "mystique"])
def test_real_gonioreflectometer_files(name, data):
    measured = load(data / "cornell" / f"{name}.brdf", dtype=torch.float64)
    assert measured.values.shape == (1, 1439, 3)
    red, green, blue = measured.diffuse_45_0()[0].tolist()
    assert name == "mystique" or red > 5 * max(green, blue)


def test_real_scatter_of_one_sample_in_two_formats(data):
    """The same instrument's measurement of anodized aluminium, as Zemax and as FRED take it."""
    folder = data / "formats"
    one = load(folder / "zemax" / "AnoBlackEC1onAlum.bsdf", dtype=torch.float64)
    other = load(folder / "fred" / "AnoBlackEC1onAlum.txt", dtype=torch.float64)
    near = one.distance_at(other.pairs)[0] < 0.7
    apart = (one.at(other.pairs) / other.values - 1).abs()[0, near, 0]
    assert near.sum() > 100 and apart.median() < 0.05


def test_the_command_is_told_what_a_file_does_not_say(tmp_path, capsys):
    path = str(written(tmp_path, astm()))
    assert main(["info", path, "--read", "illuminant=E", "--read", "angles=radians"]) == 0
    said = capsys.readouterr().out
    assert "under illuminant E" in said and "white furnace: albedo at 60 degrees" in said
    for wrong, says in (("illuminant=F", "unknown illuminant 'F'"), ("angle", "--read: expected NAME=VALUE")):
        assert main(["info", path, "--read", wrong]) == 2
        assert says in capsys.readouterr().err


@pytest.mark.parametrize("command", [["match"], ["export", "--to", "merl", "--out", "out"]])
def test_every_command_that_reads_is_told(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = str(written(tmp_path, astm()))
    assert main([*command, path, "--read", "illuminant=F"]) == 2
    assert "unknown illuminant 'F'" in capsys.readouterr().err
    (material,) = find_materials(path, [], settings={"quantity": "reflectance_factor"})
    torch.testing.assert_close(material.brdf.values * math.pi, load(path).values)


def test_what_was_measured_is_said_of_light_and_viewer(tmp_path):
    measured = opened(tmp_path, columns())
    said = "with the light up to 60 degrees from the normal, the viewer up to 80; beyond, values are extrapolated"
    assert f"was measured only {said}" in check(measured)[0].warnings()
    assert reach(measured) == [f"measured {said}"]


def test_values_that_are_no_tensor():
    pairs = Pairs.from_half_diff(*torch.rand(3, 1, 4))
    with pytest.raises(ShapeError, match="expected a tensor"):
        Measured.from_samples(pairs, np.ones((1, 4, 3)))


def test_reciprocity_is_that_of_the_samples(tmp_path, capsys):
    text = astm().splitlines()
    (tmp_path / "inner").mkdir()
    assert main(["info", str(tmp_path)]) == 1
    assert "found no file, and 1 folders" in capsys.readouterr().err
    # Another value with the light at 60 degrees: exchanged directions are no longer alike.
    rows = [line if not line.startswith("1.0471") else ",".join([*line.split(",")[:4], "1", "1", "1"]) for line in text]
    own = written(tmp_path, "\n".join(rows))
    assert main(["check", str(own)]) == 0
    said = capsys.readouterr().out.splitlines()[1]
    assert describe(own)["reciprocity error"].partition(" (")[0] in said and " 0.0 %" not in said


@pytest.mark.parametrize(("value", "says"), [("1e30", "found 1e+30 and more"), ("nan", "found none")])
def test_values_that_no_surface_has(value, says, tmp_path):
    text = f"theta_i,theta_o,phi,f\n10,20,0,{value}\n10,40,0,{value}\n"
    with pytest.raises(DataError, match=r"expected values up to 1e\+08 / sr") as caught:
        opened(tmp_path, text)
    assert says in str(caught.value)


def test_a_reader_that_has_seen_enough(tmp_path):
    path = written(tmp_path, astm())
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "torchbrdf", "info", path], stdout=writing, stderr=subprocess.PIPE, check=False
    )
    os.close(writing)
    assert done.returncode == 141 and b"pipe" not in done.stderr.lower()


def test_openmaterial_says_what_it_took(tmp_path):
    """The azimuth that 0 is, bands that are missing, a header that lies, and rows that hold nothing."""
    path = written(tmp_path, openmaterial())
    assert describe(path)["azimuths"] == "0 is the light's (the file does not say)"
    other = load(written(tmp_path, openmaterial(azimuth=180), "o"), settings={"azimuth": "mirror"}, dtype=torch.float64)
    same = load(path, dtype=torch.float64)
    torch.testing.assert_close(other.at(same.pairs), same.at(same.pairs), rtol=1e-5, atol=1e-8)
    document = json.loads(openmaterial())
    document["brdf"]["lookupTable"][5][4] = None
    document["brdf"]["lookupTable"].append(document["brdf"]["lookupTable"][7])
    document["brdf"]["wavelengths"].append(7e-7)
    facts = describe(written(tmp_path, json.dumps(document)))
    assert facts["wavelengths"] == "the header lists 4, the rows have 3; the rows were believed"
    assert facts["samples"] - facts["valid samples"] == 1 and "their means" in facts["repetitions"]


def test_real_asphalt(data):
    asphalt = load(data / "formats" / "openmaterial3d" / "example_material_camera_brdf.xompt", dtype=torch.float64)
    assert asphalt.values.shape == (1, 59, 3) and (asphalt.weight == 1).all()
    # Somewhat brownish: all values of one wavelength are the same, and grow with it.
    red, green, blue = asphalt.values[0, 0].tolist()
    assert 1e-5 < blue < green < red < 3e-5


def test_of_two_kinds_of_azimuths_it_is_said_which_was_believed(tmp_path):
    path = tmp_path / "both.csv"
    path.write_text("theta_i,theta_o,phi,phi_i,phi_o,f\n10,20,180,0,30,1\n20,30,180,0,30,2\n")
    assert describe(path)["azimuths"] == "those of the columns phi_i and phi_o; phi was passed over"
