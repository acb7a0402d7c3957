"""Scattered samples of anisotropic materials: found by the data, interpolated with both azimuths."""

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.listed_files import unit_vectors, zemax
from helpers.measured_files import brushed

from torchbrdf.measured import Measured, describe, load
from torchbrdf.pairs import Pairs


def rows(azimuths, lights=(15, 35, 55)):
    """theta_i, phi_i, theta_o, phi_o in degrees, as an instrument takes them that turns the sample."""
    return np.array(
        [
            (light, turn, polar, (turn + between) % 360)
            for light in lights
            for turn in azimuths
            for polar in range(0, 80, 10)
            for between in (range(0, 360, 20) if polar else [0])
        ],
        float,
    )


def turned(wi, wo):
    """The other grain."""
    swap = [1, 0, 2]
    return brushed(wi[..., swap], wo[..., swap])


def smooth(wi, wo):
    """No grain."""
    return brushed(wi * [0, 0, 1], wo * [0, 0, 1]) + wi[..., 2] * wo[..., 2]


def written(folder, given, brdf, noise=0.0, name="made-up.csv"):
    both = unit_vectors(np.radians(given))
    values = brdf(both[:, 3:], both[:, :3]) * (1 + noise * np.random.default_rng(0).standard_normal(len(given)))
    table = np.concatenate([given, values[:, None]], 1)
    lines = [",".join(f"{one:.9g}" for one in row) for row in table]
    path = folder / name
    path.write_text("\n".join(["theta_i,phi_i,theta_o,phi_o,f", *lines]))
    return path


@pytest.mark.parametrize("brdf", [brushed, turned])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_grain_is_found_and_kept(brdf, noise, tmp_path):
    path = written(tmp_path, rows(range(0, 360, 15)), brdf, noise)
    measured = load(path, dtype=torch.float64)
    assert measured.is_anisotropic and measured.is_scattered and measured.source.is_reciprocal
    assert describe(path)["anisotropic"].startswith("24 azimuths of the light; samples that are left out")
    wi, wo = (hemisphere(1, 4000, seed=seed).double() for seed in (0, 1))
    keep = (wi[0, :, 2] > 0.5) & (wo[0, :, 2] > 0.3)
    asked = Pairs.from_directions(wi[:, keep], wo[:, keep])
    wanted = torch.from_numpy(brdf(asked.wi.numpy(), asked.wo.numpy()))[0]
    off = (measured.at(asked)[0, :, 0] / wanted).log().abs()
    assert off.median() < 0.06 + noise and off.quantile(0.9) < 0.3
    flat = load(path, settings={"grain": "isotropic"}, dtype=torch.float64)
    assert (flat.at(asked)[0, :, 0] / wanted).log().abs().median() > 2 * off.median()
    # Light and viewer can change places.
    other = Pairs.from_directions(asked.wo, asked.wi)
    torch.testing.assert_close(measured.at(asked), measured.at(other))
    if not noise:
        pairs = measured.pairs
        torch.testing.assert_close(measured.at(pairs), measured.values, rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(measured.at(pairs, "nearest"), measured.values, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_noise_is_no_grain(noise, tmp_path):
    path = written(tmp_path, rows(range(0, 360, 30)), smooth, noise)
    measured = load(path, dtype=torch.float64)
    assert not measured.is_anisotropic
    assert "read as isotropic, by the mean over them" in describe(path)["azimuths of the light"]


def test_two_azimuths_are_enough(tmp_path):
    assert load(written(tmp_path, rows((0, 90)), brushed, 0.02)).is_anisotropic
    assert not load(written(tmp_path, rows((0, 90)), smooth, 0.2)).is_anisotropic


def test_distances_know_azimuths(tmp_path):
    path = written(tmp_path, rows((0, 45)), brushed)
    measured = load(path, settings={"grain": "anisotropic"}, dtype=torch.float64)
    flat = load(path, settings={"grain": "isotropic"}, dtype=torch.float64)
    asked = unit_vectors(np.radians([[35, 90, 0, 0], [35, 45, 0, 0], [35, 46, 0, 0]]))
    pairs = Pairs.from_directions(*(torch.from_numpy(asked[None, :, part]) for part in (slice(3, 6), slice(3))))
    assert (flat.distance_at(pairs) < 0.01).all()
    far, none, near = measured.distance_at(pairs)[0].tolist()
    assert far > 10 and none < 0.01 and 0.2 < near < 0.8
    assert torch.allclose(measured.distance_at(Pairs.from_directions(pairs.wo, pairs.wi)), measured.distance_at(pairs))


def test_what_is_told_is_taken(tmp_path):
    one = written(tmp_path, rows((0,)), brushed)
    assert not load(one).is_anisotropic and "azimuths of the light" not in describe(one)
    told = load(one, settings={"grain": "anisotropic"})
    assert told.is_anisotropic and told.at(told.pairs).isfinite().all()
    assert describe(one, {"grain": "anisotropic"})["anisotropic"] == "1 azimuths of the light; as was told"
    loose = np.array([(20 + 3 * k, 40 * k, 30 + k, 200 + 17 * k) for k in range(9)], float)
    path = written(tmp_path, loose, brushed, name="loose.csv")
    assert not load(path).is_anisotropic
    assert "too few samples to tell" in describe(path)["azimuths of the light"]


def test_of_several_files_each_is_as_it_is(tmp_path):
    written(tmp_path, rows(range(0, 360, 30)), brushed, name="a.csv")
    written(tmp_path, rows(range(0, 360, 30)), smooth, name="b.csv")
    both = load(tmp_path, dtype=torch.float64)
    assert both.is_anisotropic and [both.source.has_grain(k) for k in (0, 1)] == [True, False]
    alone = load(tmp_path / "b.csv", dtype=torch.float64)
    wi, wo = hemisphere(1, 50).double(), hemisphere(1, 50, seed=1).double()
    asked = Pairs.from_directions(wi, wo)
    torch.testing.assert_close(both.at(asked)[1:], alone.at(asked))


@pytest.mark.parametrize("left_out", [None, 20, 60])
def test_a_brushed_metal_is_predicted(left_out, tmp_path):
    """GGX with two widths and a slanted grain, taken at few incidences and at two turns only."""

    def ggx(wi, wo):
        cosine, sine = np.cos(0.5), np.sin(0.5)
        h = wi + wo
        h /= np.linalg.norm(h, axis=-1, keepdims=True)
        along, across = cosine * h[..., 0] + sine * h[..., 1], cosine * h[..., 1] - sine * h[..., 0]
        distribution = 1 / (np.pi * 0.03 * ((along / 0.3) ** 2 + (across / 0.1) ** 2 + h[..., 2] ** 2) ** 2)
        return distribution / (4 * (wi[..., 2] + wo[..., 2])) + 0.02

    lights = [light for light in (5, 20, 40, 60) if light != left_out]
    measured = load(written(tmp_path, rows((0, 90), lights), ggx), dtype=torch.float64)
    asked = unit_vectors(np.radians(rows((37, 101), (left_out or 40,))))[None]
    pairs = Pairs.from_directions(*(torch.from_numpy(asked[..., part]) for part in (slice(3, 6), slice(3))))
    wanted = torch.from_numpy(ggx(pairs.wi.numpy(), pairs.wo.numpy()))[0].log()
    found = measured.at(pairs)[0, :, 0].clamp_min(1e-3).log()
    assert measured.is_anisotropic and (found - wanted).square().mean().sqrt() < 0.15


def test_samples_of_tensors_may_be_said_to_have_one():
    both = torch.from_numpy(unit_vectors(np.radians(rows(range(0, 360, 30)))))[None]
    pairs = Pairs.from_directions(both[..., 3:], both[..., :3])
    values = torch.from_numpy(brushed(pairs.wi.numpy(), pairs.wo.numpy()))[..., None].expand(-1, -1, 3)
    measured = Measured.from_samples(pairs, values)
    measured.source.is_anisotropic = True
    torch.testing.assert_close(measured.at(pairs), values, rtol=1e-6, atol=1e-6)


def test_a_symmetry_that_a_file_says_is_kept(tmp_path):
    """Of several rotations with one half of the azimuths, the other half is the mirror image."""
    text = zemax(lights=(10, 40), radials=(0, 10, 20, 40, 60))
    head, body = text.split("DataBegin\n")
    block = body.split("DataEnd")[0]
    many = (
        head.replace("SampleRotation\t1\n0", "SampleRotation\t2\n0\t90") + "DataBegin\n" + block + block + "DataEnd\n"
    )
    path = tmp_path / "two.bsdf"
    path.write_text(many)
    measured = load(path, dtype=torch.float64)
    facts = describe(path)
    assert facts["mirrored"] == "at the plane of incidence, as the symmetry says"
    assert facts["samples"] == 2 * 2 * 2 * 10 * 5 and not measured.is_anisotropic


def test_real_samples_with_a_grain(data):
    """A lens array, turned by 10 degrees each: what is left out is predicted better than by the mean of all turns."""
    path = data / "formats" / "zemax" / "IMX455.bsdf"
    measured = load(path, dtype=torch.float64)
    assert measured.is_anisotropic and describe(path)["anisotropic"].startswith("36 azimuths of the light")
    valid = (measured.weight[0, :, 0] > 0).nonzero()[:, 0]
    out = torch.zeros(len(valid), dtype=torch.bool).index_fill_(0, torch.arange(0, len(valid), 4), True)
    kept, asked = valid[~out], measured.pairs.select(samples=valid[out][::10])
    wanted = measured.values[0, valid[out][::10], 0].clamp_min(1e-3).log()
    off = {}
    for grain in (True, False):
        part = Measured.from_samples(measured.pairs.select(samples=kept), measured.values[:, kept])
        part.source.is_anisotropic = grain
        off[grain] = (part.at(asked)[0, :, 0].clamp_min(1e-3).log() - wanted).square().mean().sqrt().item()
    assert off[True] < 0.85 * off[False]
