"""Values in any number of bands: of tensors, and of files whose bands are kept."""

import pickle

import pytest
import torch
from helpers.directions import hemisphere

from torchbrdf.errors import ShapeError
from torchbrdf.measured import Measured
from torchbrdf.pairs import Pairs


def pairs_of(count):
    return Pairs.from_directions(hemisphere(1, count), hemisphere(1, count, seed=1))


@pytest.mark.parametrize("channels", [1, 2, 3, 31])
def test_samples_in_any_number_of_bands(channels):
    values = torch.rand(2, 40, channels, generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 0.1
    lengths = [400.0 + 10 * k for k in range(channels)]
    measured = Measured.from_samples(pairs_of(40), values, wavelengths=lengths)
    assert (measured.channels, measured.wavelengths) == (channels, tuple(lengths))
    assert torch.equal(measured.values, values)
    assert torch.equal(measured.at(measured.pairs, "nearest"), values)
    assert measured.at(pairs_of(7)).shape == (2, 7, channels)
    again = pickle.loads(pickle.dumps(measured.batch([1])))
    assert again.wavelengths == measured.wavelengths and torch.equal(again.values, values[1:])
    assert Measured.from_samples(pairs_of(40), values).wavelengths is None


@pytest.mark.parametrize(
    ("lengths", "found"),
    [
        ([400, 500], "expected 3, one for each channel, found 2"),
        ([500, 400, 600], "expected numbers that grow, in nm"),
        ([-1, 400, 600], "expected numbers that grow, in nm"),
        ([400, float("nan"), 600], "expected numbers that grow, in nm"),
        ("rgb", "expected 3 numbers, in nm, found 'rgb'"),
        (5, "expected 3 numbers, in nm, found 5"),
    ],
)
def test_wavelengths_are_checked(lengths, found):
    with pytest.raises(ShapeError, match=found):
        Measured.from_samples(pairs_of(4), torch.ones(1, 4, 3), wavelengths=lengths)


def test_a_value_has_a_channel():
    with pytest.raises(ShapeError, match=r"expected values \(M, 4, C\), found \(1, 4, 0\)"):
        Measured.from_samples(pairs_of(4), torch.ones(1, 4, 0))
