"""The commands on files of formats that are read in ways of their own: what one takes, all take."""

import numpy as np
import pytest
from helpers.listed_files import alta, angles, openmaterial, unit_vectors
from helpers.measured_files import anisotropic_bsdf, brushed, tensor_file, utia

from torchbrdf.cli import main


def grain():
    """A table of columns, with the light at four azimuths."""
    rows = np.array(
        [
            (light, turn, polar, turn + between)
            for light in (10, 40)
            for turn in (0, 45, 90, 135)
            for polar in (0, 30, 60)
            for between in range(0, 360, 60)
        ],
        float,
    )
    both = unit_vectors(np.radians(rows))
    values = brushed(both[:, 3:], both[:, :3])
    lines = [",".join(f"{one:.9g}" for one in (*row, value)) for row, value in zip(rows, values, strict=True)]
    return "\n".join(["theta_i,phi_i,theta_o,phi_o,f", *lines])


FILES = {
    "alta": lambda: alta(angles(20)).encode(),
    "alta, binary": lambda: alta(angles(20), order="little", vs=2),
    "openmaterial": lambda: openmaterial(angles(20)).encode(),
    "rgl, anisotropic": lambda: tensor_file(anisotropic_bsdf(size=8, azimuths=5, angles=4)),
    "samples with a grain": lambda: grain().encode(),
    "utia": lambda: utia().astype("<f8").tobytes(),
}


@pytest.mark.parametrize("name", FILES)
def test_commands_take_every_format(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "material").write_bytes(FILES[name]())
    assert main(["info", "material"]) == 0
    said = capsys.readouterr().out
    assert "white furnace" in said or name.startswith("rgl")
    assert ("anisotropic  " in said) == (name in ("rgl, anisotropic", "samples with a grain", "utia"))
    assert main(["fit", "material", "--model", "ward", "--lobes", "1", "--samples", "200", "--out", "fits"]) == 0
    assert main(["render", "material", "fits/fits.json", "--size", "16", "--out", "pictures"]) == 0
    assert (tmp_path / "pictures" / "sheet.png").stat().st_size > 1000
    assert main(["check", "material"]) == 0
