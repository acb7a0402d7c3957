"""What was measured as workers get it: pickled without what can be read again."""

import pickle

import torch
from helpers.known_models import measured_from, some_pairs, two_lobes

from torchbrdf.measured import load, standins


def assert_same(measured, most_bytes):
    measured.values  # noqa: B018 - what is read stays here
    data = pickle.dumps(measured)
    assert len(data) < most_bytes
    found = pickle.loads(data)
    assert found.names == measured.names and found.max_theta == measured.max_theta
    assert torch.equal(found.values, measured.values) and torch.equal(found.weight, measured.weight)
    assert torch.equal(found.pairs.cos_i, measured.pairs.cos_i)


def test_tables_are_pickled_as_their_paths(merl_file):
    assert_same(load(merl_file).batch(samples=torch.arange(0, 900_000, 1000)), 20_000)


def test_stand_ins_are_pickled_as_their_records():
    assert_same(load(standins()).batch([3, 1], torch.arange(0, 900_000, 1000)), 100_000)


def test_values_in_memory_are_pickled_of_these_materials_only():
    whole = measured_from(two_lobes("ward", 8), some_pairs(2000), materials=8)
    part = whole.batch([6, 2])
    assert_same(part, len(pickle.dumps(whole)) / 2 + 300_000)
    assert part.source is whole.source
