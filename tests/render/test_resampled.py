"""Pictures of scattered samples with a grain: from a grid, as exact as they say, and quick."""

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.listed_files import unit_vectors
from helpers.measured_files import brushed

from torchbrdf import memory
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.measured import Measured, resampled
from torchbrdf.measured.resampled import ForPictures, Resampled
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, Scene, blob, render
from torchbrdf.render.draw import render_by_transport, render_directly


def sampled(brdf=brushed, colours=(1.0, 1.0, 1.0), noise=0.0, anisotropic=True):
    """What an instrument takes that turns the sample."""
    given = np.array(
        [
            (light, turn, polar, turn + between)
            for light in (10, 30, 50, 70)
            for turn in range(0, 360, 20)
            for polar in range(0, 80, 10)
            for between in (range(0, 360, 30) if polar else [0])
        ],
        float,
    )
    both = unit_vectors(np.radians(given))
    values = brdf(both[:, 3:], both[:, :3]) * np.exp(noise * np.random.default_rng(0).standard_normal(len(given)))
    wi, wo = (torch.from_numpy(np.ascontiguousarray(one))[None] for one in (both[:, 3:], both[:, :3]))
    found = torch.from_numpy(values)[None, :, None] * torch.tensor(colours, dtype=torch.float64)
    return Measured.from_samples(Pairs.from_directions(wi, wo), found, anisotropic=anisotropic)


@pytest.fixture(scope="module")
def coloured():
    return sampled(colours=(1.0, 0.6, 0.3))


@pytest.fixture(scope="module")
def scene():
    return Scene(blob(), Camera(15), None, size=32, nodes=64, light_samples=128)


def off(scene, picture, wanted):
    tone = ToneMap.from_images(wanted, scene.mask)
    return float(DIFFERENCES["delta_e76"]()(tone(picture)[None], tone(wanted)[None], scene.mask))


def test_the_grid_has_the_values_that_are_between_samples(coloured):
    grid = Resampled(*coloured.source.surface(0))
    wi, wo = (hemisphere(1, 4000, seed=seed) for seed in (0, 1))
    wi, wo = wi.float(), wo.float()
    pairs = Pairs.from_directions(wi, wo)
    found, wanted = grid.at(pairs), coloured.at(pairs)[0]
    assert found.dtype == torch.float32 and found.shape == (4000, 3)
    apart = (found / wanted).log().abs().amax(-1)
    assert apart.median() < 0.025 and apart.quantile(0.9) < 0.15
    # Light and viewer can change places; below the horizon there is nothing.
    torch.testing.assert_close(found, grid.at(Pairs.from_directions(wo, wi)), rtol=2e-3, atol=1e-4)
    assert (grid.at(Pairs.from_directions(wi * torch.tensor([1.0, 1.0, -1.0]), wo)) == 0).all()


def test_entries_of_the_grid_are_exact(coloured):
    """At places of the grid nothing is interpolated: its angles and those of pairs are the same ones."""
    grid = Resampled(*coloured.source.surface(0))
    rng = np.random.default_rng(0)
    index = rng.choice(np.prod(resampled.SHAPE), 3000)
    angles, lowest = resampled._angles_at(index)
    used = (lowest > 0.05) & (angles.theta_h > 0.05) & (angles.theta_d > 0.05)
    angles = angles.select(used)
    # The difference's azimuth about the normal, as one about the half vector.
    phi_h = np.arctan2(angles.grain[:, 1], angles.grain[:, 0])
    turned = np.arctan2(angles.grain[:, 3], angles.grain[:, 2]) / 2 - phi_h
    phi_d = np.arctan2(np.sin(turned) * np.cos(angles.theta_h), np.cos(turned))
    asked = (torch.from_numpy(one)[None] for one in (angles.theta_h, angles.theta_d, phi_d, phi_h))
    pairs = Pairs.from_half_diff(*asked)
    assert len(pairs) > 500
    torch.testing.assert_close(grid.at(pairs), coloured.at(pairs)[0], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("noise", "most"), [(0.0, 0.3), (0.5, 0.6)])
def test_pictures_are_those_between_the_samples(noise, most, scene):
    measured = sampled(noise=noise)
    found, wanted = render(measured, scene)[0], render_directly([measured.at], scene)[0]
    assert off(scene, found, wanted) < most


def test_what_brings_much_light_is_asked_for_between_the_samples(scene, monkeypatch):
    measured = sampled(noise=0.5)
    wanted = render_directly([measured.at], scene)[0]
    found = {}
    for much in (resampled.MUCH, 1e9):
        monkeypatch.setattr(resampled, "MUCH", much)
        found[much] = off(scene, render(measured, scene)[0], wanted)
    assert found[6.0] < 0.75 * found[1e9]


def test_a_grid_is_made_once_and_given_up_for_room(coloured, monkeypatch):
    made = []
    monkeypatch.setattr(resampled, "Resampled", lambda *parts: made.append(parts) or Resampled(*parts))
    both = Measured.from_samples(
        coloured.pairs, coloured.values.expand(2, -1, -1) * torch.tensor([[[1.0]], [[2.0]]]), anisotropic=True
    )
    first, _ = ForPictures(both)._grids.values()
    ForPictures(both)
    assert len(made) == 2
    with memory.limited(4 * 1.5 * first.nbytes / 2**30):
        ForPictures(both.batch([0]))
        assert len(made) == 2
        resampled._GRIDS.clear()
        ForPictures(both)
        ForPictures(both.batch([1]))
        assert len(made) == 4
        ForPictures(both.batch([0]))
        assert len(made) == 5


def test_what_has_no_grain_beside_it_comes_from_the_transport(scene):
    """Pictures keep their order, also where materials of both kinds are of one source."""
    grain = sampled()
    flat = Measured.from_samples(grain.pairs, grain.values.float(), anisotropic=False)
    alone = torch.cat([render(grain, scene), render_by_transport([flat], scene)])
    torch.testing.assert_close(render([grain, flat], scene), alone)
    torch.testing.assert_close(render([flat, grain], scene), alone.flip(0))
    both = Measured.from_samples(grain.pairs, grain.values.expand(3, -1, -1), anisotropic=True)
    both.source.has_grain = lambda material: material == 1
    assert both.is_anisotropic and not both.batch([0, 2]).is_anisotropic
    torch.testing.assert_close(render(both, scene), alone[[1, 0, 1]])
