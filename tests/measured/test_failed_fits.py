"""Fits that failed, in the place of materials."""

from pathlib import Path

import pytest

from torchbrdf.cli import main
from torchbrdf.lobes import FitRecord, write_fits
from torchbrdf.measured import load
from torchbrdf.measured.standin import FailedFitWarning


def test_they_are_said(tmp_path: Path) -> None:
    values = {"diffuse": [0.1] * 3, "specular": [[0.1] * 3], "roughness": [0.1]}
    records = [FitRecord(name, "ward", 1, values, status=name) for name in ("converged", "no_data", "stalled")]
    path = tmp_path / "fits.json"
    write_fits(path, records)
    with pytest.warns(FailedFitWarning, match=r"no_data: the fit failed \(no_data\), its parameters") as said:
        materials = load(path)
    assert len(said) == 1
    assert [materials.source.details(k).get("status") for k in range(3)] == [None, "no_data", "stalled"]
    with pytest.warns(FailedFitWarning):
        assert main(["check", str(path)]) == 0
