"""Fourier BSDFs of pbrt: sums of series, between cosines and at any azimuth."""

import gzip
import math
import struct

import pytest
import torch
from helpers.table_files import (
    at,
    fourier,
    opened,
    written,
)

from torchbrdf.errors import DataError
from torchbrdf.measured import describe, load


def test_a_lambertian_is_exact_everywhere(tmp_path):
    """f |cos_i| is linear in cos_i, which splines repeat."""
    for packed in (False, True):
        measured = opened(tmp_path, fourier(packed=packed))
        for step in (0, 0.1):
            _, found = at(measured, step=step)
            torch.testing.assert_close(found, torch.full_like(found, 0.6 / math.pi), rtol=1e-5, atol=1e-6)
    assert load(written(tmp_path, fourier(packed=True), "steel.bsdf.gz")).names == ["steel"]


def test_what_a_file_says_of_itself(tmp_path):
    measured = opened(tmp_path, fourier(says=b"made by hand\n"))
    assert describe(tmp_path / "made-up.dat")["says"] == "'made by hand\\n'"
    assert torch.equal(measured.values, opened(tmp_path, fourier(), "plain").values)


def test_series_have_a_closed_form(tmp_path):
    """Terms r^k make (1 - r cos) / (1 - 2 r cos + r^2), highest at the mirror direction."""
    r = 0.5

    def terms(cos_i, cos_o):
        return [cos_i * cos_i * cos_o * r**k for k in range(40)]

    measured = opened(tmp_path, fourier(terms, 60))
    pairs, found = at(measured, step=0.1)
    wi, wo = pairs.wi[0], pairs.wo[0]
    flat = [torch.nn.functional.normalize(one[:, :2], dim=-1) for one in (-wi, wo)]
    cosine = (flat[0] * flat[1]).sum(-1)
    wanted = wi[:, 2] * wo[:, 2] * (1 - r * cosine) / (1 - 2 * r * cosine + r * r)
    torch.testing.assert_close(found[:, 0], wanted, rtol=2e-3, atol=2e-4)


def test_sums_below_zero_are_none_and_three_channels_are_colours(tmp_path):
    dark = opened(tmp_path, fourier(lambda cos_i, cos_o: [-cos_i]))
    assert dark.values.max() == 0
    # Luminance 1, red 0.5, blue 0.25: green by pbrt's weights.
    colored = opened(tmp_path, fourier(lambda cos_i, cos_o: [[cos_i], [cos_i / 2], [cos_i / 4]], channels=3))
    _, found = at(colored)
    wanted = torch.tensor([0.5, 1.39829 - 0.297375 / 2 - 0.100913 / 4, 0.25], dtype=torch.float64)
    torch.testing.assert_close(found, wanted.expand_as(found), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (fourier(flags=2), "expected flags 1, 1 or 3 channels, 1 basis and no parameters, found 2, 1, 1 and 0"),
        (fourier(bases=3), "found 1, 1, 3 and 0"),
        (fourier(reflects=False), "above 0"),
        (fourier()[:-1], "bytes for 24 cosines, found"),
        (fourier() * 2, "bytes for 24 cosines, found"),
        (b"SCATFUN\x02" + fourier()[8:], "version 1"),
        (fourier()[:40], "version 1"),
        (fourier()[:12] + struct.pack("<i", 2**31 - 1) + fourier()[16:], "found 2147483647"),
        (fourier(lambda cos_i, cos_o: [math.nan]), "expected finite coefficients, found nan"),
        (fourier(packed=True)[:-9], "packed by gzip, found one that is cut"),
        (fourier(packed=True) * 2, "packed by gzip, found bytes behind it"),
        (fourier(packed=True)[:-40] + bytes(20) + fourier(packed=True)[-20:], "packed by gzip, found"),
    ],
)
def test_bad_series_are_refused(data, says, tmp_path):
    with pytest.raises(DataError) as caught:
        opened(tmp_path, data)
    assert says in str(caught.value) and "made-up.dat" in str(caught.value)


def test_a_packed_file_that_blows_up(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHBRDF_MAX_BYTES", "100000")
    with pytest.raises(DataError, match="expected at most 100000 bytes unpacked"):
        opened(tmp_path, gzip.compress(fourier()[:1000] + bytes(10_000_000)))
