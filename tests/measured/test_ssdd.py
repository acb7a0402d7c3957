"""SSDD files: coordinates, colours, binary values, and what is refused."""

import numpy as np
import pytest
import torch
from helpers.listed_files import BANDS, COLOR, known, ssdd

from torchbrdf.errors import DataError
from torchbrdf.measured import describe, load
from torchbrdf.measured.bands import rgb_weights


def written(folder, text, name="made-up.dat"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("color", ["monochrome", "rgb", "xyz", "spectrum"])
@pytest.mark.parametrize("system", ["half_difference", "spherical", "specular"])
def test_values_are_where_the_grid_has_them(system, color, binary, tmp_path):
    measured = load(written(tmp_path, ssdd(system, color, binary=binary)), dtype=torch.float64)
    good = measured.weight[0, :, 0] > 0
    wi, wo = measured.pairs.wi[0, good].numpy(), measured.pairs.wo[0, good].numpy()
    theta_i, theta_o = (np.arccos(np.clip(one[:, 2], -1, 1)) for one in (wi, wo))
    turn = np.arctan2(wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0], (wi[:, :2] * wo[:, :2]).sum(-1))
    own = {
        "monochrome": np.ones(3),
        "rgb": COLOR,
        "xyz": np.ones(3),  # of the white of D65
        "spectrum": COLOR @ rgb_weights(BANDS),
    }[color]
    expected = known(theta_i, theta_o, turn)[:, None] * own
    assert len(expected) > 200
    np.testing.assert_allclose(measured.values[0, good].numpy(), expected, rtol=2e-4)


def test_the_examples_of_the_specification(tmp_path):
    grey = "VERSION 0.2\n\nDATA_TYPE brdf\nCOLOR_MODEL monochrome\nPARAM_TYPE spherical_coordinate_system\n"
    grey += "PARAM0_LIST 0\nPARAM2_LIST 0\nPARAM3_LIST 0\nDATA ascii\n0.3183\n"
    assert load(written(tmp_path, grey), dtype=torch.float64).values[0, 0].tolist() == [0.3183] * 3
    several = "VERSION 0.2\nDATA_TYPE specular_reflectance\nCOLOR_MODEL monochrome\nPARAM0_LIST 0 90\nDATA ascii\n"
    several += "0.05\n0.05\n\n# Bluish\n" + grey.split("\n\n")[1]
    path = written(tmp_path, several)
    assert load(path, dtype=torch.float64).values[0, 0, 0] == pytest.approx(0.3183)
    assert describe(path)["passed over"] == "specular_reflectance"


def test_what_info_says(tmp_path):
    facts = describe(written(tmp_path, ssdd("specular")))
    assert (facts["format"], facts["coordinates"], facts["sample"]) == ("ssdd", "specular", "paint")
    assert facts["angles"] == "degrees, as the format has it" and "azimuths of the light" not in facts
    assert "passed over" not in facts


def test_binary_values_that_are_cut_are_refused(tmp_path):
    with pytest.raises(DataError, match=r"expected 9828 bytes of 819 binary values, found 9824$"):
        load(written(tmp_path, ssdd(binary=True)[:-4]))


def test_offsets_turn_the_mirror_direction(tmp_path):
    text = ssdd("specular", polar=(0, 30, 60))
    plain = load(written(tmp_path, text), dtype=torch.float64)
    moved = load(written(tmp_path, text.replace("NAME paint", "PARAM4_LIST 0 5 10\nNAME paint")), dtype=torch.float64)
    first = [one.pairs.wo[0, 1] for one in (plain, moved)]  # along the mirror direction of light from 30 degrees
    degrees = [torch.rad2deg(torch.atan2(-way[0], way[2])).item() for way in first]
    assert degrees == pytest.approx([30, 35])


def test_small_angles_are_said_and_radians_can_be(tmp_path):
    polar = tuple(np.radians(range(0, 90, 10)).round(6))
    text = ssdd("spherical", polar=tuple(range(0, 90, 10)))
    for k in (0, 2):
        text = text.replace(f"PARAM{k}_LIST 0 10 20 30 40 50 60 70 80", f"PARAM{k}_LIST {' '.join(map(str, polar))}")
    turns = " ".join(str(one) for one in np.radians(range(0, 181, 20)).round(6))
    text = text.replace("PARAM3_LIST 0 20 40 60 80 100 120 140 160 180", f"PARAM3_LIST {turns}")
    path = written(tmp_path, text)
    assert "if that is in radians, say angles=radians" in describe(path)["angles"]
    told = load(path, settings={"angles": "radians"}, dtype=torch.float64)
    expected = load(written(tmp_path, ssdd("spherical"), "other"), dtype=torch.float64)
    torch.testing.assert_close(told.pairs.cos_o, expected.pairs.cos_o, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (
            ("DATA_TYPE brdf", "DATA_TYPE btdf"),
            "expected a block of the data type brdf that ends with DATA, found btdf",
        ),
        (("COLOR_MODEL rgb", "COLOR_MODEL lab"), "COLOR_MODEL: expected monochrome, rgb, xyz or spectrum, found 'lab'"),
        (("COLOR_MODEL rgb", "COLOR_MODEL spectrum"), "WAVELENGTH_LIST: expected wavelengths that grow, found ''"),
        (("half_difference_coordinate_system", "polar"), "PARAM_TYPE: expected spherical, specular, half_difference"),
        (("PARAM0_LIST 0 ", "PARAM0_LIST 1 0 "), "PARAM0_LIST: expected angles that grow, found '1 0 "),
        (("PARAM0_LIST 0 ", "PARAM0_LIST nan "), "PARAM0_LIST: expected angles that grow"),
        (("PARAM2_LIST", "PARAM9_LIST"), "PARAM2_LIST: expected angles that grow, found ''"),
        (("PARAM3_LIST 0 ", "PARAM3_LIST 0 5 "), "expected 936 rows of values (13 x 1 x 9 x 8), found 819"),
        (("\n0.42", "\nx 0.42"), "expected 3 numbers, found 4"),
        (("DATA ascii", "DATA json"), "DATA: expected ascii or binary, found 'json'"),
        ((" 80\n", " 800\n"), "expected angles in degrees, found 800 from the normal"),
    ],
)
def test_what_is_refused(change, found, tmp_path):
    text = ssdd()
    assert text.replace(*change) != text
    path = written(tmp_path, text.replace(*change), "bad.ssdd")
    with pytest.raises(DataError, match=r"bad\.ssdd: ") as error:
        load(path)
    assert found in str(error.value)
