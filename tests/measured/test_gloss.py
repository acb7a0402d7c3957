"""Gloss figures of materials for which they are known."""

import math

import pytest
import torch

from torchbrdf.color import luminance
from torchbrdf.measured import BrdfFormat, Lookup, Measured, contrast_gloss, distinctness_of_image, load
from torchbrdf.measured.gloss import LARGEST_ANGLE


class Known(BrdfFormat):
    """Materials given by functions of Pairs."""

    format = "known"

    def __init__(self, *functions):
        self.functions = functions
        self.names = [f"material{k}" for k in range(len(functions))]
        self.paths = []

    @classmethod
    def recognises(cls, path, head):
        return False

    @classmethod
    def open(cls, paths):
        raise NotImplementedError

    def read(self, materials, samples):
        raise NotImplementedError

    def at(self, pairs, materials, interpolation):
        values = torch.stack([self.functions[k](pairs)[0] for k in materials])
        return Lookup(values, torch.zeros(len(materials), dtype=torch.int64))


def lobe(width, diffuse=0.0, color=(1.0, 1.0, 1.0)):
    """A Gaussian of theta_h beside a constant."""
    tint = torch.tensor(color, dtype=torch.float64)
    return lambda pairs: ((-((pairs.theta_h / width) ** 2)).exp() + diffuse)[..., None] * tint


def constant(value):
    return lambda pairs: torch.full((*pairs.shape, 3), value, dtype=pairs.dtype)


def test_distinctness_of_image_of_gaussian_lobes():
    widths = [0.001, 0.01, 0.1, 0.5]
    found = distinctness_of_image(Measured(Known(*(lobe(width) for width in widths))))
    # The half vector turns half as far as the viewer: exp(-(angle / 2 width)^2) = 0.3.
    expected = torch.tensor([math.degrees(2 * width * math.sqrt(math.log(1 / 0.3))) for width in widths])
    torch.testing.assert_close(found, expected.double(), rtol=1e-3, atol=1e-3)
    assert (found.diff() > 0).all()


def test_distinctness_is_of_luminance_and_has_a_limit():
    green = lobe(0.05, color=(0.0, 1.0, 0.0))
    red_and_green = lambda pairs: green(pairs) + torch.tensor([100.0, 0, 0])  # noqa: E731
    measured = Measured(Known(green, red_and_green, constant(0.3), constant(0.0), constant(-1.0)))
    found = distinctness_of_image(measured)
    assert found[0] == pytest.approx(math.degrees(0.1 * math.sqrt(math.log(1 / 0.3))), rel=1e-3)
    # From the mirror direction at 30 degrees on one side to 89 degrees on the other.
    assert found[1] == LARGEST_ANGLE == found[2] == 119
    assert found[3:].isnan().all()


def test_contrast_gloss():
    measured = Measured(Known(lobe(0.05, diffuse=0.01), constant(0.3), constant(0.0), constant(-1.0)))
    found = contrast_gloss(measured)
    peak = 1 + 0.01
    base = math.exp(-((math.pi / 8 / 0.05) ** 2)) + 0.01
    assert found[0] == pytest.approx(math.log10(peak / base), rel=1e-12)
    assert found[1] == pytest.approx(0, abs=1e-12)
    assert found[2:].isnan().all()


def test_luminance_of_white_is_one():
    assert luminance(torch.ones(2, 3)).tolist() == pytest.approx([1, 1])
    assert luminance(torch.eye(3)).tolist() == pytest.approx([0.2126, 0.7152, 0.0722])


def test_real_materials_are_in_a_plausible_order(data):
    names = ["cg_sunflower", "chm_light_blue", "irid_flake_paint2", "satin_purple", "paper_white"]
    measured = load([data / "rgl" / f"{name}_rgb.bsdf" for name in names])
    distinctness, contrast = distinctness_of_image(measured), contrast_gloss(measured)
    assert distinctness.dtype == torch.float64
    assert (distinctness.diff() > 0).all()
    assert contrast[-1] < 0.1 < 0.5 < contrast[:-1].min()
