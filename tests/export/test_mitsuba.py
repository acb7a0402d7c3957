"""Materials for Mitsuba."""

from pathlib import Path

import pytest
import torch
from helpers.mitsuba_pictures import mitsuba, obstacle

from torchbrdf.export import export
from torchbrdf.export.mitsuba import mitsuba_dict
from torchbrdf.lobes import GGX, Lambert, Sum


@pytest.mark.skipif(bool(obstacle()), reason=str(obstacle()))
def test_a_file_gives_the_bsdf(tmp_path: Path) -> None:
    black = GGX(specular=0.0)
    done = export(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), black), "mitsuba", tmp_path, name="a <paint>")
    assert done.exact and done.notes == ["exact: Mitsuba's diffuse"]
    bsdf = mitsuba().load_file(str(done.files[0]))
    assert bsdf.id() == "a <paint>"
    assert "0.3, 0.2, 0.1" in str(bsdf)


def test_a_dict_has_the_parameters() -> None:
    assert mitsuba_dict(Lambert(albedo=torch.tensor([0.1, 0.2, 0.3]))) == {
        "type": "diffuse",
        "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]},
    }
