"""Tables of any BRDF: MERL's and RGL's, there and back."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import synthetic_bsdf, synthetic_raw, tensor_file, write_raw_merl

from torchbrdf.errors import DataError
from torchbrdf.export import export, picture_differences
from torchbrdf.lobes import GGX, Lambert, Lobe, Sum
from torchbrdf.measured import load, merl_values
from torchbrdf.measured.tables import measured_up_to
from torchbrdf.pairs import Pairs
from torchbrdf.render import Scene, blob

PAINT = Sum(Lambert(albedo=[0.3, 0.2, 0.1]), GGX(specular=[0.4, 0.4, 0.3], roughness=0.1))


def rgl_file(path: Path, **changes: np.ndarray) -> Path:
    path.write_bytes(tensor_file({**synthetic_bsdf(), **changes}))
    return path


@pytest.mark.parametrize("to", ["merl", "rgl"])
def test_pictures_of_a_table_hardly_differ(tmp_path: Path, to: str) -> None:
    done = export(PAINT, to, tmp_path, name="paint")
    assert not done.exact and len(done.files) == 1 and done.files[0].stem == "paint"
    assert done.notes[0].startswith("a table of RGL's format: 32" if to == "rgl" else "a MERL table: 90 x 90 x 180")
    found = picture_differences(PAINT, done.shown, Scene(blob(), size=48), ["delta_e76", "psnr"])
    assert found["delta_e76"] < 0.2 and found["psnr"] > 50


@pytest.mark.parametrize("to", ["merl", "rgl"])
def test_a_black_material_is_black(tmp_path: Path, to: str) -> None:
    done = export(Lambert(albedo=0.0), to, tmp_path)
    assert picture_differences(Lambert(albedo=0.0), done.shown, Scene(blob(), size=16), ["delta_e76"])["delta_e76"] == 0


def test_a_measurement_of_the_format_stays_what_it_is(tmp_path: Path) -> None:
    for to, path in {
        "merl": write_raw_merl(tmp_path / "m.binary", synthetic_raw()),
        "rgl": rgl_file(tmp_path / "r.bsdf"),
    }.items():
        done = export(path, to, tmp_path / "out")
        assert done.exact and done.files[0].read_bytes() == path.read_bytes()
        with pytest.raises(DataError, match="found the file that is exported"):
            export(path, to, tmp_path)


def test_holes_of_a_file_are_filled(tmp_path: Path) -> None:
    rgb = synthetic_bsdf()["rgb"].copy()
    rgb[0, 1, 2, 3, 4] = np.nan
    path = rgl_file(tmp_path / "holes.bsdf", rgb=rgb)
    done = export(path, "rgl", tmp_path / "out")
    assert not done.exact
    assert not any(np.isnan(done.shown.source._files[0].spectrum.numpy()).ravel())
    assert done.shown.source.is_whole(0)


def test_what_merl_tables_have_not_is_said(tmp_path: Path) -> None:
    theta = np.radians([0, 20, 40, 60, 90]).astype("f4")
    rgb = synthetic_bsdf()["rgb"] * np.array([1, 1, -1], "f4")[:, None, None]
    path = rgl_file(tmp_path / "some.bsdf", theta_i=theta, rgb=rgb)
    notes = export(path, "merl", tmp_path / "out").notes
    assert "negative channels, in " in notes[1] and "of the bins, are 0" in notes[1]
    assert notes[2] == (
        "measured with the light up to 60 degrees from the normal, the viewer up to 89; beyond, values are extrapolated"
    )
    assert measured_up_to(PAINT) == (90, 90)


class Skewed(Lobe):
    """Not reciprocal."""

    def forward(self, pairs: Pairs) -> torch.Tensor:
        return pairs.cos_i[..., None].expand(*pairs.shape, 3)


def test_a_merl_table_has_the_mean_of_both_orders(tmp_path: Path) -> None:
    done = export(Skewed(), "merl", tmp_path)
    wi, wo = hemisphere(1, 500, seed=1), hemisphere(1, 500, seed=2)
    high = (wi[0, :, 2] > 0.2) & (wo[0, :, 2] > 0.2)
    pairs = Pairs.from_directions(wi[:, high], wo[:, high])
    expected = ((pairs.cos_i + pairs.cos_o) / 2)[0, :, None].expand(-1, 3)
    torch.testing.assert_close(done.shown.at(pairs)[0], expected, atol=2e-3, rtol=0)


def test_bins_across_the_horizon_have_values_for_readers_that_look_there() -> None:
    values = merl_values(Lambert(albedo=math.pi / 4)).numpy()
    half, difference, azimuth = 30, 80, 0  # sum of the angles: 16 + 80 degrees at the centre
    assert np.isnan(values[half, difference + 6, azimuth]).all()
    np.testing.assert_allclose(values[np.isfinite(values)], 0.25, rtol=1e-6)
    theta_h = ((half + 0.5) / 90) ** 2 * 90
    lowest_inside = int(90 - theta_h - 0.5)
    assert np.isfinite(values[half, lowest_inside : lowest_inside + 2, azimuth]).all()


def test_there_and_back(tmp_path: Path) -> None:
    """MERL to RGL to MERL, at all pairs up to 80 degrees."""
    there = export(PAINT, "merl", tmp_path, name="a").files[0]
    table = export(there, "rgl", tmp_path, name="b").files[0]
    back = export(table, "merl", tmp_path, name="c").shown
    wi, wo = hemisphere(1, 3000, seed=1), hemisphere(1, 3000, seed=2)
    high = (wi[0, :, 2] > 0.17) & (wo[0, :, 2] > 0.17)
    pairs = Pairs.from_directions(wi[:, high], wo[:, high])
    expected, found = PAINT(pairs)[0].detach(), back.at(pairs)[0]
    off = ((found - expected).abs() / expected).amax(-1)
    assert off.median() < 0.005 and off.quantile(0.95) < 0.05


def test_holes_at_all_angles_do_not_say_how_far_a_table_reaches(tmp_path: Path) -> None:
    raw = synthetic_raw()
    raw[:, :60] = -1.0  # no highlight: in every ring of angles most is missing
    assert measured_up_to(load(write_raw_merl(tmp_path / "dull.binary", raw))).both > 85
