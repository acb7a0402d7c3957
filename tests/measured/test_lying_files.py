"""Files that say one thing and hold another: what is wrong is said of the format that they are of."""

import re
import struct
from pathlib import Path

import pytest
import torch
from helpers.listed_files import alta, angles, astm, columns, cornell, ssdd, zemax
from helpers.measured_files import synthetic_bsdf, tensor_file

from torchbrdf.errors import DataError
from torchbrdf.measured import FORMATS, describe, load
from torchbrdf.measured.find import find_files


def refused(path: Path, data: str | bytes) -> str:
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    with pytest.raises(DataError) as error:
        load(path)
    assert str(error.value).startswith(f"{path}: ") and len(str(error.value)) <= 300
    return str(error.value).removeprefix(f"{path}: ")


def same_values(one: Path, other: Path) -> bool:
    first, second = (load(path, dtype=torch.float64) for path in (one, other))
    return torch.equal(first.values, second.values) and torch.allclose(first.pairs.wi, second.pairs.wi)


@pytest.mark.parametrize("head", [
    "# num wls 4\n# wls 400 500 600 700\n",
    "# num wls: 4 # wls: 400 500 600 700\n",
    "#num wls 4\n#wls 400 500 600 700\n",
])  # fmt: skip
def test_a_header_of_cornells_on_one_line_is_read(head: str, tmp_path: Path) -> None:
    whole = cornell()
    (tmp_path / "plain.brdf").write_text(whole)
    (tmp_path / "short.brdf").write_text(head + whole[whole.index("# theta i") :])
    assert describe(tmp_path / "short.brdf")["format"] == "cornell"
    assert "on the lines of their comments" in describe(tmp_path / "short.brdf")["mended"]
    assert same_values(tmp_path / "plain.brdf", tmp_path / "short.brdf")


def test_what_a_header_of_cornells_lacks_is_said(tmp_path: Path) -> None:
    path = tmp_path / "x.brdf"
    assert refused(path, cornell().replace("# wls\n", "\n")) == "expected a line '# wls', found none"
    assert refused(path, cornell().replace("# num wls\n4", "# num wls four")).startswith("# num wls: expected a count")
    assert refused(path, cornell().replace("# num wls\n4", "# num wls 5")).startswith("# wls: expected 5 growing")


@pytest.mark.parametrize(("before", "after", "said"), [
    ("PlaneSymmetrical", "Round", "Symmetry: expected PlaneSymmetrical, ASymmetrical, ASymmetrical4D, found 'Round'"),
    ("Monochrome\nScatter", "Spectrum\nScatter", "SpectralContent: expected Monochrome, XYZ, found 'Spectrum'"),
    ("ScatterType\tBRDF", "ScatterType\tBTDF", "ScatterType: expected BRDF, found 'BTDF'"),
    ("ScatterType\tBRDF\n", "", "ScatterType: expected BRDF, found ''"),
    ("Symmetry\tPlaneSymmetrical\n", "", "Symmetry: expected PlaneSymmetrical, ASymmetrical, ASymmetrical4D, found ''"),
    ("DataEnd\n", "DataEnd\ngarbage", "expected the file's end behind the last DataEnd, found 'garbage'"),
])  # fmt: skip
def test_what_is_wrong_in_a_zemax_file_is_said_alone(before: str, after: str, said: str, tmp_path: Path) -> None:
    text = zemax()
    assert before in text
    assert refused(tmp_path / "x.bsdf", text.replace(before, after)) == said


def test_semicolons_in_astm_are_read_and_said(tmp_path: Path) -> None:
    (tmp_path / "plain.astm").write_text(astm())
    head, mark, rows = astm().partition("\n\n0")
    texts = {
        "rows": head + mark + rows.replace(",", ";"),
        "all": astm().replace(",", ";"),
        "keys": astm().replace(",", ";").replace("VARS ", "VARS;").replace("NUM_POINTS ", "NUM_POINTS;"),
        "decimal": astm().replace(",", ";").replace(".", ","),
    }
    for name, text in texts.items():
        path = tmp_path / f"{name}.astm"
        path.write_text(text)
        assert describe(path)["mended"].startswith("semicolons between columns"), name
        assert same_values(tmp_path / "plain.astm", path), name


def test_decimal_commas_are_found_behind_a_row_of_whole_numbers(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("theta_i;theta_o;phi;f\n10;20;180;1\n10;30;180;0,5\n")
    assert load(path, dtype=torch.float64).values[0, :, 0].tolist() == [1.0, 0.5]
    assert describe(path)["mended"] == "decimal commas"


@pytest.mark.parametrize("binary", [False, True])
def test_what_stands_behind_an_ssdd_file_is_refused(binary: bool, tmp_path: Path) -> None:
    data = ssdd(binary=binary)
    data = data if isinstance(data, bytes) else data.encode()
    path = tmp_path / "x.ssdd"
    said = "expected the file's end or another block behind the values, found 8 bytes that begin with 'garbage'"
    assert refused(path, data + b"\ngarbage\n"[1 - binary :]).replace("9 bytes", "8 bytes") == said
    assert "behind the values" in refused(path, data + b"1 2 3\n")
    path.write_bytes(data + b"\n# a comment\n\nDATA_TYPE specular_reflectance\n")
    assert describe(path)["passed over"] == "specular_reflectance"


def test_versions_of_ssdd(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "x.ssdd"
    for version in ("9.7", "two", ""):
        assert refused(path, ssdd().replace("VERSION 0.2", f"VERSION {version}")).startswith(
            f"VERSION: expected 0.2, found '{version}'"
        )
    path.write_text(ssdd().replace("VERSION 0.2", "VERSION 0.3"))
    assert describe(path)["version"] == "0.3, which is read as 0.2" in caplog.text


@pytest.mark.parametrize("name", ["tensor_file", "alta"])
def test_what_stands_behind_a_binary_file_is_refused(name: str, tmp_path: Path) -> None:
    data = tensor_file(synthetic_bsdf()) if name == "tensor_file" else alta(order="little")
    path = tmp_path / "x.bsdf"
    path.write_bytes(data)
    load(path)
    for rest in (b"\n" * 30 + b"garbage", bytes(100), b"x"):
        assert refused(path, data + rest).startswith("expected ")


def test_a_table_of_utia_with_another_size_is_said(tmp_path: Path) -> None:
    said = refused(tmp_path / "x.bin", struct.pack("<d", 0.5) * 1000)
    assert said.endswith("found a .bin of 8000 bytes, and not the 1990656 of a UTIA table")


def test_values_that_are_too_large_are_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    lines = columns().splitlines()
    lines[7] = ",".join([*lines[7].split(",")[:3], "1e300", "1", "1"])
    lines[9] = ",".join([*lines[9].split(",")[:3], "1", "inf", "1"])
    path = tmp_path / "x.csv"
    path.write_text("\n".join(lines) + "\n")
    said = f"2 whose values are above 1e+08 / sr, of {len(angles())} samples"
    assert describe(path)["left out"] == said and f"{path}: left out: {said}" in caplog.text
    assert load(path).weight.sum() == len(angles()) - 2


def test_samples_that_are_none_are_said_by_kind(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    lines = columns().splitlines()
    for row, (place, value) in {7: (3, "nan"), 8: (1, "95"), 9: (1, "169"), 10: (1, "90")}.items():
        cells = lines[row].split(",")
        lines[row] = ",".join([*cells[:place], value, *cells[place + 1 :]])
    path = tmp_path / "x.csv"
    path.write_text("\n".join(lines) + "\n")
    said = "2 whose light or viewer is below the horizon, 1 at the horizon, 1 without a value"
    whole = f"{said}, of {len(angles())} samples"
    assert describe(path)["left out"] == whole and f"{path}: left out: {whole}" in caplog.text
    caplog.clear()
    lines = columns().splitlines()
    lines[10] = ",".join([lines[10].split(",")[0], "90", *lines[10].split(",")[2:]])
    path.write_text("\n".join(lines) + "\n")
    assert describe(path)["left out"] == f"1 at the horizon, of {len(angles())} samples"
    assert "left out" not in caplog.text  # where a BRDF has no value, and many instruments have a row


def test_a_sign_that_was_lost_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    lines = columns().splitlines()
    lines[2::4] = [",".join([*line.split(",")[:3], *(f"-{v}" for v in line.split(",")[3:])]) for line in lines[2::4]]
    path = tmp_path / "x.csv"
    path.write_text("\n".join(lines) + "\n")
    load(path)
    assert re.search(r"x\.csv: 2[456]\.?\d? % of the samples are below 0, as no reflectance is", caplog.text)


def test_another_count_of_rows_than_the_header_has_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "x.astm"
    path.write_text(astm(points=7))
    load(path)
    assert f"rows: {len(angles())}, and the header says '7'; the rows were believed" in caplog.text


def test_a_folder_is_looked_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.dat").write_text(astm())
    looked: list[Path] = []
    own = __import__("torchbrdf.measured.find", fromlist=["_head"])._head
    monkeypatch.setattr("torchbrdf.measured.find._head", lambda path: looked.append(path) or own(path))
    assert len(find_files(tmp_path)) == 2 and load(tmp_path).names == ["a", "b"]
    assert sorted(looked) == sorted(tmp_path.iterdir())
    (tmp_path / "a.dat").write_text(columns())
    assert load(tmp_path / "a.dat").values.isfinite().all()


@pytest.mark.parametrize("name", ["x.astm", "x.bsdf", "x.csv"])
def test_text_in_utf_16_is_said_to_be_that(name: str, tmp_path: Path) -> None:
    text = {"x.astm": astm(), "x.bsdf": zemax(), "x.csv": columns()}[name]
    assert refused(tmp_path / name, text.encode("utf-16")).endswith(
        "text in UTF-16, or nothing known: save it as UTF-8"
    )


def test_repetitions_with_the_same_values_are_no_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "twice.csv"
    text = columns()
    path.write_text(text + "\n".join(text.splitlines()[2:]) + "\n")
    plain = tmp_path / "once.csv"
    plain.write_text(text)
    said = f"{2 * len(angles())} samples at {len(angles())} places, with the same values"
    assert describe(path)["repeated directions"] == said and "repeated" not in caplog.text
    pairs = load(plain).pairs
    assert torch.equal(load(path).at(pairs), load(plain).at(pairs))


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_format_says_what_it_was_told(name: str) -> None:
    assert FORMATS[name].told == {}
