"""Names in the zoo on the command line, wherever a material is taken."""

import pytest

from torchbrdf.cli import main
from torchbrdf.lobes import read_fits, zoo_names

SMALL = ["--size", "8", "--backend", "software", "--environment", "none", "--lamp", "directional:0,0,1:1,1,1"]


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """An empty folder to be in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "written"),
    [
        (["check", "zoo:nickel", "--out", "out"], "out/check.json"),
        (["view", "zoo:nickel", "--size", "8", "--steps", "1", "--out", "out.html"], "out.html"),
        (["render", "zoo:nickel", *SMALL], "tonemap.json"),
        (["export", "zoo:nickel:openpbr", "--to", "mtlx", "--out", "out"], "out/nickel.mtlx"),
        (["fit", "zoo:nickel", "--lobes", "1", "--samples", "100", "--loss", "rms", "--out", "out"], "out/fits.json"),
    ],
    ids=["check", "view", "render", "export", "fit"],
)
def test_every_command_takes_a_name(place, arguments, written, capsys):
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert printed.err == "" and "nickel" in printed.out + (place / written).read_text(encoding="utf-8")


def test_info_lists_the_zoo(capsys):
    assert main(["info", "--zoo"]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [f"zoo:{name}" for name in zoo_names()]
    (record,) = read_fits("zoo:nickel:gltf")
    mean = sum(own["delta_e76"] for own in record.pictures.values()) / 3
    (nickel,) = [line for line in lines if line.startswith("zoo:nickel ")]
    assert f"gltf {mean:.1f} " in nickel and "stand-in" in nickel and "Delta E 76" in last


def test_info_shows_a_material(capsys):
    assert main(["info", "zoo:nickel:gltf"]) == 0
    shown = capsys.readouterr().out
    for word in ("zoo:nickel:gltf", "model of", "Sztrajman", "delta_e76 of knot, room", "metallic", "clearcoat"):
        assert word in shown


@pytest.mark.parametrize("command", ["info", "check", "view", "render", "fit", "match", "export"])
def test_a_name_that_is_not_there_is_said_in_a_line(command, capsys):
    more = {"export": ["--to", "mitsuba", "--out", "out"], "render": SMALL}.get(command, [])
    assert main([command, "zoo:nickle", *more]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "zoo:nickle: expected a material of the zoo, found none; did you mean nickel" in line
