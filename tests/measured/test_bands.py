"""Colours from bands, beside colour-science's tables."""

import numpy as np
import pytest

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.measured.bands import color_matching, colors_label, rgb_weights

with np.printoptions():  # which it changes for the whole process
    colour = pytest.importorskip("colour")


@pytest.mark.parametrize("illuminant", ["D65", "E"])
def test_white_is_white(illuminant):
    assert np.allclose(rgb_weights([400, 500, 600, 700], illuminant).sum(0), 1)


def test_the_observer_is_the_standard_one():
    table = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    grid = np.arange(380.0, 781.0)
    assert np.sqrt(np.mean((color_matching(grid) - table[grid]) ** 2)) < 0.012


def test_colours_of_real_spectra():
    """Of a colour chart, under D65: within 0.02 of what tables make of the same bands."""
    grid = np.arange(400.0, 701.0, 10)
    chart = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    shape = colour.SpectralShape(400, 700, 10)
    for spectrum in list(chart.values())[:18]:
        own = spectrum.copy().align(shape)
        xyz = colour.sd_to_XYZ(own, illuminant=colour.SDS_ILLUMINANTS["D65"], method="Integration") / 100
        assert np.abs(own.values @ rgb_weights(grid) - colour.XYZ_to_sRGB(xyz, apply_cctf_encoding=False)).max() < 0.03


def test_bands_without_colour_are_grey():
    assert np.allclose(rgb_weights([650.0]), 1)
    assert np.allclose(rgb_weights([1064.0, 1550.0]), 0.5)
    assert colors_label([1064.0, 1550.0]).startswith("grey")


def test_what_is_refused():
    with pytest.raises(ShapeError, match="expected wavelengths that grow"):
        rgb_weights([500.0, 400.0])
    with pytest.raises(UsageError, match="unknown illuminant 'D50'"):
        rgb_weights([400.0, 500.0], "D50")
