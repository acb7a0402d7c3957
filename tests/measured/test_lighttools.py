"""BSDF text of LightTools: sides, planes of incidence, bands, and what is refused."""

import pytest
import torch
from helpers.table_files import (
    lighttools,
    opened,
)

from torchbrdf.errors import DataError
from torchbrdf.measured import describe


def test_sides_and_planes_of_incidence(tmp_path):
    front, back = lighttools(), lighttools(side="Back")
    both = front.replace("DataEnd\n", back.partition("DataBegin\n")[2])
    measured = opened(tmp_path, both)
    assert describe(tmp_path / "made-up.dat")["side"] == "front; --read side=front, side=back"
    assert torch.equal(opened(tmp_path, both, side="back").values, measured.values)
    planes = front.replace("DataEnd\n", lighttools(poi=30).partition("DataBegin\n")[2])
    with pytest.raises(DataError, match="POI: expected one plane of incidence, unless --read light_azimuth=poi"):
        opened(tmp_path, planes)
    turned = opened(tmp_path, planes, light_azimuth="poi")
    tilted = turned.pairs.cos_i[0] < 0.999
    azimuths = torch.atan2(turned.pairs.wi[0, tilted, 1], turned.pairs.wi[0, tilted, 0]).rad2deg().round().unique()
    assert azimuths.tolist() == [30, 90]


def test_wavelengths_and_tristimulus_values(tmp_path):
    plain = opened(tmp_path, lighttools())
    for more in ({"waves": (650, 450, 550)}, {"content": "XYZ"}):
        torch.testing.assert_close(opened(tmp_path, lighttools(**more)).values, plain.values, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (lighttools(kind="BTDF"), "expected a BRDF, found BTDF of the front"),
        (lighttools().replace("Asymmetric", "Round"), "expected a known Symmetry"),
        (lighttools().replace("DataBegin", ""), "and DataBegin, found"),
        (lighttools().replace("DataEnd", ""), "expected DataEnd behind whole blocks"),
        (lighttools().replace("AOI 20", "AOI 200"), "AOI: expected 0 to 90, found '200'"),
        (lighttools().replace("AOI 20", "AOI 0"), "found a second one for 0 degrees"),
        (lighttools().replace("AOI 20\n", ""), "expected a block for each angle of the light, found none"),
        (lighttools().replace("ScatterRadial 9", "ScatterRadial 8"), "expected 8 numbers, found 9"),
        (lighttools().replace("ScatterRadial 9", "ScatterRadial 0"), "expected a count of angles, found '0'"),
        (lighttools().replace("ScatterRadial 9\n0 10", "ScatterRadial 9\n0 99"), "expected growing angles up to 90"),
        (lighttools()[:-200], "expected"),
        (lighttools(waves=(550, 550)), "found a second one"),
        (lighttools(waves=(550, "x")), "expected ones in nm that differ"),
        (lighttools(content="XYZ").replace("TrisX", "TrisW"), "expected TrisX, TrisY, TrisZ"),
        (lighttools().replace("Side Front", "Side Left"), "expected Side Front or Back"),
    ],
)
def test_bad_files_of_lighttools_are_refused(text, says, tmp_path):
    with pytest.raises(DataError) as caught:
        opened(tmp_path, text)
    assert says in str(caught.value) and "made-up.dat" in str(caught.value)
