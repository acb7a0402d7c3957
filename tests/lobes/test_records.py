"""Records of fits, and the files that hold them."""

import json
import math

import pytest

from torchbrdf.errors import DataError
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, model_of, parameters, read_fits, write_fits
from torchbrdf.measured import standins

DULL = parameters(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.1, roughness=0.4)))


def test_a_record_survives_its_file_with_what_nobody_knows(tmp_path):
    record = FitRecord(
        "paint", "ward", 1, DULL, loss="rms", strategy="global", error=0.25, samples=None, outlier=False,
        errors={"rms": 0.25, "log": math.inf}, pictures={"training": {"psnr": 30.0}}, extra={"camera": [1, None]},
    )  # fmt: skip
    write_fits(tmp_path / "fits.json", [record])
    (values,) = json.loads((tmp_path / "fits.json").read_text())
    assert values["samples"] is None and values["subset_error"] is None and values["errors"]["log"] is None
    assert "differences" not in values and "scene" not in values and values["camera"] == [1, None]
    (again,) = read_fits(tmp_path / "fits.json")
    assert math.isnan(again.subset_error) and math.isnan(again.errors["log"]) and again.extra == record.extra
    write_fits(tmp_path / "again.json", [again])
    assert (tmp_path / "again.json").read_text() == (tmp_path / "fits.json").read_text()


def test_a_stand_in_says_no_more_than_it_knows():
    record = FitRecord("paint", "ward", 1, DULL)
    assert record.to_json() == {"material": "paint", "model": "ward", "lobes": 1, "parameters": DULL}


def test_older_files_load_and_are_written_as_they_are():
    records = read_fits(standins())
    assert [record.to_json() for record in records] == json.loads(standins().read_text())
    assert {len(value) for value in model_of(records).parameters()} == {10}


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("lobes", "two", "fit 0: lobes: expected a whole number, found 'two'"),
        ("lobes", True, "fit 0: lobes: expected a whole number"),
        ("error", "small", "fit 0: error: expected a number or null"),
        ("material", 7, "fit 0: material: expected text, found '7'"),
        ("parameters", [1], "fit 0: parameters: expected an object"),
        ("at_bounds", "roughness", "fit 0: at_bounds: expected a list"),
        ("outlier", 1, "fit 0: outlier: expected true or false"),
    ],
)
def test_what_a_field_cannot_be_is_refused_in_a_line(tmp_path, key, value, said):
    values = {"material": "paint", "model": "ward", "lobes": 1, "parameters": DULL, key: value}
    path = tmp_path / "fits.json"
    path.write_text(json.dumps([values]))
    with pytest.raises(DataError, match=said) as caught:
        read_fits(path)
    assert str(caught.value).startswith(f"{path}: fit 0")


@pytest.mark.parametrize(("text", "said"), [("3", "found int"), ("{}", "found dict of 0"), ("[3]", "found list of 1")])
def test_a_file_of_something_else_is_refused(tmp_path, text, said):
    (tmp_path / "fits.json").write_text(text)
    with pytest.raises(DataError, match=f"expected a list of fits, {said}"):
        read_fits(tmp_path / "fits.json")


def test_fits_of_different_models_make_no_batch():
    one, two = FitRecord("paint", "ward", 1, DULL), read_fits(standins())[0]
    with pytest.raises(DataError, match=f"^{two.material}: expected lobes as paint has"):
        model_of([one, two])
