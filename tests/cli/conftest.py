"""What tests of commands share."""

from pathlib import Path

import pytest

from torchbrdf.lobes import CookTorrance, FitRecord, Lambert, Sum, parameters, write_fits


@pytest.fixture
def paint(tmp_path: Path) -> Path:
    """A material that is a model, as a file."""
    model = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), CookTorrance(specular=0.5, roughness=0.2, f0=0.2))
    path = tmp_path / "paint.json"
    write_fits(path, [FitRecord("paint", "cook_torrance", 1, parameters(model))])
    return path
