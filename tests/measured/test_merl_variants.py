"""MERL's tables with phi_d all around, and in single precision."""

import math
import pickle
import struct

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import synthetic_raw

from torchbrdf.errors import DataError
from torchbrdf.measured import load
from torchbrdf.pairs import Pairs

SCALES = torch.tensor([1.0, 1.15, 1.66], dtype=torch.float64) / 1500


def written(folder, raw, kind, name="made-up.binary"):
    path = folder / name
    path.write_bytes(struct.pack("<3i", *raw.shape[1:]) + np.ascontiguousarray(raw, kind).tobytes())
    return path


def all_around(light_counts=2.0):
    """A table of 90 x 90 x 360 whose values say which of light and viewer is nearer to the normal."""
    h, d, p = np.meshgrid(*(np.arange(size) + 0.5 for size in (90, 90, 360)), indexing="ij")
    h, d, p = (h / 90) ** 2 * np.pi / 2, np.radians(d), np.radians(p)
    difference = np.sin(h) * np.sin(d) * np.cos(p)  # half of cos_o - cos_i
    even = np.cos(h) * np.cos(d)
    raw = 1500 * (1 + light_counts * (even - difference) + 0.5 * (even + difference))
    raw[even <= np.abs(difference)] = -1
    return np.stack([raw, raw / 2, raw / 4])


def expected(wi, wo):
    return 1 + 2 * wi[..., 2] + 0.5 * wo[..., 2]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return written(tmp_path_factory.mktemp("whole"), all_around(), "<f8")


def test_light_and_viewer_are_told_apart(whole):
    assert whole.stat().st_size == 69_984_012
    measured = load(whole, dtype=torch.float64)
    assert measured.source.format == "merl360" and not measured.source.is_reciprocal and not measured.on_merl_bins
    wi, wo = (hemisphere(1, 4000, seed=seed).double() for seed in (0, 1))
    wi, wo = (one[:, (wi[0, :, 2] > 0.25) & (wo[0, :, 2] > 0.25)] for one in (wi, wo))
    for light, viewer in ((wi, wo), (wo, wi)):
        found = measured.at(Pairs.from_directions(light, viewer))[0]
        wanted = expected(light, viewer)[0, :, None] * torch.tensor([1.0, 1.15 / 2, 1.66 / 4]).double()
        torch.testing.assert_close(found, wanted, rtol=0.01, atol=0.01)
    # In the plane of incidence phi_d is 0 or 180 degrees.
    theta = torch.linspace(0.1, 1.1, 6).double()
    light = torch.stack([theta.sin(), 0 * theta, theta.cos()], -1)
    viewer = torch.stack([-(theta / 2).sin(), 0 * theta, (theta / 2).cos()], -1)
    for one, other in ((light, viewer), (viewer, light)):
        found = measured.at(Pairs.from_directions(one, other))[0, :, 0]
        torch.testing.assert_close(found, expected(one, other), rtol=0.01, atol=0.01)
    torch.testing.assert_close(
        measured.reciprocal_at(Pairs.from_directions(light, viewer)),
        measured.reciprocal_at(Pairs.from_directions(viewer, light)),
    )


def test_bins_are_where_they_are(whole):
    measured = load(whole, dtype=torch.float64)
    count = len(measured.pairs)
    assert 2_000_000 < count < 90 * 90 * 360
    some = measured.batch(samples=torch.arange(0, count, 997))
    wanted = expected(some.pairs.wi, some.pairs.wo)
    torch.testing.assert_close(some.values[..., 0], wanted)
    torch.testing.assert_close(some.at(some.pairs), some.values)
    assert len(pickle.dumps(measured)) < 20_000


def test_single_precision_is_the_same_table(merl_file, tmp_path):
    raw = synthetic_raw(0)
    path = written(tmp_path, raw, "<f4")
    assert path.stat().st_size == 17_496_012
    measured, double = load(path, dtype=torch.float64), load(merl_file, dtype=torch.float64)
    assert measured.source.format == "merl_single" and measured.source.is_reciprocal and measured.on_merl_bins
    assert torch.equal(measured.weight, double.weight)
    torch.testing.assert_close(measured.values, double.values, rtol=1e-6, atol=0)
    angle = torch.linspace(0, math.pi / 3, 20)[None].double()
    asked = Pairs.from_half_diff(angle, angle / 2, angle)
    torch.testing.assert_close(measured.at(asked), double.at(asked), rtol=1e-5, atol=0)


def test_both(tmp_path):
    """As many bytes as MERL's own: the dimensions say which it is."""
    path = written(tmp_path, all_around(), "<f4")
    assert path.stat().st_size == 34_992_012
    measured = load(path, dtype=torch.float64)
    assert measured.source.format == "merl360_single"
    some = measured.batch(samples=torch.arange(0, len(measured.pairs), 9973))
    torch.testing.assert_close(some.values[..., 0], expected(some.pairs.wi, some.pairs.wo), rtol=1e-5, atol=1e-5)


def test_a_file_that_is_cut(tmp_path):
    path = written(tmp_path, all_around()[:, :1], "<f8")
    with path.open("r+b") as file:
        file.write(struct.pack("<3i", 90, 90, 360))
    with pytest.raises(DataError, match=r"made-up.binary: truncated: expected 69984012 bytes, found 777612"):
        load(path)
