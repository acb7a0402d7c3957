"""`convert`: between all formats that can be written, with what was resampled and how near it is."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.listed_files import angles, astm, columns
from helpers.measured_files import anisotropic_bsdf, synthetic_bsdf, tensor_file, utia

import torchbrdf
from torchbrdf.cli import main
from torchbrdf.errors import DataError, TorchbrdfError, UsageError
from torchbrdf.export import EXPORTERS, Material, convert, export
from torchbrdf.export.convert import COMPARED, WITHIN, _differences, _read_back, compared_pairs, table_names
from torchbrdf.export.tables import TableExporter
from torchbrdf.lobes import GGX, FitRecord, GGXAnisotropic, Lambert, Sum, make_model, parameters, write_fits
from torchbrdf.lobes.in_bands import in_bands
from torchbrdf.measured import Astm, Measured, describe, load
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
    assert main(["convert", str(path), str(tmp_path / "plain.binary")]) == 0
    for out in ("kept.csv", "kept.ssdd"):
        assert main(["convert", str(path), str(tmp_path / out), "--bands", "keep"]) == 0
        again = load(tmp_path / out, settings={"bands": "keep"})
        assert again.wavelengths == (465.0, 525.0, 630.0)
    capsys.readouterr()
    assert main(["convert", str(path), str(tmp_path / "kept.binary"), "--bands", "keep"]) == 0
    said = capsys.readouterr().out
    assert "bands are not kept: the format holds linear RGB only" in said and "illuminant D65" in said
    kept, plain = (load(tmp_path / name, dtype=torch.float64) for name in ("kept.binary", "plain.binary"))
    pairs = compared_pairs(200)
    assert torch.allclose(kept.at(pairs), plain.at(pairs), rtol=0.02)  # bands are interpolated, or colours


def test_bands_of_a_fit_are_kept_where_that_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = Sum(in_bands(Lambert, 4)(albedo=0.2), in_bands(GGX, 4)(specular=[0.1, 0.2, 0.4, 0.8], roughness=0.3))
    lengths = [450.0, 525.0, 630.0, 700.0]
    record = FitRecord("laser", "ggx", 1, parameters(model), channels=4, wavelengths=lengths)
    write_fits(tmp_path / "fits.json", [record])
    pairs = compared_pairs(200)
    with torch.no_grad():
        expected = record.to_model()(pairs).double()
    for to in ("csv", "astm", "ssdd"):
        out = tmp_path / f"laser.{to}"
        assert main(["convert", str(tmp_path / "fits.json"), str(out), "--bands", "keep"]) == 0
        again = load(out, dtype=torch.float64, bands="keep")
        assert again.wavelengths == tuple(lengths)
        assert ((again.at(pairs) - expected).abs() / expected).median() < 0.01
    assert "bands are not kept" not in capsys.readouterr().out
    for to in ("binary", "bsdf"):
        assert main(["convert", str(tmp_path / "fits.json"), str(tmp_path / f"x.{to}"), "--bands", "keep"]) == 0
        assert "bands are not kept: the format holds linear RGB only" in capsys.readouterr().out


@pytest.mark.parametrize("to", sorted(FORMATS))
def test_bands_without_wavelengths_are_refused_by_the_name_of_their_file(
    to: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = make_model("ggx", 1, channels=5)
    write_fits(tmp_path / "fits.json", [FitRecord("five", "ggx", 1, parameters(model), channels=5)])
    out = tmp_path / "out" / f"five{EXPORTERS[to].suffix}"
    assert main(["convert", str(tmp_path / "fits.json"), str(out), "--bands", "keep"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and f"{tmp_path / 'fits.json'}: five: expected" in said and ".tmp" not in said
    assert "5 bands whose wavelengths nobody said" in said and "columns 465nm" in said and not out.exists()
    pairs = compared_pairs(200)
    measured = Measured.from_samples(pairs, torch.ones(1, len(pairs), 5), names=["five"])
    with pytest.raises(DataError, match=r"^five: expected linear RGB, one band, or bands whose wavelengths are known"):
        convert(measured, out)


def test_columns_that_are_counted_are_no_wavelengths(tmp_path: Path) -> None:
    path = tmp_path / "five.csv"
    path.write_text("theta_i,theta_o,phi,1,2,3,4,5\n10,20,180,1,2,3,4,5\n")
    with pytest.raises(DataError, match=r"five\.csv: expected r, g, b, or bands such as 465nm, .* found '1 2 3 4 5'"):
        load(path)


BRUSHED = GGXAnisotropic(roughness_x=0.15, roughness_y=0.4)


@pytest.fixture(scope="module")
def brushed_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What has a grain: a fit, tables and scattered samples."""
    folder = tmp_path_factory.mktemp("brushed")
    made = {name: folder / name for name in ("fits.json", "table.bin", "measured.bsdf", "samples.csv", "samples.astm")}
    write_fits(made["fits.json"], [FitRecord("brushed", "ggx_anisotropic", 1, parameters(Sum(Lambert(), BRUSHED)))])
    made["table.bin"].write_bytes(np.ascontiguousarray(utia(), "<f8").tobytes())
    fields = {name: one.astype("f4") if one.dtype.kind == "f" else one for name, one in anisotropic_bsdf().items()}
    made["measured.bsdf"].write_bytes(tensor_file(fields))
    convert(made["fits.json"], made["samples.csv"])
    convert(made["fits.json"], made["samples.astm"])
    return made


@pytest.mark.parametrize(
    ("source", "to"),
    [
        pytest.param(source, to, marks=[pytest.mark.slow] * (source.startswith("samples") and to in ("merl", "rgl")))
        for source in ("fits.json", "table.bin", "measured.bsdf", "samples.csv", "samples.astm")
        for to in sorted(FORMATS)
    ],
)
def test_a_grain_is_carried_or_it_is_said_that_it_is_not(
    source: str, to: str, brushed_files: dict[str, Path], tmp_path: Path
) -> None:
    (done,) = convert(brushed_files[source], tmp_path / f"x{EXPORTERS[to].suffix}")
    back = load(done.path)
    said = "the grain is left out: an isotropic table, of the mean over 12 azimuths of the surface" in done.notes
    is_carried = to in ("csv", "astm", "ssdd") or (source == "measured.bsdf" and to == "rgl")
    assert (back.is_anisotropic, said) == (is_carried, not is_carried)
    assert not any("grain is lost" in note for note in done.notes)
    assert done.median < 0.04


def test_a_file_with_comments_says_itself_whether_it_has_a_grain(tmp_path: Path) -> None:
    convert(GGXAnisotropic(roughness_x=0.30, roughness_y=0.31), tmp_path / "faint.csv")
    text = (tmp_path / "faint.csv").read_text()
    assert text.startswith("# grain: anisotropic\n") and load(tmp_path / "faint.csv").is_anisotropic
    (tmp_path / "faint.csv").write_text(text.replace("anisotropic", "isotropic", 1))
    assert not load(tmp_path / "faint.csv").is_anisotropic
    convert(GGXAnisotropic(roughness_x=0.30, roughness_y=0.31), tmp_path / "faint.astm")
    assert "\nCOMMENT grain: anisotropic\n" in (tmp_path / "faint.astm").read_text()
    assert load(tmp_path / "faint.astm").is_anisotropic


def test_what_was_read_in_another_way_is_not_copied(tmp_path: Path) -> None:
    (tmp_path / "paint.csv").write_text(columns())
    (done,) = convert(tmp_path / "paint.csv", tmp_path / "x.csv", settings={"quantity": "reflectance_factor"})
    before = load(tmp_path / "paint.csv", dtype=torch.float64, settings={"quantity": "reflectance_factor"})
    assert done.exact and done.high < 1e-3
    assert torch.allclose(load(done.path, dtype=torch.float64).values.amax(), before.values.amax(), rtol=1e-6)


def test_nothing_is_said_of_temporary_files_and_no_fact_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "in").mkdir()
    path = tmp_path / "in" / "twice.astm"
    path.write_text(astm(np.concatenate([angles(), angles()])))
    lines = path.read_text().splitlines()
    lines[-1] = ",".join([*lines[-1].split(",")[:4], "0.5", "0.5", "0.5"])
    path.write_text("\n".join(lines) + "\n")
    (tmp_path / "in" / "bad.astm").write_text(astm() + "garbage\n")
    for words in (
        ["convert", str(path), str(tmp_path / "x.csv")],
        ["convert", str(tmp_path / "in"), str(tmp_path / "out"), "--to", "ssdd"],
        ["convert", str(path), str(tmp_path / "x.ssdd"), "--bands", "keep"],
        ["fit", str(path), "--loss", "rms", "--lobes", "1", "--out", str(tmp_path / "fits")],
        ["fit", str(path), "--loss", "rms", "--lobes", "1", "--bands", "keep"],
        ["compare", str(path), str(path), "--size", "24", "--read", "angles=radians"],
        ["info", str(path)],
    ):
        caplog.clear()
        main(words)
        said = [record.getMessage() for record in caplog.records]
        assert sum("repeated directions" in line for line in said) == 1, words
        assert len(set(said)) == len(said) and not any(".tmp" in line for line in said), words
        assert ".tmp" not in capsys.readouterr().err


@pytest.mark.parametrize("words", [["fit", "--loss", "rms", "--lobes", "1"], ["compare", "--size", "24"], ["convert"]])
def test_each_file_is_read_once(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Path] = []
    parse = Astm.parse

    def counted(self: Astm, path: Path):  # type: ignore[no-untyped-def]
        read.append(path)
        return parse(self, path)

    monkeypatch.setattr(Astm, "parse", counted)
    paths = [tmp_path / name for name in ("a.astm", "b.astm", "c.astm")]
    for path in paths:
        path.write_text(astm())
    paths[1].write_text(astm() + "garbage\n")
    files = [str(path) for path in paths] if words[0] != "convert" else [str(tmp_path), str(tmp_path / "out")]
    rest = ["--to", "csv"] if words[0] == "convert" else []
    for bands in ([], ["--bands", "keep"]) if words[0] != "compare" else ([], ["--read", "illuminant=E"]):
        read.clear()
        assert main([words[0], *files, *words[1:], *rest, *bands]) == 1
        assert sorted(read) == paths, bands


def test_files_of_one_name_are_all_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "in"
    source.mkdir()
    (source / "ok.csv").write_text(columns())
    (source / "ok.astm").write_text(astm())
    write_fits(source / "fits.json", [FitRecord("ok", "ggx", 1, parameters(PAINT))])
    for to, suffix in (("merl", "binary"), ("csv", "csv")):
        assert main(["convert", str(source), str(tmp_path / to), "--to", to]) == 0
        assert sorted(one.name for one in (tmp_path / to).iterdir()) == [
            f"ok-2.{suffix}", f"ok-3.{suffix}", f"ok.{suffix}",
        ]  # fmt: skip
        said = capsys.readouterr().out
        for path in (source / "ok.csv", source / "ok.astm"):
            assert f", read from {path}: ok is the name of 2 others, too" in said


def test_a_file_that_is_replaced_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "paint.csv").write_text(columns())
    out = tmp_path / "x.astm"
    assert main(["convert", str(tmp_path / "paint.csv"), str(out)]) == 0
    assert capsys.readouterr().err == ""
    assert main(["convert", str(tmp_path / "paint.csv"), str(out)]) == 0
    assert capsys.readouterr().err == f"torchbrdf: replaced 1 file that was there: {out}\n"


def test_no_fits_that_are_converted_are_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fits.json"
    write_fits(path, [FitRecord("three", "ggx", 1, parameters(PAINT))])
    assert main(["convert", str(path), str(path), "--to", "csv"]) == 1
    assert "expected another file than one that is converted" in capsys.readouterr().err
    assert load(path).names == ["three"]


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
