"""Luminance, and powers whose gradient is finite."""

import pytest
import torch

from torchbrdf.color import LUMINANCE, luminance, safe_power


def test_luminance_weighs_the_channels():
    assert sum(LUMINANCE) == pytest.approx(1, abs=1e-12)
    rgb = torch.eye(3, dtype=torch.float64)
    assert luminance(rgb).tolist() == list(LUMINANCE)
    assert luminance(rgb.expand(2, 3, 3)).shape == (2, 3)


@pytest.mark.parametrize("exponent", [1 / 3, 0.5, 1 / 2.2])
def test_powers_have_a_gradient_everywhere(exponent):
    x = torch.tensor([-1.0, 0.0, 1e-30, 0.25, 9.0], dtype=torch.float64, requires_grad=True)
    found = safe_power(x, exponent)
    (slope,) = torch.autograd.grad(found.sum(), x)
    with torch.no_grad():
        assert found[:2].tolist() == [0, 0] and slope[:2].tolist() == [0, 0]
        torch.testing.assert_close(found[2:], x[2:] ** exponent)
        torch.testing.assert_close(slope[2:], exponent * x[2:] ** (exponent - 1))


def test_what_is_not_a_number_stays_so():
    assert bool(safe_power(torch.tensor([torch.nan]), 0.5).isnan().all())
