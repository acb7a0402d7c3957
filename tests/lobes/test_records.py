"""Records of fits, and the files that hold them."""

import json
import math
import os

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
        ("lobes", "two", "fit 0: lobes: expected `int`, got `str`"),
        ("lobes", True, "fit 0: lobes: expected `int`, got `bool`"),
        ("lobes", [1], "fit 0: lobes: expected `int`, got `array`"),
        ("lobes", 2, "fit 0: lobes: expected 1, as parameters has, found 2"),
        ("error", "small", "fit 0: error: expected `float`, got `str`"),
        ("errors", {"rms": "small"}, r"fit 0: errors\[...\]: expected `float`, got `str`"),
        ("seed", [0], "fit 0: seed: expected `int | null`, got `array`"),
        ("at_bounds", "roughness", "fit 0: at_bounds: expected `array`"),
        ("at_bounds", ["a\nb"], r"fit 0: at_bounds: expected at most 200 printable characters, found 'a\\nb'"),
        ("outlier", 1, "fit 0: outlier: expected `bool | null`, got `int`"),
        ("loss", "\x1b[31m", r"fit 0: loss: expected at most 200 printable characters, found '\\x1b\[31m'"),
        ("model", ["ward"], "fit 0: model: expected `str`, got `array`"),
        ("model", "w" * 100_000, "fit 0: model: expected one of abc, .*, found 'www.* "),
        ("material", 7, "fit 0: material: expected `str`, got `int`"),
        ("material", None, "fit 0: material: expected `str`, got `null`"),
        ("material", "", "fit 0: material: expected a name .*, found ''"),
        ("material", "../../paint", "fit 0: material: expected a name .*, found '../../paint'"),
        ("material", "/etc/paint", "fit 0: material: expected a name"),
        ("material", "a\0b", "fit 0: material: expected a name"),
        ("material", "\x1b[31mred", "fit 0: material: expected a name"),
        ("material", "x" * 5000, "fit 0: material: expected a name"),
        ("parameters", [1], "fit 0: parameters: expected `object`, got `array`"),
        ("parameters", {}, "fit 0: parameters of ward: expected diffuse, roughness, specular, found none"),
        ("parameters", DULL | {"roughness": 0.1}, "roughness: expected a list with one value a lobe, found 0.1"),
        ("parameters", DULL | {"roughness": [0.1, 0.2]}, r"expected one value a lobe for each, found \[1, 2\] values"),
        ("parameters", DULL | {"roughness": ["0.1"]}, "roughness: expected 1 numbers of at most 1e.10, found '0.1'"),
        ("parameters", DULL | {"roughness": [None]}, "roughness: expected 1 numbers of at most 1e.10, found None"),
        ("parameters", DULL | {"roughness": [True]}, "roughness: expected 1 numbers of at most 1e.10, found True"),
        ("parameters", DULL | {"roughness": [10**400]}, "roughness: expected 1 numbers of at most 1e.10, found 1000"),
        ("parameters", DULL | {"diffuse": [1e300, 0, 0]}, "diffuse: expected 3 numbers of at most 1e.10"),
        ("parameters", DULL | {"diffuse": [0.1, 0.1]}, "diffuse: expected 3 numbers"),
        ("parameters", DULL | {"specular": [[0.1, [0.1], 0.1]]}, "specular: expected 3 numbers"),
        ("parameters", DULL | {"specular": [[[0.1, 0.1, 0.1]]]}, "specular: expected 3 numbers"),
        ("parameters", DULL | {"specular": [json.loads("[" * 900 + "]" * 900)]}, "specular: expected 3 numbers"),
        ("parameters", DULL | {"roughness": [0.0]}, "fit 0: parameters of ward: expected them within their bounds"),
        ("parameters", DULL | {"roughness": [1e-30]}, "fit 0: parameters of ward: expected them within their bounds"),
    ],
    ids=lambda value: None if isinstance(value, dict) else str(value)[:30].encode("unicode_escape").decode(),
)
def test_what_a_field_cannot_be_is_refused_in_a_line(tmp_path, key, value, said):
    values = {"material": "paint", "model": "ward", "lobes": 1, "parameters": DULL, key: value}
    path = tmp_path / "fits.json"
    path.write_text(json.dumps([values]))
    with pytest.raises(DataError, match=said.replace("| null", r"\| null")) as caught:
        read_fits(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and len(message) <= 300 and "\n" not in message


def test_values_outside_the_bounds_of_a_fit_are_kept(tmp_path):
    """Published fits have them; one number serves all channels."""
    values = DULL | {"roughness": [2.5], "specular": [3.0], "diffuse": -0.25}
    write_fits(tmp_path / "fits.json", [FitRecord("paint", "ward", 1, values)])
    lambert, lobe = model_of(read_fits(tmp_path / "fits.json")).components()
    assert lobe.roughness.tolist() == [[2.5]] and lobe.specular.tolist() == [[3.0] * 3]
    assert lambert.albedo.tolist() == [[-0.25] * 3]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3", "expected `array`, got `int`"),
        ("null", "expected `array`, got `null`"),
        ("{}", "expected `array`, got `object`"),
        ("[3]", "expected `object`, got `int`"),
        ("[]", "an empty one"),
        ("", "input data was truncated"),
        ("[NaN]", r"nan at `\$\[0\]`, where a finite number has to be"),
        ('[{"parameters": {"roughness": [0.1, NaN]}}]', r"nan at `\$\[0\].parameters.roughness\[1\]`, where a finite"),
        ('[{"a": "NaN", "error": 1}, {"error": -Infinity}]', r"-inf at `\$\[1\].error`, where a finite number"),
        ('[{"seed": 1' + "0" * 5000 + "}]", "integer value out of range"),
        ('[{"error": NaN]', "JSON is malformed"),
        ('[{"extra":' + "[" * 100_000, "JSON that is nested too deep"),
        ('[{"material": 1e999}]', r"inf at `\$\[0\].material`, where a finite number has to be"),
        ("\xff", "JSON is malformed"),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path, text, said):
    (tmp_path / "fits.json").write_text(text, encoding="latin-1")
    with pytest.raises(DataError, match=f"fits.json: expected a list of fits, found {said}"):
        read_fits(tmp_path / "fits.json")


def test_a_fifo_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "fits.json")
    with pytest.raises(DataError, match=r"fits\.json: expected a list of fits, found no regular file"):
        read_fits(tmp_path / "fits.json")


def test_fits_of_different_models_make_no_batch():
    one, two = FitRecord("paint", "ward", 1, DULL), read_fits(standins())[0]
    with pytest.raises(DataError, match=f"^{two.material}: expected lobes as paint has"):
        model_of([one, two])


@pytest.mark.parametrize(("name", "value"), [("roughness", 0.0), ("ior", 0.0)])
def test_values_that_are_not_finite_are_blamed_on_the_parameter_outside_its_bounds(tmp_path, name, value):
    coat = {"base_color": [0.5] * 3, "specular": 1.0, "roughness": 0.1, "ior": 1.5, name: value}
    fits = [{"material": "paint", "model": "roughplastic", "lobes": 1, "parameters": coat}]
    (tmp_path / "fits.json").write_text(json.dumps(fits))
    with pytest.raises(DataError, match=rf"fit 0: .* within their bounds, found {name} 0, not [0-9.]+ to"):
        read_fits(tmp_path / "fits.json")
