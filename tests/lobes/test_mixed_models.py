"""Models of several kinds of lobes: by name, as numbers, in files, and fitted."""

from pathlib import Path

import pytest
import torch
from helpers.known_models import measured_from, some_pairs

from torchbrdf import fit
from torchbrdf.cli import main
from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.fitting.result import fits_csv
from torchbrdf.lobes import (
    GGX,
    FitRecord,
    Lambert,
    OrenNayar,
    Sum,
    Ward,
    from_parameters,
    make_model,
    model_name,
    parameters,
    read_fits,
    write_fits,
)
from torchbrdf.losses import CompressedLoss

MIXED = Sum(
    OrenNayar(albedo=[0.3, 0.2, 0.1], roughness=0.4, dtype=torch.float64),
    GGX(specular=0.3, roughness=0.2, f0=0.5, dtype=torch.float64),
    Ward(specular=[0.1, 0.2, 0.3], roughness=0.05, dtype=torch.float64),
)


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("ggx+ward", [Lambert, GGX, Ward]),
        ("oren_nayar+ggx+ggx", [OrenNayar, GGX, GGX]),
        ("ggx+oren_nayar", [OrenNayar, GGX]),
        ("lambert+ward", [Lambert, Ward]),
        ("ward", [Lambert, Ward, Ward]),
    ],
)
def test_a_name_says_what_the_components_are(name: str, kinds: list[type]) -> None:
    model = make_model(name)
    assert [type(one) for one in model.components()] == kinds
    again, lobes = model_name(model)
    assert lobes == len(kinds) - 1
    assert [type(one) for one in make_model(again, lobes).components()] == kinds


@pytest.mark.parametrize(
    ("name", "lobes", "message"),
    [
        ("lambert", None, "model: expected a specular lobe, found lambert"),
        ("oren_nayar+lambert+ward", None, "model: expected one diffuse term, found"),
        ("lambert+eon", None, "expected a specular lobe"),
        ("ggx+ward", 3, "lobes: expected 2, as ggx\\+ward has, found 3"),
        ("ggx", 0, "lobes: expected at least 1, found 0"),
        ("ggx+", None, "lobe: expected a name, found ''"),
        ("ggx+paint", None, "unknown lobe 'paint'"),
    ],
)
def test_other_names_are_refused(name: str, lobes: int | None, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        make_model(name, lobes)


def test_numbers_and_back() -> None:
    values = parameters(MIXED)
    assert values["diffuse"] == [0.3, 0.2, 0.1] and values["diffuse_roughness"] == 0.4
    assert values["roughness"] == [0.2, 0.05] and values["f0"] == [0.5, None]
    name, lobes = model_name(MIXED)
    assert (name, lobes) == ("oren_nayar+ggx+ward", 2)
    again = from_parameters(name, values, torch.float64)
    pairs = some_pairs(50)
    torch.testing.assert_close(again(pairs), MIXED(pairs), rtol=0, atol=0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"f0": [0.5, 0.5]}, "f0: expected null for ward, found 0.5"),
        ({"f0": [None, None]}, "f0: expected 1 numbers"),
        ({"roughness": [0.2]}, r"expected 2 values, found \[1, 2\]"),
        ({"diffuse_roughness": "rough"}, "diffuse_roughness: expected 1 numbers"),
        ({"sheen": [0.2, 0.1]}, "expected diffuse, diffuse_roughness"),
    ],
)
def test_wrong_numbers_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(DataError, match=message):
        from_parameters("oren_nayar+ggx+ward", parameters(MIXED) | changes)


def test_files(tmp_path: Path) -> None:
    record = FitRecord("paint", "oren_nayar+ggx+ward", 2, parameters(MIXED))
    write_fits(tmp_path / "fits.json", [record])
    assert read_fits(tmp_path / "fits.json") == [record]
    header, row = fits_csv([record]).splitlines()
    cells = dict(zip(header.split(","), row.split(","), strict=True))
    assert cells["model"] == "oren_nayar+ggx+ward" and float(cells["roughness_1"]) == 0.05
    with pytest.raises(TorchbrdfError, match="lobes: expected 2"):
        FitRecord.from_json(record.to_json() | {"lobes": 1})
    with pytest.raises(TorchbrdfError, match="found 'paint'"):
        FitRecord.from_json(record.to_json() | {"model": "oren_nayar+paint"})


def test_a_fit_finds_its_parameters() -> None:
    measured = measured_from(MIXED, some_pairs(4000))
    result = fit(make_model("oren_nayar+ggx+ward", dtype=torch.float64), measured, CompressedLoss(), diffuse="fit")
    assert result.error.item() < 1e-5
    found = result.records()[0].parameters
    for name, expected in parameters(MIXED).items():
        if name not in ("specular", "f0"):  # of which only the product counts, nearly
            close(found[name], expected)


def close(found: object, expected: object) -> None:
    pairs = zip(found, expected, strict=True) if isinstance(found, list) and isinstance(expected, list) else []
    for one, other in pairs:
        assert one == pytest.approx(other, rel=0.02) if other is not None else one is None
    if not isinstance(found, list):
        assert found == pytest.approx(expected, rel=0.02)


def test_a_model_with_a_colour_that_is_no_factor_is_fitted_too() -> None:
    truth = make_model("eon+ggx", dtype=torch.float64)
    measured = measured_from(truth, some_pairs(500))
    model = make_model("eon+ggx", dtype=torch.float64)
    model.components()[0].albedo = 0.2
    assert fit(model, measured, CompressedLoss(), diffuse="fit", samples=None).error.item() < 1e-3


def test_the_measured_albedo_is_lamberts(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="diffuse: expected fit for OrenNayar, found 45:0"):
        fit(make_model("oren_nayar+ward"), measured_from(MIXED), CompressedLoss(), diffuse="45:0")


def test_the_command_takes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_fits(tmp_path / "paint.json", [FitRecord("paint", "oren_nayar+ggx+ward", 2, parameters(MIXED))])
    command = ["fit", str(tmp_path / "paint.json"), "--model", "ggx+ward", "--samples", "500", "--diffuse", "fit"]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    (record,) = read_fits(tmp_path / "out" / "fits.json")
    assert (record.model, record.lobes) == ("ggx+ward", 2)
    assert main([*command, "--lobes", "3"]) == 2
    assert "lobes: expected 2, as ggx+ward has, found 3" in capsys.readouterr().err
