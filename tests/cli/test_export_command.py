"""`torchbrdf export`."""

import json
from pathlib import Path

import pytest

from torchbrdf.cli import main
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, parameters, write_fits

PAINT = parameters(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.0, roughness=0.2)))
METAL = parameters(Sum(Lambert(albedo=[0.1, 0.1, 0.1]), Ward(specular=0.0, roughness=0.1)))


@pytest.fixture
def fits(tmp_path: Path) -> Path:
    """Two fits of paint, and one of metal."""
    records = [
        FitRecord("paint", "ward", 1, PAINT, loss="rms", strategy="global"),
        FitRecord("paint", "ward", 1, PAINT, loss="log", strategy="global"),
        FitRecord("metal", "ward", 1, METAL, loss="log", strategy="global"),
    ]
    write_fits(tmp_path / "fits.json", records)
    return tmp_path / "fits.json"


def run(*arguments: object) -> int:
    return main(["export", *map(str, arguments)])


def test_all_fits_of_a_file_have_names_of_their_own(fits: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = fits.parent / "out"
    assert run(fits, "--to", "mitsuba", "--out", out) == 0
    names = ["paint-ward-1-rms", "paint-ward-1-log", "metal"]
    assert sorted(path.stem for path in out.iterdir()) == sorted(names)
    said = capsys.readouterr().out.splitlines()
    for k, name in enumerate(names):
        assert said[3 * k : 3 * k + 3] == [
            f"{out / name}.xml  {name}: exact",
            "  exact: Mitsuba's diffuse",
            "  the same picture",
        ]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--loss", "log"], {"paint", "metal"}),
        (["--material", "paint", "--loss", "rms"], {"paint"}),
        (["--material", "metal", "--model", "ward"], {"metal"}),
    ],
)
def test_fits_are_chosen(options: list[str], expected: set[str], fits: Path) -> None:
    assert run(fits, "--to", "mitsuba", "--out", fits.parent / "out", *options) == 0
    assert {path.stem for path in (fits.parent / "out").iterdir()} == expected


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--material", "gold"], "torchbrdf: export: expected material metal or paint, found material 'gold'"),
        (["--loss", "log", "--model", "ggx"], "torchbrdf: export: expected model ward, loss log or rms, found model"),
        (["--to", "maya"], "torchbrdf: unknown exporter 'maya'; expected one of "),
        (["--mesh", "sphere"], "torchbrdf: mesh: expected none, since mitsuba writes materials only, found sphere"),
    ],
)
def test_a_wrong_choice_is_one_line_and_writes_nothing(
    options: list[str], said: str, fits: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(fits, "--to", "mitsuba", "--out", fits.parent / "out", *options) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(said)
    assert not list((fits.parent / "out").glob("*"))


def test_a_bad_material_leaves_the_others(fits: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records = json.loads(fits.read_text())
    records[0]["parameters"]["roughness"] = [7.0]
    records[1]["model"] = "unheard_of"
    (fits.parent / "bad.binary").write_bytes(b"no table")
    fits.write_text(json.dumps(records))
    missing, bad = fits.parent / "missing.json", fits.parent / "bad.binary"
    assert run(fits, missing, bad, "--to", "mitsuba", "--out", fits.parent / "out") == 1
    assert [path.name for path in (fits.parent / "out").iterdir()] == ["metal.xml"]
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 4 and all(line.startswith("torchbrdf: left out: ") and len(line) <= 340 for line in lines)
    assert any(
        "paint: expected parameters within their bounds, found roughness 7, not 0.001 to 0.5" in line for line in lines
    )
    assert any("fit 1: model: expected one of" in line for line in lines)
    assert any(f"{missing}: no such file or folder" in line for line in lines)


def test_a_folder_that_is_none_is_one_line(fits: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(fits, "--to", "mitsuba", "--out", fits) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"torchbrdf: {fits}: expected a folder or a new name, found a file"


def test_help_names_every_exporter(capsys: pytest.CaptureFixture[str]) -> None:
    from torchbrdf.export import EXPORTERS

    with pytest.raises(SystemExit):
        run("--help")
    said = capsys.readouterr().out
    assert all(f"{name}  " in said for name in EXPORTERS)
