"""`convert`: between all formats that can be written, with what was resampled and how near it is."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.listed_files import angles, astm, columns
from helpers.measured_files import synthetic_bsdf, tensor_file

import torchbrdf
from torchbrdf.cli import main
from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.export import EXPORTERS, Material, convert, export
from torchbrdf.export.convert import COMPARED, WITHIN, _differences, _read_back, compared_pairs, table_names
from torchbrdf.export.tables import TableExporter
from torchbrdf.lobes import GGX, FitRecord, Lambert, Sum, parameters, write_fits
from torchbrdf.measured import Measured, describe, load
from torchbrdf.pairs import Pairs

PAINT = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=[0.4, 0.4, 0.3], roughness=0.15))
FORMATS = {"astm": "astm", "csv": "columns", "merl": "merl", "rgl": "rgl", "ssdd": "ssdd"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The paint in every format."""
    folder = tmp_path_factory.mktemp("paint")
    return {name: export(PAINT, name, folder, name="paint").files[0] for name in FORMATS}


def test_every_table_is_a_format_that_is_read(files: dict[str, Path]) -> None:
    assert set(FORMATS) == set(table_names())
    for name, path in files.items():
        assert describe(path)["format"] == FORMATS[name] and path.suffix == EXPORTERS[name].suffix


@pytest.mark.parametrize("to", sorted(FORMATS))
@pytest.mark.parametrize("source", sorted(FORMATS))
def test_from_every_format_to_every_other(source: str, to: str, files: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / f"made{EXPORTERS[to].suffix}"
    (done,) = convert(files[source], out)
    assert (done.material, done.path, done.to) == ("paint", out, to) and out.is_file()
    assert done.samples > 10_000 and done.extrapolated is not None
    assert done.extrapolated < 0.02 * done.samples
    same = source == to or (source in ("astm", "csv", "ssdd") and to in ("astm", "csv"))
    assert done.exact == same
    # Of samples that are equally near, rounding chooses.
    assert done.median < (1e-3 if same else 0.01) and done.high < (0.01 if same else 0.1)
    pairs = compared_pairs(500).to(dtype=torch.float32)
    with torch.no_grad():
        expected = PAINT(pairs)
    off = ((load(out).at(pairs) - expected).abs() / expected).median()
    assert off < 0.015


def test_merl_to_rgl_to_merl(files: dict[str, Path], tmp_path: Path) -> None:
    convert(files["merl"], tmp_path / "there.bsdf")
    convert(tmp_path / "there.bsdf", tmp_path / "back.binary")
    pairs = compared_pairs()
    expected, found = (load(path, dtype=torch.float64).at(pairs) for path in (files["merl"], tmp_path / "back.binary"))
    assert ((found - expected).abs() / expected).median() < 0.01


def test_samples_stay_what_they_are(tmp_path: Path) -> None:
    path = tmp_path / "paint.astm"
    path.write_text(astm())
    (done,) = convert(path, tmp_path / "paint.csv")
    before, after = (load(one, dtype=torch.float64) for one in (path, done.path))
    assert done.exact and done.notes == [f"its own {done.samples} samples"] and not done.extrapolated
    good = before.weight[0, :, 0] > 0
    assert torch.allclose(after.values[0], before.values[0, good], rtol=1e-7, atol=0)
    for way in ("wi", "wo"):
        assert torch.allclose(getattr(after.pairs, way)[0], getattr(before.pairs, way)[0, good], atol=1e-7)


def test_what_was_never_measured_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "few.csv"
    rows = angles(lights=(0, 20))
    path.write_text(columns(rows[rows[:, 2] <= 40]))
    (done,) = convert(path, tmp_path / "few.ssdd")
    assert done.extrapolated is not None and 0.3 * done.samples < done.extrapolated < done.samples
    assert any(line.endswith(f"{done.extrapolated} extrapolated") for line in done.lines())


def test_settings_of_readers_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "paint.csv"
    path.write_text(columns())
    (done,) = convert(path, tmp_path / "paint.astm", settings={"quantity": "reflectance_factor"})
    plain = load(path, dtype=torch.float64).values
    assert load(done.path, dtype=torch.float64).values.amax() == pytest.approx(plain.amax().item() / np.pi, rel=1e-6)


@pytest.mark.parametrize("to", ["astm", "csv", "ssdd"])
@pytest.mark.parametrize("bands", [(465.0, 525.0, 630.0, 700.0), None])
def test_bands_keep_their_wavelengths(bands: tuple[float, ...] | None, to: str, tmp_path: Path) -> None:
    pairs = compared_pairs(800)
    with torch.no_grad():
        level = GGX(roughness=0.3, dtype=torch.float64)(pairs)[..., :1]
    values = level * torch.tensor([1.0, 0.8, 0.6, 0.4] if bands else [1.0], dtype=torch.float64)
    measured = Measured.from_samples(pairs, values, names=["bands"], wavelengths=bands)
    path = EXPORTERS[to]().write_file(Material("bands", measured), tmp_path / "bands").files[0]
    text = path.read_text()
    back = _read_back(path, measured)
    assert _differences(measured, back)[0] < 0.05
    if bands:
        assert ("465 525 630 700" if to == "ssdd" else "465nm,525nm,630nm,700nm") in text
    else:
        assert {"ssdd": "COLOR_MODEL monochrome", "csv": "phi_o,f\n", "astm": "phi_s,brdf\n"}[to] in text


def test_bands_of_a_file_are_kept_where_that_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "paint.astm"
    path.write_text(astm())
    for out in ("kept.csv", "kept.ssdd"):
        assert main(["convert", str(path), str(tmp_path / out), "--bands", "keep"]) == 0
        again = load(tmp_path / out, settings={"bands": "keep"})
        assert again.wavelengths == (465.0, 525.0, 630.0)
    assert main(["convert", str(path), str(tmp_path / "kept.binary"), "--bands", "keep"]) == 1
    assert "expected linear RGB" in capsys.readouterr().err


def test_a_folder_becomes_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    (source / "one.astm").write_text(astm())
    (source / "two.csv").write_text(columns())
    (source / "bad.astm").write_text(astm()[:400])
    write_fits(source / "fits.json", [FitRecord("three", "ggx", 1, parameters(PAINT))])
    assert main(["convert", str(source), str(out), "--to", "csv"]) == 1
    said = capsys.readouterr()
    assert sorted(path.name for path in out.iterdir()) == ["one.csv", "three.csv", "two.csv"]
    assert said.err.count("\n") == 1 and "left out" in said.err and "bad.astm" in said.err
    assert "one: exact" in said.out and "samples of a model: nothing is extrapolated" in said.out
    assert said.out.count("read back, within 75 degrees of the normal: relative difference") == 3


def test_no_file_that_is_converted_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "one.astm").write_text(astm())
    (tmp_path / "one.csv").write_text(columns())
    before = (tmp_path / "one.csv").read_bytes()
    assert main(["convert", str(tmp_path), str(tmp_path), "--to", "csv"]) == 1
    assert (tmp_path / "one.csv").read_bytes() == before
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "one.csv: expected another file than one that is converted" in said


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["paint.csv", "paint.txt"], 2, "expected a file that ends with .astm, .csv, .binary, .bsdf, .ssdd, or --to"),
        (["paint.csv", "paint"], 2, "or --to, found paint"),
        (["paint.csv", "paint.xml", "--to", "mitsuba"], 2, "expected one of astm, csv, merl, rgl, ssdd, found mitsuba"),
        (["paint.csv", "paint.xml", "--to", "cvs"], 2, "unknown exporter 'cvs'"),
        (["paint.csv", "paint.csv"], 1, "expected another file than one that is converted, found the same"),
        (["nowhere.csv", "paint.astm"], 1, "nowhere.csv: no such file or folder"),
        (["two", "paint.astm"], 2, "expected a folder for 2 materials, found paint.astm; say --to"),
        (["paint.csv", "paint.csv/x.astm"], 1, "paint.csv"),
        (["paint.csv", "two", "--to", "astm", "--read", "angles=grad"], 2, "unknown angles 'grad'"),
        (["", "x.csv"], 1, "found an empty one"),
    ],
)
def test_bad_usage_is_one_line(
    arguments: list[str], status: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("two").mkdir()
    for name in ("paint.csv", "two/a.csv", "two/b.csv"):
        Path(name).write_text(columns(angles(30)))
    before = sorted(str(path) for path in tmp_path.rglob("*"))
    assert main(["convert", *arguments]) == status
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and printed.err.startswith("torchbrdf: ") and said in printed.err
    assert sorted(str(path) for path in tmp_path.rglob("*")) == before


def test_a_file_that_cannot_be_read_back_is_not_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Wrong(TableExporter):
        """Writes what nobody reads."""

        suffix = ".wrong"

        def write_file(self, material, path):  # type: ignore[no-untyped-def]
            path.write_text("nothing")
            return torchbrdf.export.Exported([path], True, [], material.brdf)

    len(EXPORTERS)
    monkeypatch.setitem(EXPORTERS._things, "wrong", Wrong)
    with pytest.raises(DataError, match=r"made\.wrong: expected a measured BRDF") as error:
        convert(PAINT, tmp_path / "made.wrong")
    assert ".tmp-" not in str(error.value) and not list(tmp_path.iterdir())


def test_a_measured_of_several_and_a_sequence(tmp_path: Path) -> None:
    pairs = compared_pairs(300)
    measured = Measured.from_samples(pairs, torch.rand(2, len(pairs), 3) + 0.1, names=["a", "A"])
    done = torchbrdf.convert([measured, GGX(roughness=0.4)], tmp_path / "all", "csv")
    assert [one.path.name for one in done] == ["a.csv", "A-2.csv", "material.csv"]
    assert json.loads(json.dumps(done[0].to_dict()))["samples"] == len(pairs)
    with pytest.raises(UsageError, match="expected at least one material, found none"):
        convert([], tmp_path / "none.csv")
    with pytest.raises(TorchbrdfError):
        convert(None, tmp_path / "none.csv")  # type: ignore[arg-type]


def test_small_angles_are_written_in_radians(tmp_path: Path) -> None:
    """Whoever reads them would take degrees for radians."""
    angle = torch.full((1, 40), 0.01, dtype=torch.float64)
    pairs = Pairs.from_half_diff(angle, angle, torch.linspace(0, 3, 40, dtype=torch.float64)[None])
    measured = Measured.from_samples(pairs, torch.ones(1, 40, 3, dtype=torch.float64), names=["dot"])
    (done,) = convert(measured, tmp_path / "dot.csv")
    again = load(done.path, dtype=torch.float64)
    assert torch.allclose(again.pairs.cos_i, pairs.cos_i, rtol=0, atol=1e-12)


def test_pairs_that_are_compared() -> None:
    pairs = compared_pairs()
    assert 0.8 * COMPARED < len(pairs) <= COMPARED
    lowest = np.cos(np.radians(WITHIN)) - 1e-9
    assert (pairs.cos_i >= lowest).all() and (pairs.cos_o >= lowest).all()
    assert (pairs.theta_h < np.radians(5)).double().mean() > 0.1
    assert (pairs.phi_d > 0).any() and not torch.equal(compared_pairs(seed=1).cos_i, pairs.cos_i)


def test_an_rgl_file_of_its_own_stays(tmp_path: Path) -> None:
    path = tmp_path / "made.bsdf"
    path.write_bytes(tensor_file(synthetic_bsdf()))
    (done,) = convert(path, tmp_path / "again.bsdf")
    assert done.exact and done.path.read_bytes() == path.read_bytes()
