"""Checks of energy, reciprocity and sign, against closed forms and BRDFs that are wrong on purpose."""

import math

import numpy as np
import pytest
import torch
from helpers.measured_files import synthetic_bsdf, tensor_file
from scipy.integrate import dblquad

from torchbrdf import Pairs
from torchbrdf.errors import UsageError
from torchbrdf.lobes import EON, GGX, LOBES, Lambert, Sum, Ward
from torchbrdf.measured import Measured, check, directional_albedo, load, standins


class Skewed(Lambert):
    """A BRDF that is not reciprocal, and below 0 where the viewer is low."""

    @staticmethod
    def function(pairs, albedo):
        return ((pairs.cos_o - 0.25) / math.pi)[..., None] * albedo[..., None, :]


def test_albedo_of_what_is_known():
    angles = [0.0, 30.0, 60.0, 85.0]
    flat = directional_albedo(Lambert(albedo=[0.2, 0.4, 0.8]).double(), angles)[0]
    torch.testing.assert_close(flat, torch.tensor([[0.2, 0.4, 0.8]]).double().expand(4, 3), rtol=1e-3, atol=0)
    white = directional_albedo(EON(albedo=1.0, roughness=1.0).double(), angles)
    torch.testing.assert_close(white, torch.ones_like(white), rtol=1e-3, atol=0)
    # A mirror, nearly: all light that F0 = 1 lets through.
    mirror = directional_albedo(GGX(specular=1.0, roughness=0.001, f0=1.0).double(), angles)
    torch.testing.assert_close(mirror, torch.ones_like(mirror), rtol=1e-3, atol=0)


def test_albedo_by_scipy():
    """The same integral over outgoing directions, by another rule."""
    lobe, angle = Ward(specular=0.7, roughness=0.2).double(), math.radians(40)
    wi = torch.tensor([[math.sin(angle), 0.0, math.cos(angle)]], dtype=torch.float64)

    def integrand(phi, theta):
        wo = [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
        value = lobe(Pairs.from_directions(wi, torch.tensor([wo], dtype=torch.float64)))
        return value[0, 0].item() * math.cos(theta) * math.sin(theta)

    expected, _ = dblquad(integrand, 0, math.pi / 2, 0, 2 * math.pi, epsabs=1e-3)
    assert directional_albedo(lobe, [40.0])[0, 0, 0].item() == pytest.approx(expected, rel=2e-3)


def test_what_is_wrong_is_said():
    assert check(Sum(Lambert(albedo=0.4), GGX()))[0].warnings() == []
    assert "reflects 130 % of the light" in check(Lambert(albedo=1.3))[0].warnings()[0]
    skewed = check(Skewed(albedo=0.5))[0]
    assert [warning.split()[0:3] for warning in skewed.warnings()] == [
        ["is", "not", "reciprocal:"],
        ["has", "a", "channel"],
    ]
    assert skewed.lowest == pytest.approx(0.5 / math.pi * (math.cos(math.radians(80)) - 0.25), rel=1e-2)


def test_materials_of_a_file_and_of_a_batch():
    measured = load(standins()).batch([6, 7])
    found = check(measured)
    assert [one.name for one in found] == ["nickel", "nylon"]
    assert all(one.reciprocity < 1e-6 and one.invalid == 0 and one.reach > 89 for one in found)
    alone = check(measured.batch([1]))[0]
    assert np.allclose(alone.albedo, found[1].albedo, rtol=1e-6)
    batch = check(Lambert(albedo=torch.tensor([[0.1] * 3, [1.2] * 3])))
    assert [len(one.warnings()) for one in batch] == [0, 1]
    assert found[0].to_dict()["largest_albedo"] == max(map(max, found[0].albedo))


def test_a_file_among_larger_ones_is_found_as_alone(tmp_path):
    """Files of RGL's format with fewer samples are padded; what pads them is not missing."""
    for name, size in (("large", 20), ("small", 8)):
        (tmp_path / f"{name}.bsdf").write_bytes(tensor_file(synthetic_bsdf(size=size)))
    together = check(load([tmp_path / "large.bsdf", tmp_path / "small.bsdf"]))[1]
    alone = check(load(tmp_path / "small.bsdf"))[0]
    assert (together.name, together.invalid) == ("small", alone.invalid)
    assert together.reach == pytest.approx(alone.reach) and together.warnings() == alone.warnings()


def test_a_file_that_reaches_only_so_far():
    """Samples that are not valid beyond 60 degrees, and one in ten within."""

    class Half(type(load(standins()).source)):
        def read(self, materials, samples):
            values, weight = super().read(materials, samples)
            own = self.pairs.select(samples=samples)
            low = torch.minimum(own.cos_i, own.cos_o)[0] > math.cos(math.radians(60))
            kept = low & (torch.arange(len(low)) % 10 > 0)
            return values, weight * kept[:, None]

    source = load(standins()).source
    found = check(Measured(Half(source.records[:1], source.paths[:1])))[0]
    assert found.reach == pytest.approx(60, abs=1)
    assert any("measured only to 60 degrees" in warning for warning in found.warnings())
    assert found.invalid > 0.1


@pytest.mark.parametrize("name", sorted(set(LOBES)))
def test_every_lobe_can_be_checked(name):
    (found,) = check(LOBES[name]())
    assert np.isfinite(found.albedo).all() and found.reciprocity < 1e-4 and found.lowest >= 0


@pytest.mark.parametrize("angles", [[], [90.0], [-1.0], [float("nan")]])
def test_angles_that_are_none(angles):
    with pytest.raises(UsageError, match="expected degrees"):
        directional_albedo(Lambert(), angles)
