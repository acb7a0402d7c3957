"""How a file was read is kept in the records of its fits, and said again."""

import json

import pytest
import torch
from helpers.listed_files import astm, bird, columns, cornell, fred, zemax
from helpers.measured_files import synthetic_bsdf, tensor_file

from torchbrdf import fit
from torchbrdf.cli import main
from torchbrdf.errors import DataError
from torchbrdf.fitting.result import fits_csv
from torchbrdf.lobes import FitRecord, make_model, read_fits
from torchbrdf.losses import RMSLoss
from torchbrdf.measured import describe, load
from torchbrdf.report.match import match

TEXTS = {"astm": astm, "bird": bird, "columns": columns, "cornell": cornell, "fred": fred, "zemax": zemax}


@pytest.mark.parametrize("name", TEXTS)
def test_records_say_how_a_file_was_read(name, tmp_path):
    path = tmp_path / "made-up.dat"
    path.write_text(TEXTS[name]())
    measured = load(path, settings={"illuminant": "E"})
    result = fit(make_model("ward", 1), measured, RMSLoss(), samples=100, max_iterations=2)
    result.save(tmp_path / "fits.json")
    (record,) = read_fits(tmp_path / "fits.json")
    said = record.reading
    assert (said["format"], said["file"], said["settings"]) == (name, "made-up.dat", {"illuminant": "E"})
    assert {"quantity", "angles", "colours"} <= set(said)
    assert ("illuminant E" in said["colours"]) == (name in ("astm", "cornell", "bird"))
    assert describe(tmp_path / "fits.json")["read from"] == said
    assert FitRecord.from_json(json.loads(json.dumps(record.to_json()))) == record
    assert "reading_angles" in fits_csv([record]).splitlines()[0]


def test_what_was_believed_is_kept(tmp_path, capsys):
    path = tmp_path / "paint.astm"
    path.write_text(astm(names="theta_i,phi_i,theta_s", points=7))
    assert main(["fit", str(path), "--lobes", "1", "--loss", "rms", "--out", str(tmp_path / "out")]) == 0
    (record,) = read_fits(tmp_path / "out" / "fits.json")
    assert record.reading["columns"] == "the header names 6, the rows have 7: phi_s behind theta_s"
    assert record.reading["rows"].endswith("the rows were believed")
    capsys.readouterr()
    assert main(["info", str(tmp_path / "out" / "fits.json")]) == 0
    said = capsys.readouterr().out
    assert "read from" in said and "the rows were believed" in said and "illuminant D65" in said


def test_bands_of_spectral_files_are_kept_in_records(tmp_path):
    fields = synthetic_bsdf()
    fields |= {
        "spectra": fields.pop("rgb")[:, :, [0, 1, 0, 1]] + 0.3,
        "wavelengths": torch.arange(400, 800, 100).numpy(),
    }
    fields["wavelengths"] = fields["wavelengths"].astype("f4")
    (tmp_path / "felt_spec.bsdf").write_bytes(tensor_file(fields))
    for bands, words in (("rgb", "linear RGB"), ("keep", "none: 4 bands")):
        measured = load(tmp_path / "felt_spec.bsdf", bands=bands)
        (record,) = fit(make_model("ward", 1), measured, RMSLoss(), max_iterations=2).records()
        assert record.reading["colours"].startswith(words) and record.reading["file"] == "felt_spec.bsdf"
        again = fit(make_model("ward", 1), measured.to_rgb("E"), RMSLoss(), max_iterations=2).records()[0]
        assert ("illuminant E" in again.reading["colours"]) == (bands == "keep")


def test_match_refuses_what_has_hardly_a_sample(tmp_path):
    head = "theta_i,theta_o,phi,r,g,b\n"
    (tmp_path / "one.csv").write_text(head + "0.1,0.2,3,1,1,1\n")
    with pytest.raises(DataError, match=r"one: expected 12 valid samples or more, found 1"):
        match(tmp_path / "one.csv", budget="quick")
    (tmp_path / "bands.astm").write_text(astm())
    with pytest.raises(DataError, match="match: expected linear RGB, found 3 bands of 465, 525, 630 nm"):
        match(load(tmp_path / "bands.astm", bands="keep"), budget="quick")
