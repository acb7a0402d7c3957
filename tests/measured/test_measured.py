"""Measured: parts, dtypes, what is read and when; and what `describe` says."""

import json
import math
import os
import resource

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import merl_above, synthetic_bsdf, synthetic_raw, table_of, tensor_file

from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.measured import Measured, describe, load
from torchbrdf.pairs import Pairs


@pytest.fixture
def table(merl_file):
    return load(merl_file, dtype=torch.float64)


@pytest.fixture
def felts(tmp_path):
    for k, size in enumerate((6, 8, 7)):
        (tmp_path / f"felt{k}.bsdf").write_bytes(tensor_file(synthetic_bsdf(k, size)))
    return load(tmp_path, dtype=torch.float64)


@pytest.fixture
def samples():
    pairs = Pairs.from_directions(hemisphere(1, 20), hemisphere(1, 20, seed=1))
    return Measured.from_samples(pairs, hemisphere(3, 20, seed=2).abs(), names=["a", "b", "c"])


@pytest.mark.parametrize("which", ["table", "felts", "samples"])
def test_parts_are_parts(which, request):
    measured = request.getfixturevalue(which)
    whole, weight = measured.values, measured.weight
    assert weight.shape == (*whole.shape[:2], 1) == (len(measured), len(measured.pairs), 1)
    assert ((weight == 0) | (weight == 1)).all()
    assert (whole[weight[..., 0] == 0] == 0).all()
    materials = [len(measured) - 1, 0]
    some = torch.tensor([3, 1, 19, 7])
    part = measured.batch(materials, some)
    assert part.names == [measured.names[k] for k in materials]
    assert torch.equal(part.values, whole[materials][:, some])
    assert torch.equal(part.weight, weight[materials][:, some])
    assert torch.equal(part.pairs.cos_i.expand(2, 4), measured.pairs.cos_i.expand(*whole.shape[:2])[materials][:, some])
    again = part.batch([0], torch.tensor([2, 0]))
    assert torch.equal(again.values, whole[materials[:1]][:, some[[2, 0]]])
    assert torch.equal(again.to(dtype=torch.float32).values, again.values.float())
    assert again.to(dtype=torch.float32).pairs.dtype == torch.float32
    assert repr(measured).startswith(f"Measured({measured.source.format}: {measured.names[0]}")


@pytest.mark.parametrize("which", ["table", "felts", "samples"])
@pytest.mark.parametrize("limit", [80, 45.5])
def test_within_leaves_out_grazing_pairs(which, limit, request):
    measured = request.getfixturevalue(which)
    limited = measured.within(limit)
    lowest = math.cos(math.radians(limit)) - 1e-12
    low = ((measured.pairs.cos_i >= lowest) & (measured.pairs.cos_o >= lowest)).expand(*measured.values.shape[:2])
    kept = limited.weight[..., 0] > 0
    assert limited.max_theta == limit
    assert kept.sum() == (low & (measured.weight[..., 0] > 0)).sum() > 0
    assert (limited.pairs.cos_i.expand_as(kept)[kept] >= lowest).all()
    assert (limited.pairs.cos_o.expand_as(kept)[kept] >= lowest).all()
    assert limited.values.sum() == pytest.approx(measured.values[low].sum().item(), rel=1e-12)
    assert len(limited) == len(measured)


@pytest.mark.parametrize("which", ["table", "felts", "samples"])
def test_what_was_read_is_not_read_again(which, request, monkeypatch):
    """By the same materials within the same angle, nor by a run of them; others are read."""
    measured = request.getfixturevalue(which).within(80)
    assert measured.within(80) is measured.within(85) is measured.to(dtype=measured.dtype) is measured
    unread = measured.batch([0])
    values, weight = measured.values, measured.weight
    last = len(measured) - 1
    monkeypatch.setattr(type(measured.source), "read", lambda *_: pytest.fail("read again"))
    for rows in (None, [0], [last], list(range(len(measured)))):
        part = measured.batch(rows)
        expected = slice(None) if rows is None else rows
        assert torch.equal(part.values, values[expected])
        assert torch.equal(part.weight, weight[expected])
        assert part.values.untyped_storage().data_ptr() == values.untyped_storage().data_ptr()
    with pytest.raises(pytest.fail.Exception):
        unread.values  # noqa: B018 (was made before)
    assert measured.within(40).max_theta == 40


@pytest.mark.parametrize("limit", [0, -1, 90.5, math.nan])
def test_within_refuses(samples, limit):
    with pytest.raises(UsageError, match="max_theta: expected an angle above 0 and at most 90"):
        samples.within(limit)


def test_at_checks_what_it_is_given(felts, samples):
    pairs = Pairs.from_directions(hemisphere(5), hemisphere(5, seed=1))
    assert felts.at(pairs).shape == (3, 5, 3)
    with pytest.raises(ShapeError, match=r"at: expected pairs \(3 or 1, N\), found \(2, 5\)"):
        felts.at(Pairs.from_directions(hemisphere(2, 5), hemisphere(2, 5, seed=1)))
    with pytest.raises(UsageError, match=r"unknown interpolation 'linaer'.*did you mean 'linear'"):
        felts.at(pairs, "linaer")
    assert samples.at(pairs).shape == (3, 5, 3)


@pytest.mark.slow
def test_hundred_tables_cost_little_memory(merl_file, tmp_path):
    for k in range(100):
        os.link(merl_file, tmp_path / f"table{k:03}.binary")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    measured = load(tmp_path)
    assert len(measured) == 100
    albedo = measured.diffuse_45_0()
    some = torch.arange(0, len(measured.pairs), 200)
    assert measured.batch(samples=some).values.shape == (100, len(some), 3)
    pairs = Pairs.from_directions(*(hemisphere(1, 50_000, seed=s, dtype=torch.float32) for s in (0, 1)))
    looked = measured.batch(range(14)).at(pairs)
    assert torch.equal(looked[0], looked[13])
    assert (albedo == albedo[0]).all()
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 1.2e6, f"{grown / 1e6:.2f} GB"  # kilobytes; 100 tables are 3.5 GB


def test_describe_a_merl_table(merl_file):
    values, valid = table_of(synthetic_raw(0))
    facts = describe(merl_file)
    assert facts["format"] == "merl"
    assert facts["bytes"] == 34_992_012
    assert facts["materials"] == ["made-up"]
    assert facts["samples"] == merl_above().sum()
    assert facts["valid samples"] == valid.sum()
    assert facts["invalid share of all bins"] == pytest.approx(1 - valid.mean())
    assert facts["invalid share of bins above the horizon"] == pytest.approx(1 - valid[merl_above()].mean())
    assert facts["MERL's own"].startswith("no")
    assert facts["lowest value, 1/sr"] == values[valid].min(0).tolist()
    assert facts["highest value, 1/sr"] == values[valid].max(0).tolist()
    assert facts["diffuse albedo pi f(45:0)"] == load(merl_file, dtype=torch.float64).diffuse_45_0()[0].tolist()
    json.dumps(facts, default=int)


def test_describe_an_rgl_file(tmp_path):
    fields = synthetic_bsdf()
    (tmp_path / "felt_rgb.bsdf").write_bytes(tensor_file(fields))
    facts = describe(tmp_path / "felt_rgb.bsdf")
    assert facts["materials"] == ["felt"]
    assert facts["samples"] == 5 * 8 * 8
    negative = (fields["rgb"] < 0).mean((0, 1, 3, 4)).tolist()
    assert facts["share of stored values that are negative"] == pytest.approx(negative)
    assert 0 < facts["samples with a negative channel"] < facts["valid samples"]
    assert np.isfinite(facts["contrast gloss"])
    json.dumps(facts)


def test_describe_needs_a_measurement(tmp_path):
    (tmp_path / "x.txt").write_text("hello")
    with pytest.raises(DataError, match=r"x\.txt: expected a measured BRDF"):
        describe(tmp_path / "x.txt")


def test_what_says_nothing_of_a_grain_has_none():
    """A source says whether its values depend on azimuths; those that do not are isotropic."""
    angle = torch.full((1, 1), 0.1, dtype=torch.float64)
    measured = Measured.from_samples(Pairs.from_half_diff(angle, angle, angle), torch.ones(1, 1, 3))
    assert not measured.is_anisotropic
    measured.source.is_anisotropic = True
    assert measured.is_anisotropic and measured.batch([0]).is_anisotropic
