"""Measured BSDFs of MDL: cells, parts, and what is refused."""

import math
import struct

import numpy as np
import pytest
import torch
from helpers.table_files import (
    at,
    expected,
    mbsdf,
    opened,
)

from torchbrdf.errors import DataError
from torchbrdf.measured import describe
from torchbrdf.pairs import Pairs


def test_values_between_cells(tmp_path):
    measured = opened(tmp_path, mbsdf(45, 90))
    pairs, found = at(measured, step=0.02)
    error = (found[:, 0] - expected(pairs)).abs()
    assert error.mean() < 0.001 and error.max() < 0.2


def test_parts_colours_and_the_mirror_direction(tmp_path):
    rgb = opened(tmp_path, mbsdf(rgb=True, more=mbsdf(name=b"MBSDF_DATA_TRANSMISSION=")[42:]))
    torch.testing.assert_close(rgb.values[..., 2], 3 * rgb.values[..., 0])
    assert describe(tmp_path / "made-up.dat")["parts"] == "reflection and transmission; the reflection is read"
    with pytest.raises(DataError, match="expected one reflection, found transmission"):
        opened(tmp_path, mbsdf(name=b"MBSDF_DATA_TRANSMISSION="))
    other = opened(tmp_path, mbsdf(mirror=0), mirror="0")
    torch.testing.assert_close(other.values[0, :, 0], expected(other.pairs), rtol=1e-5, atol=1e-8)


def test_cells_without_a_value_are_passed_over(tmp_path):
    """Their neighbours count, and where there are none, the nearest cell with a value."""
    whole = mbsdf(6, 6)
    size = 6**3 * 4
    values = np.frombuffer(whole[-size:], "<f4").reshape(6, 6, 6).copy()
    values[:4] = np.nan
    measured = opened(tmp_path, whole[:-size] + values.tobytes())
    assert (measured.weight == 0).sum() == 4 * 36 and describe(tmp_path / "made-up.dat")["invalid share"] > 0.6
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    found = measured.lookup(Pairs.from_directions(up[None], up[None]))
    assert found.filled.tolist() == [1] and found.values.min() > 0
    low = torch.tensor([[math.sin(1.1), 0.0, math.cos(1.1)]], dtype=torch.float64)  # between a missing cell and one
    found = measured.lookup(Pairs.from_directions(low[None], up[None]))
    assert found.filled.tolist() == [0] and found.values.min() > 0


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (mbsdf()[:-1], "bytes of 12 x 18 angles, found"),
        (mbsdf(more=b"x"), "expected one of MBSDF_DATA="),
        (mbsdf(more=mbsdf()[42:]), "expected one reflection, found reflection and reflection"),
        (mbsdf()[:30], "expected one of MBSDF_DATA="),
        (mbsdf(name=b"MBSDF_DATA_EMISSION="), "expected one of MBSDF_DATA="),
        (mbsdf().replace(b"V1", b"V2"), "expected 'NVIDIA ARC MBSDF V1', found"),
        (mbsdf(0), "expected kind 0 or 1 and a resolution"),
        (mbsdf()[:54] + struct.pack("<3I", 0, 2**31, 2**31) + mbsdf()[66:], "expected"),
    ],
)
def test_bad_measured_bsdfs_are_refused(data, says, tmp_path):
    with pytest.raises(DataError) as caught:
        opened(tmp_path, data)
    assert says in str(caught.value) and "made-up.dat" in str(caught.value)
