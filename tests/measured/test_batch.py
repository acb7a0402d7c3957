"""Some of the materials, and some of the samples."""

import pytest
import torch

from torchbrdf.errors import UsageError
from torchbrdf.measured import Measured, load, standins


@pytest.fixture(scope="module")
def five() -> Measured:
    return load(standins()).batch(range(5))


def test_indices_may_count_from_the_end(five: Measured) -> None:
    assert five.batch([-1, 0]).names == [five.names[4], five.names[0]]
    assert five.batch([]).names == []


@pytest.mark.parametrize("wrong", [5, -6, 10**30, "nickel", 1.0, None])
def test_a_material_that_is_not_there_is_said(five: Measured, wrong: object) -> None:
    with pytest.raises(UsageError, match=r"^batch: expected materials 0 to 4, found ") as caught:
        five.batch([0, wrong])  # type: ignore[list-item]
    assert "\n" not in str(caught.value)


def test_of_no_material_there_is_none(five: Measured) -> None:
    with pytest.raises(UsageError, match=r"^batch: expected no material, since there is none, found 0$"):
        five.batch([]).batch([0])


@pytest.mark.parametrize("wrong", [10, -11])
def test_a_sample_that_is_not_there_is_said(five: Measured, wrong: int) -> None:
    ten = five.batch(samples=torch.arange(10))
    assert len(ten.batch(samples=torch.tensor([9, -10])).pairs) == 2
    with pytest.raises(UsageError, match=rf"^batch: expected samples 0 to 9, found {wrong}$"):
        ten.batch(samples=torch.tensor([0, wrong]))
    with pytest.raises(UsageError, match=r"^batch: expected samples 0 to \d+, found 99999999$"):
        five.batch(samples=torch.tensor([99_999_999]))


def test_what_was_read_is_not_read_again(monkeypatch):
    measured = load(standins()).batch([2, 6])
    some, limited = torch.tensor([5, -1, 70, 5]), measured.within(50.0)
    anew = [measured.batch([1], some), measured.batch([1, 0], some), limited, limited.batch([1]).within(20.0)]
    expected = [(one.values, one.weight) for one in anew]
    measured.values  # noqa: B018 (read)
    known = [measured.batch([1], some), measured.batch([1, 0], some), measured.within(50.0)]
    known.append(known[-1].batch([1]).within(20.0))
    monkeypatch.setattr(type(measured.source), "read", None)
    for one, (values, weight) in zip(known, expected, strict=True):
        assert torch.equal(one.values, values) and torch.equal(one.weight, weight)
