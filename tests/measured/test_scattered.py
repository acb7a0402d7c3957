"""Values between scattered samples of BRDFs that are known everywhere."""

import math
import pickle
import time

import pytest
import torch
from helpers.directions import hemisphere
from helpers.listed_files import angles

from torchbrdf.fitting import fit
from torchbrdf.lobes import GGX, GGXAnisotropic, Lambert, Sum, Ward, make_model
from torchbrdf.losses import make_loss
from torchbrdf.measured import Measured, check, contrast_gloss, distinctness_of_image
from torchbrdf.pairs import Pairs

GLOSSY = Sum(Lambert(albedo=[0.1, 0.3, 0.5]), GGX(specular=0.3, roughness=0.2)).double()


def goniometer(lights=(0, 20, 40, 60), step=2):
    """Pairs `(1, N)` at which an instrument measures."""
    rows = torch.deg2rad(torch.from_numpy(angles(step, lights)))
    light, _, polar, azimuth = rows.T
    turn = azimuth - rows[:, 1]
    wi = torch.stack([light.sin(), 0 * light, light.cos()], -1)
    wo = torch.stack([polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos()], -1)
    return Pairs.from_directions(wi[None], wo[None])


@torch.no_grad()
def sampled(lobe, pairs, noise=0.0):
    values = lobe(pairs)
    values = values * (1 + noise * torch.randn(values.shape, generator=torch.Generator().manual_seed(0)).double())
    return Measured.from_samples(pairs, values.expand(1, -1, 3))


def random_pairs(count=2000, low=0.3):
    wi, wo = hemisphere(4 * count, seed=1), hemisphere(4 * count, seed=2)
    good = torch.minimum(wi[:, 2], wo[:, 2]) > low
    return Pairs.from_directions(wi[None, good][:, :count], wo[None, good][:, :count])


@pytest.mark.parametrize(
    "lobe", [GLOSSY, Lambert(albedo=0.4).double(), Sum(Lambert(albedo=0.2), Ward(specular=0.2, roughness=0.3)).double()]
)
def test_between_samples_values_are_near_what_they_are(lobe):
    measured, asked = sampled(lobe, goniometer()), random_pairs()
    with torch.no_grad():
        expected = lobe(asked)
    found = measured.at(asked)
    apart = (found / expected).log().abs()
    assert apart.median() < 0.02 and apart.square().mean().sqrt() < 0.1
    nearest = (measured.at(asked, "nearest") / expected).log().abs()
    assert apart.mean() < nearest.mean() + 1e-9


def test_samples_have_their_values():
    measured = sampled(GLOSSY, goniometer(), noise=0.05)
    back = Measured.from_samples(measured.pairs.select(samples=slice(0, None, 7)), measured.values[:, ::7])
    torch.testing.assert_close(back.at(back.pairs), back.values, rtol=0.2, atol=0)  # repetitions are their mean
    lone = sampled(GLOSSY, random_pairs(300), noise=0.3)
    torch.testing.assert_close(lone.at(lone.pairs), lone.values, rtol=1e-4, atol=1e-8)
    torch.testing.assert_close(lone.at(lone.pairs, "nearest"), lone.values)


def test_light_and_viewer_change_places_and_planes_mirror():
    measured, pairs = sampled(GLOSSY, goniometer(step=6), noise=0.2), random_pairs(200)
    assert measured.source.is_reciprocal
    mirror = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    for other in (
        Pairs.from_directions(pairs.wo, pairs.wi),
        Pairs.from_directions(pairs.wi * mirror, pairs.wo * mirror),
    ):
        torch.testing.assert_close(measured.at(other), measured.at(pairs), rtol=1e-6, atol=1e-9)


def test_repetitions_are_averaged():
    pairs = random_pairs(50)
    values = torch.rand(1, 50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 0.5
    twice = Pairs.from_directions(torch.cat([pairs.wi, pairs.wo], 1), torch.cat([pairs.wo, pairs.wi], 1))
    measured = Measured.from_samples(twice, torch.cat([values, 3 * values], 1))
    torch.testing.assert_close(measured.at(pairs), 2 * values, rtol=1e-4, atol=0)


def test_distances_are_angles():
    pairs = random_pairs(400)
    measured = sampled(GLOSSY, pairs)
    assert measured.distance_at(pairs).max() < 1e-4
    angle = torch.full((1, 1), 0.5, dtype=torch.float64)
    one = sampled(GLOSSY, Pairs.from_half_diff(angle, angle, angle))
    for step in (0.01, 0.1):
        for moved in ([step, 0, 0], [0, step, 0]):
            other = Pairs.from_half_diff(*(angle + part for part in moved))
            assert one.distance_at(other).item() == pytest.approx(math.degrees(step), rel=0.1)
    assert one.distance_at(Pairs.from_half_diff(0 * angle, angle, angle)).item() > 20


def test_values_stay_finite_anywhere_and_negative_ones_small():
    source = torch.Generator().manual_seed(0)
    pairs = goniometer(step=6)
    values = 0.01 * torch.randn(1, len(pairs), 3, generator=source, dtype=torch.float64)
    measured = Measured.from_samples(pairs, values)
    asked = random_pairs(3000, low=0.001)
    found = measured.at(asked)
    assert found.isfinite().all() and found.abs().max() < 100 * values.abs().max()
    nothing = Measured.from_samples(pairs, 0 * values)
    assert (nothing.at(asked) == 0).all()
    alone = Measured.from_samples(pairs.select(samples=[40]), values[:, 40:41] + 1)
    assert alone.at(asked).isfinite().all()


def test_energy_of_what_continues_beyond_the_samples():
    (found,) = check(sampled(GLOSSY, goniometer()))
    (true,) = check(GLOSSY)
    assert found.largest_albedo[0] == pytest.approx(true.largest_albedo[0], rel=0.1)
    assert found.reciprocity is None


def test_readings_that_were_not_measured(caplog):
    spread = torch.rand(3, 1, 60, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) / 20
    few = sampled(GLOSSY, Pairs.from_half_diff(*(spread + torch.tensor([0.9, 0.5, 1.2]).double()[:, None, None])))
    assert not few.has_45_0.any() and distinctness_of_image(few).isnan().all() and contrast_gloss(few).isnan().all()
    result = fit(make_model("ward", 1), few, make_loss("rms"))
    assert result.diffuse == "fit"
    assert "no sample is near the 45:0 reading; the diffuse albedo is fitted, too" in caplog.text
    none = Measured.from_samples(few.pairs, few.values, 0 * few.weight)
    assert fit(make_model("ward", 1), none, make_loss("rms")).status == ["no_data"]
    many = sampled(GLOSSY, goniometer(step=6))
    assert many.has_45_0.all() and fit(make_model("ward", 1), many, make_loss("rms")).diffuse == "45:0"
    assert distinctness_of_image(many).isfinite().all()


def test_pickles_do_not_hold_what_is_made_again():
    measured = sampled(GLOSSY, goniometer())
    before = len(pickle.dumps(measured))
    expected = measured.at(random_pairs())
    assert len(pickle.dumps(measured)) < before + 100_000
    assert torch.equal(pickle.loads(pickle.dumps(measured)).at(random_pairs()), expected)


def with_a_grain(turns=4):
    """Samples of a brushed metal, taken at turns of it."""
    lobe = Sum(Lambert(albedo=0.2), GGXAnisotropic(specular=0.3, roughness_x=0.1, roughness_y=0.4)).double()
    pairs = goniometer(step=3)
    angle = torch.arange(turns, dtype=torch.float64)[:, None] * math.pi / turns
    wi, wo = (
        torch.stack([x * angle.cos() - y * angle.sin(), x * angle.sin() + y * angle.cos(), z.expand(turns, -1)], -1)
        for x, y, z in (one[0].T for one in (pairs.wi, pairs.wo))
    )
    return sampled(lobe, Pairs.from_directions(wi.reshape(1, -1, 3), wo.reshape(1, -1, 3)))


@pytest.mark.slow
@pytest.mark.parametrize(("make", "limit"), [(lambda: sampled(GLOSSY, goniometer(step=1)), 0.5), (with_a_grain, 1.0)])
def test_speed(make, limit):
    """CPU seconds of one thread, with room for other work on the machine: alone 0.2, and 0.45 with a grain."""
    measured, asked = make(), random_pairs(100_000, low=0.01)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        began = time.process_time()
        measured.at(asked.select(samples=slice(0, 10)))
        prepared = time.process_time()
        measured.at(asked)
        done = time.process_time()
    finally:
        torch.set_num_threads(threads)
    assert prepared - began < 1.5 and done - prepared < limit


@pytest.mark.parametrize("make", [lambda: sampled(GLOSSY, goniometer(step=6)), with_a_grain])
@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
def test_values_do_not_depend_on_what_else_is_asked(make, interpolation):
    """Pairs are asked in an order of their own, and answered in that in which they came."""
    measured, asked = make(), random_pairs(500)
    whole, distance = measured.at(asked, interpolation)[0], measured.distance_at(asked)[0]
    for index in ([k] for k in range(0, 500, 50)):
        torch.testing.assert_close(measured.at(asked.select(samples=index), interpolation)[0], whole[index])
        torch.testing.assert_close(measured.distance_at(asked.select(samples=index))[0], distance[index])
    assert measured.at(asked.select(samples=slice(0, 0)), interpolation).shape == (1, 0, 3)


def test_lobes_that_are_flat_are_left_out():
    """Most widths are: each costs as much as one that is not."""
    source = sampled(GLOSSY, goniometer(step=6)).source
    _, surface = source.surface(0)
    used = surface._widths
    assert 0 < len(used) < 9
    heights = torch.from_numpy(surface._heights)
    assert (heights[1 : 1 + len(used)] + heights[1 + len(used) :]).any(1).all()


def test_mirror_directions_are_one_place_whatever_rounding_made_of_them():
    """Half vectors along the normal, but for 1e-16, had values of their own, and others between."""
    theta = torch.deg2rad(torch.tensor([5.0, 20, 20, 35, 50, 60], dtype=torch.float64))
    wi, wo = (torch.stack([side * theta.sin(), 0 * theta, theta.cos()], -1) for side in (1, -1))
    off = torch.tensor([0, 1e-16, 7e-17, 3e-17, 2e-16, 0], dtype=torch.float64)
    wo = torch.nn.functional.normalize(wo + off[:, None], dim=-1)
    values = torch.tensor([1.1, 2.1, 2.3, 0.5, 2.9, 3.4], dtype=torch.float64)[None, :, None].expand(1, 6, 3)
    generator = torch.Generator().manual_seed(0)
    drawn = torch.rand(3, 40, dtype=torch.float64, generator=generator) * torch.tensor([[0.6], [0.6], [3.0]])
    around = Pairs.from_half_diff(*drawn)
    pairs = Pairs.from_directions(torch.cat([wi, around.wi]), torch.cat([wo, around.wo]))
    rest = torch.full((1, 40, 3), 0.2, dtype=torch.float64)
    measured = Measured.from_samples(pairs, torch.cat([values, rest], 1), anisotropic=False)
    for dtype in (torch.float32, torch.float64):
        asked = torch.deg2rad(torch.tensor([20.0], dtype=dtype))
        found = measured.at(Pairs.from_half_diff(torch.zeros_like(asked), asked, torch.zeros_like(asked)))
        assert found.flatten()[0].item() == pytest.approx(2.2, rel=0.02)
