"""MERL tables: bit for bit, and against plain loops over bins."""

import filecmp
import itertools
import math
import os
import struct

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import BINS, SCALE, merl_above, merl_centres, synthetic_raw, table_of, write_raw_merl
from hypothesis import given
from hypothesis import strategies as st

from torchbrdf.errors import DataError, ShapeError
from torchbrdf.measured import Merl, load, merl, write_merl, write_raw
from torchbrdf.pairs import Pairs

BYTES = 12 + 3 * 8 * 90 * 90 * 180


@pytest.fixture(scope="module")
def table():
    return table_of(synthetic_raw(0))


@pytest.fixture
def source(merl_file):
    return Merl.open([merl_file])


def random_pairs(count, seed=0, dtype=torch.float64):
    return Pairs.from_directions(
        hemisphere(1, count, seed=seed, dtype=dtype), hemisphere(1, count, seed=seed + 1, dtype=dtype)
    )


def fractional(pairs):
    """Where pairs lie between bin centres, by the angles of wi about the half vector, as MERL's own reader has them."""
    wi, wo = pairs.wi[0].numpy(), pairs.wo[0].numpy()
    h = wi + wo
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    theta_h, phi_h = np.arccos(h[:, 2]), np.arctan2(h[:, 1], h[:, 0])
    c, s = np.cos(-phi_h), np.sin(-phi_h)
    x, y, z = c * wi[:, 0] - s * wi[:, 1], s * wi[:, 0] + c * wi[:, 1], wi[:, 2]
    c, s = np.cos(-theta_h), np.sin(-theta_h)
    x, z = c * x + s * z, -s * x + c * z
    phi_d = np.arctan2(y, x)
    phi_d = np.where(phi_d < 0, phi_d + np.pi, phi_d)
    degrees = np.degrees([theta_h, np.arccos(z), phi_d])
    return np.stack([np.sqrt(degrees[0] * 90), degrees[1], degrees[2]], -1) - 0.5


def loop_trilinear(values, valid, position):
    """Values and whether there was no valid neighbour, one pair at a time."""
    found, missing = np.zeros((len(position), 3)), np.zeros(len(position), bool)
    cells = np.argwhere(valid)
    for n, place in enumerate(position):
        low = np.floor(place).astype(int)
        total, share = np.zeros(3), 0.0
        for step in itertools.product((0, 1), repeat=3):
            weight = np.prod(np.where(step, place - low, low + 1 - place))
            h, d, p = low + step
            p = {-1: 0, 180: 179}.get(p, p)
            bin_ = min(max(h, 0), 89), min(max(d, 0), 89), p
            if valid[bin_]:
                total, share = total + weight * values[bin_], share + weight
        missing[n] = share == 0
        if missing[n]:
            centre = np.clip(np.floor(place + 0.5), 0, np.array(BINS) - 1)
            distance = np.square(cells - centre).sum(-1)
            total, share = values[tuple(cells[distance.argmin()])], 1
        found[n] = total / share
    return found, missing


def test_reads_what_was_written(source, table, merl_file):
    values, valid = table
    above = merl_above()
    read, weight = source.read([0], slice(None))
    assert torch.equal(weight[0, :, 0] > 0, torch.from_numpy(valid[above]))
    expected = np.where(valid[..., None], values, 0)[above]
    assert torch.equal(read[0], torch.from_numpy(expected))
    some = torch.tensor([5, 0, 1_000_000])
    assert torch.equal(source.read([0], some)[0], read[:, some])
    assert load(merl_file).values.dtype == torch.float32


def test_pairs_are_the_bin_centres(source):
    theta_h, theta_d, phi_d = (torch.from_numpy(angle[merl_above()]) for angle in merl_centres())
    assert source.pairs.shape == (1, merl_above().sum())
    torch.testing.assert_close(source.pairs.theta_h[0], theta_h, rtol=1e-15, atol=0)
    torch.testing.assert_close(source.pairs.theta_d[0], theta_d, rtol=1e-15, atol=0)
    torch.testing.assert_close(source.pairs.phi_d[0], phi_d, rtol=1e-15, atol=0)
    assert source.pairs.above_horizon.all()


def test_round_trip_of_the_file_is_bit_for_bit(source, merl_file, tmp_path):
    copy = tmp_path / "copy.binary"
    write_raw(copy, source.raw(0))
    assert filecmp.cmp(copy, merl_file, shallow=False)
    assert [file.name for file in tmp_path.iterdir()] == ["copy.binary"]


def test_round_trip_of_the_values_is_bit_for_bit(source, table, tmp_path):
    values, valid = table
    written = np.where(valid[..., None], values, np.nan)
    write_merl(tmp_path / "again.binary", written)
    again = Merl.open([tmp_path / "again.binary"])
    for first, second in zip(source.read([0], slice(None)), again.read([0], slice(None)), strict=True):
        assert torch.equal(first, second)
    assert (again.raw(0)[:, ~valid] == -1).all()


def test_any_values_come_back_within_a_rounding(monkeypatch, tmp_path):
    monkeypatch.setattr(merl, "BINS", (4, 4, 8))
    monkeypatch.setattr(merl, "COUNT", 128)
    wanted = np.exp(np.random.default_rng(0).uniform(-20, 20, (4, 4, 8, 3)))
    write_merl(tmp_path / "small.binary", wanted)
    raw = np.fromfile(tmp_path / "small.binary", "<f8", offset=12).reshape(3, 4, 4, 8)
    found = np.moveaxis(raw, 0, -1) * SCALE
    assert (np.abs(found - wanted) <= np.spacing(wanted)).all()
    assert (found == wanted).mean() > 0.7
    write_merl(tmp_path / "small.binary", torch.from_numpy(found))
    raw = np.fromfile(tmp_path / "small.binary", "<f8", offset=12).reshape(3, 4, 4, 8)
    assert (np.moveaxis(raw, 0, -1) * SCALE == found).all()


@pytest.mark.parametrize("largest", [0, 1 << 20], ids=["whole table", "only neighbours"])
def test_at_the_bin_centres(source, table, monkeypatch, largest):
    monkeypatch.setattr(merl, "LARGEST_DIRECT_LOOKUP", largest)
    values, valid = table
    some = np.random.default_rng(1).choice(np.flatnonzero(valid), 20_000)
    angles = (torch.from_numpy(angle.reshape(-1)[some])[None] for angle in merl_centres())
    pairs = Pairs.from_half_diff(*angles)
    expected = torch.from_numpy(values.reshape(-1, 3)[some])
    nearest = source.at(pairs, [0], "nearest")
    assert torch.equal(nearest.values[0], expected)
    assert nearest.filled.tolist() == [0]
    linear = source.at(pairs, [0], "linear").values[0]
    # Neighbours' weights are the rounding of the position, and their values up to 1e4 times this one's.
    assert ((linear - expected).abs() <= 1e-12 * expected.max()).all()


@pytest.mark.parametrize("largest", [0, 1 << 20], ids=["whole table", "only neighbours"])
def test_at_any_pairs_is_what_a_loop_finds(source, table, monkeypatch, largest):
    monkeypatch.setattr(merl, "LARGEST_DIRECT_LOOKUP", largest)
    values, valid = table
    pairs = random_pairs(400)
    expected, missing = loop_trilinear(values, valid, fractional(pairs))
    found = source.at(pairs, [0], "linear")
    assert np.allclose(found.values[0][~missing], expected[~missing], rtol=1e-9, atol=0)
    assert found.filled.item() == missing.sum()


@pytest.mark.parametrize("largest", [0, 1 << 20], ids=["whole table", "only neighbours"])
def test_where_no_neighbour_is_valid_the_nearest_valid_bin_is(source, table, monkeypatch, largest):
    monkeypatch.setattr(merl, "LARGEST_DIRECT_LOOKUP", largest)
    values, valid = table
    rng = np.random.default_rng(2)
    place = np.stack([rng.uniform(41, 45, 60), rng.uniform(21, 25, 60), rng.uniform(31, 58, 60)], -1)
    h, d, p = torch.from_numpy(place.T + 0.5)
    pairs = Pairs.from_half_diff(
        (h / 90).square()[None] * math.pi / 2, d[None] / 180 * math.pi, p[None] / 180 * math.pi
    )
    found = source.at(pairs, [0], "linear")
    assert found.filled.item() == 60
    cells = np.argwhere(valid)
    for n in range(60):
        distance = np.square(cells - np.floor(place[n] + 0.5)).sum(-1)
        candidates = values[tuple(cells[distance == distance.min()].T)]
        assert (candidates == found.values[0, n].numpy()).all(-1).any()


def test_mirrored_at_the_ends_of_phi_d(source):
    near = torch.tensor([[0.2, 179.8]], dtype=torch.float64) * math.pi / 180
    centre = torch.tensor([[0.5, 179.5]], dtype=torch.float64) * math.pi / 180
    angle = torch.full((1, 2), 0.3, dtype=torch.float64)
    at_end = source.at(Pairs.from_half_diff(angle, angle, near), [0], "linear").values
    at_centre = source.at(Pairs.from_half_diff(angle, angle, centre), [0], "linear").values
    torch.testing.assert_close(at_end, at_centre, rtol=1e-12, atol=0)


def test_nearest_is_the_bin_of_merls_own_reader(source, table):
    values, valid = table
    pairs = random_pairs(5000, seed=7)
    bins = np.clip(np.floor(fractional(pairs) + 0.5).astype(int), 0, np.array(BINS) - 1)
    known = valid[tuple(bins.T)]
    assert known.mean() > 0.8
    found = source.at(pairs, [0], "nearest").values[0].numpy()
    assert (found[known] == values[tuple(bins[known].T)]).all()


def test_float32_and_several_materials(source, merl_file, tmp_path, monkeypatch):
    other = tmp_path / "other.binary"
    os.link(merl_file, other)
    two = Merl.open([merl_file, other])
    pairs = random_pairs(3000)
    exact = source.at(pairs, [0], "linear").values
    monkeypatch.setattr(merl, "LARGEST_DIRECT_LOOKUP", 0)
    monkeypatch.setattr("torchbrdf.measured.grid.CHUNK", 700)
    found = two.at(pairs.to(dtype=torch.float32), [1, 0], "linear")
    assert found.values.dtype == torch.float32
    assert found.values.shape == (2, 3000, 3)
    assert torch.equal(found.values[0], found.values[1])
    close = ((found.values[0] - exact[0]).abs() <= 1e-3 * exact[0]).all(-1)
    assert close.float().mean() > 0.99  # the rest has a valid neighbour of almost no weight, lost in rounding
    own = Pairs.from_directions(
        torch.cat([random_pairs(50, seed=s).wi for s in (1, 3)]),
        torch.cat([random_pairs(50, seed=s).wo for s in (1, 3)]),
    )
    found_own = two.at(own, [0, 1], "linear").values
    for row in (0, 1):
        assert torch.equal(found_own[row], two.at(own.select([row]), [row], "linear").values[0])


def test_zero_below_the_horizon(source):
    wi = hemisphere(1, 100)
    below = wi * torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
    for pairs in (Pairs.from_directions(wi, below), Pairs.from_directions(below, wi), Pairs.from_directions(wi, -wi)):
        found = source.at(pairs, [0], "linear")
        assert (found.values == 0).all()
        assert found.filled.item() == 0


def test_45_0_is_the_mean_of_the_bins_around(merl_file, table):
    values, valid = table
    position = np.array([[math.sqrt(22.5 * 90) - 0.5, 22.5 - 0.5, -0.5]])
    expected, _ = loop_trilinear(values, valid, position)
    measured = load(merl_file, dtype=torch.float64)
    around = [values[h, 22, 0] for h in (44, 45) if valid[h, 22, 0]]
    np.testing.assert_allclose(expected[0], np.mean(around, 0), rtol=1e-12)
    np.testing.assert_allclose(measured.diffuse_45_0()[0], (math.pi * expected[0]).clip(0, 1), rtol=1e-12)


def sparse(path, size, dims=BINS):
    with path.open("wb") as file:
        file.write(struct.pack("<3i", *dims))
        file.truncate(size)
    return path


@pytest.mark.parametrize(
    ("size", "dims", "says"),
    [
        (BYTES - 8, BINS, r"truncated: expected 34992012 bytes, found 34992004"),
        (12, BINS, r"truncated: expected 34992012 bytes, found 12"),
        (BYTES + 1, BINS, r"too long: expected 34992012 bytes, found 34992013"),
        (BYTES, (180, 90, 90), r"expected 90 x 90 x 180 bins .*, found 180 x 90 x 90; they are in another order"),
        (BYTES + 8, (90, 90, 360), r"truncated: expected 69984012 bytes, found 34992020"),
        (12 + 24 * 90 * 90 * 360 + 8, (90, 90, 360), r"too long: expected 69984012 bytes, found 69984020"),
        (12 + 24 * 8, (2, 2, 2), r"found 2 x 2 x 2"),
        (BYTES, (2**31 - 1, 2**31 - 1, 2**31 - 1), r"found 2147483647 x"),
        (BYTES, (-90, -90, 180), r"found -90 x -90 x 180"),
        (5, BINS, r"expected a MERL table of 34992012 bytes, found 5"),
    ],
)
@pytest.mark.parametrize("name", ["nickel.binary", "nickel"])
def test_bad_files(tmp_path, size, dims, says, name):
    path = sparse(tmp_path / name, size, dims)
    if size < 12 and name == "nickel":
        says = "expected a measured BRDF"
    with pytest.raises(DataError, match=says) as caught:
        load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ("<3i", "expected little-endian entries, found big-endian ones; swap the bytes of each"),
        (">3i", "header: expected little-endian numbers, found big-endian ones; swap the bytes of the header's int32"),
    ],
)
@pytest.mark.parametrize("name", ["nickel.binary", "nickel"])
def test_swapped_bytes_are_told(tmp_path, header, says, name):
    path = write_raw_merl(tmp_path / name, synthetic_raw().byteswap())
    with path.open("r+b") as file:
        file.write(struct.pack(header, *BINS))
    with pytest.raises(DataError, match=rf"{name}: {says}"):
        load(path)


def test_a_file_that_is_cut_short_later_is_an_error(merl_file, tmp_path):
    path = tmp_path / "cut.binary"
    path.write_bytes(merl_file.read_bytes())
    measured = load(path)
    os.truncate(path, 10_000)
    for read in (lambda: measured.values, lambda: measured.at(random_pairs(10)), measured.diffuse_45_0):
        with pytest.raises(DataError, match=rf"cut.binary: truncated: expected {BYTES} bytes, found 10000"):
            read()
    path.unlink()
    with pytest.raises(DataError, match=r"cut.binary: expected a MERL table, found No such file"):
        _ = measured.values


def test_entries_that_overflow_are_invalid(tmp_path):
    raw = synthetic_raw()
    raw[1, 3] = 1e300
    measured = load(write_raw_merl(tmp_path / "huge.binary", raw))
    assert measured.values.isfinite().all() and measured.values.square().sum(-1).isfinite().all()
    assert measured.at(random_pairs(1000, dtype=torch.float32)).isfinite().all()


def test_table_with_entries_below_the_horizon_only(tmp_path):
    path = write_raw_merl(tmp_path / "bad.binary", np.where(merl_above(), -1.0, 1.0) * np.ones((3, *BINS)))
    with pytest.raises(DataError, match=r"bad.binary: no valid entry"):
        load(path)


@pytest.mark.parametrize("fill", [np.nan, -1.0])
def test_table_without_a_valid_entry(tmp_path, fill):
    path = write_raw_merl(tmp_path / "bad.binary", np.full((3, *BINS), fill))
    with pytest.raises(DataError, match=r"bad.binary: no valid entry"):
        load(path)


def test_one_valid_entry_is_enough(tmp_path):
    raw = np.full((3, *BINS), np.nan)
    raw[:, 80, 3, 77] = 1500
    measured = load(write_raw_merl(tmp_path / "one.binary", raw), dtype=torch.float64)
    assert measured.weight.sum() == 1
    assert measured.values.sum() == pytest.approx(1 + 1.15 + 1.66)
    looked = measured.lookup(random_pairs(50))
    assert torch.allclose(looked.values[0], torch.tensor([1, 1.15, 1.66], dtype=torch.float64))
    assert looked.filled.item() >= 49


@given(st.binary(max_size=200), st.sampled_from(["x.binary", "x"]))
def test_any_bytes_are_a_clear_error(tmp_path_factory, content, name):
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(content)
    with pytest.raises(DataError, match=name):
        load(path)


@given(st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3), st.integers(0, BYTES + 100))
def test_any_header_is_a_clear_error(tmp_path_factory, dims, size):
    path = sparse(tmp_path_factory.getbasetemp() / "x.binary", size, dims)
    with pytest.raises(DataError, match=r"x\.binary"):
        load(path)


def test_writing_refuses(tmp_path):
    with pytest.raises(ShapeError, match=r"expected values \(90, 90, 180, 3\), found \(90, 90, 3\)"):
        write_merl(tmp_path / "x.binary", np.zeros((90, 90, 3)))
    with pytest.raises(ShapeError, match=r"expected entries \(3, 90, 90, 180\)"):
        write_raw(tmp_path / "x.binary", np.zeros((90, 90, 180, 3)))
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match=r"x\.binary: cannot be written"):
        write_raw(tmp_path / "file" / "x.binary", np.zeros((3, *BINS)))
    assert [file.name for file in tmp_path.iterdir()] == ["file"]
