"""PQ, PU21 and Delta E ITP against published numbers and colour-science."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from helpers.picture_pairs import pair
from torch import Tensor

from torchbrdf.images import pq, pu21
from torchbrdf.images.differences.delta_e_itp import DeltaEITP, DeltaEITPHDR

# Display values, the peak, and Delta E ITP by colour-science 0.4.7.
DISPLAYED = [
    ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 100, 365.81593720),
    ((0.5, 0.5, 0.5), (0.51, 0.5, 0.5), 100, 1.81586688),
    ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 100, 322.60186808),
    ((0.2, 0.6, 0.3), (0.25, 0.55, 0.3), 100, 12.67764564),
    ((0.02, 0.01, 0.0), (0.0, 0.01, 0.03), 100, 43.75693999),
    ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1000, 541.31498301),
    ((0.5, 0.5, 0.5), (0.51, 0.5, 0.5), 1000, 2.18297739),
    ((0.9, 0.8, 0.1), (0.9, 0.8, 0.3), 1000, 20.39032667),
]
# Radiance, 203 cd/m^2 for 1.
LIT = [
    ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 418.09546806),
    ((0.01, 0.02, 0.01), (0.02, 0.01, 0.01), 40.70579127),
    ((4.0, 2.0, 1.0), (4.1, 2.0, 1.0), 1.78258465),
    ((30.0, 20.0, 10.0), (20.0, 20.0, 20.0), 44.10282812),
]


def luminances(least: float = 1e-6) -> Tensor:
    return torch.logspace(np.log10(least), 4, 4001, dtype=torch.float64)


def apart(difference: DeltaEITP | DeltaEITPHDR, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Delta E ITP of single colours, `(n, 3)`."""
    one, other = (torch.from_numpy(np.asarray(x, dtype=np.float64))[:, None, None] for x in (first, second))
    return difference(one, other).numpy()


def linear(display: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


# Encodings


def test_pq_ends_where_the_standard_says() -> None:
    # The signal of 100 cd/m^2 is 0.508 in ITU-R BT.2408, table 1; of 203 cd/m^2, 0.58.
    found = pq(torch.tensor([100.0, 203.0, 10_000.0], dtype=torch.float64))
    torch.testing.assert_close(found, torch.tensor([0.508078, 0.580689, 1.0], dtype=torch.float64), atol=1e-6, rtol=0)


def test_pu21_at_what_the_source_says() -> None:
    found = pu21(torch.tensor([0.005, 100.0, 10_000.0], dtype=torch.float64))
    torch.testing.assert_close(found, torch.tensor([0.0, 256.38, 595.39], dtype=torch.float64), atol=6e-3, rtol=0)


@pytest.mark.parametrize(("encode", "knee"), [(pq, 1e-6), (pu21, 0.005)])
def test_encodings_rise_from_black_and_have_slopes_there(encode: Callable[[Tensor], Tensor], knee: float) -> None:
    x = torch.tensor([-1.0, 0.0, 0.3 * knee, knee * (1 - 1e-9), knee, 2 * knee, 1e4, 1e6], dtype=torch.float64)
    found = encode(x.requires_grad_())
    (slope,) = torch.autograd.grad(found.sum(), x)
    assert found[0] == found[1] and slope[0] == 0
    assert (found[1:].diff() >= 0).all() and (slope[1:] > 0).all() and slope.isfinite().all()
    assert found[4].item() == pytest.approx(found[3].item(), abs=1e-7)
    points = torch.tensor([0.2 * knee, 0.9 * knee, 3 * knee, 50.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(encode, points, eps=1e-3 * knee)
    assert torch.allclose(encode(x.float()).double(), found, rtol=0, atol=1e-6 * found.max().item())


def test_pq_against_colour_science() -> None:
    colour = pytest.importorskip("colour")
    x = luminances()
    expected = colour.models.eotf_inverse_ST2084(x.numpy())
    np.testing.assert_allclose(pq(x).numpy(), expected, atol=1e-12)
    np.testing.assert_allclose(pq(x.float()).numpy(), expected, atol=5e-7)
    dark = luminances(1e-9)
    expected = colour.models.eotf_inverse_ST2084(dark.numpy())
    np.testing.assert_allclose(pq(dark).numpy(), expected, atol=3e-5)  # the straight end


# Delta E ITP


def test_delta_e_itp_of_display_values() -> None:
    for first, second, peak, expected in DISPLAYED:
        for one, other in ((first, second), (second, first)):
            found = apart(DeltaEITP(peak), np.array([one]), np.array([other])).item()
            assert found == pytest.approx(expected, abs=1e-7)


def test_delta_e_itp_of_radiance() -> None:
    for first, second, expected in LIT:
        found = apart(DeltaEITPHDR(), np.array([first]), np.array([second])).item()
        assert found == pytest.approx(expected, abs=1e-7)


def test_a_display_shows_what_the_light_is() -> None:
    image, reference, mask = pair()
    shown = DeltaEITP(150)(image, reference, mask)
    light = (torch.from_numpy(linear(x.numpy())) for x in (image, reference))
    torch.testing.assert_close(shown, DeltaEITPHDR(150)(*light, mask), rtol=1e-9, atol=0)


@pytest.mark.parametrize("peak", [100.0, 1000.0])
def test_delta_e_itp_against_colour_science(peak: float) -> None:
    colour = pytest.importorskip("colour")
    generator = np.random.default_rng(0)

    def theirs(light: np.ndarray) -> np.ndarray:
        there = colour.RGB_to_RGB(light, "ITU-R BT.709", "ITU-R BT.2020", apply_cctf_decoding=False)
        return colour.RGB_to_ICtCp(there)

    first, far = generator.random((2, 10_000, 3))
    for second in (far, np.clip(first + generator.normal(0, 0.01, first.shape), 0, 1), np.zeros_like(first)):
        expected = colour.delta_E(theirs(peak * linear(first)), theirs(peak * linear(second)), method="ITP")
        np.testing.assert_allclose(apart(DeltaEITP(peak), first, second), expected, atol=1e-8)
        one, other = 10 ** (6 * first - 4), 10 ** (6 * second - 4)  # up to ten times PQ's end
        expected = colour.delta_E(theirs(peak * one), theirs(peak * other), method="ITP")
        np.testing.assert_allclose(apart(DeltaEITPHDR(peak), one, other), expected, atol=1e-8)
