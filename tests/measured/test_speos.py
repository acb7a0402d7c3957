"""Measured BSDFs of Speos: scale, spectra, frames, text and binary."""

import math

import numpy as np
import pytest
import torch
from helpers.table_files import (
    expected,
    isotropic,
    opened,
    speos,
    speos_binary,
    speos_spectral,
    speos_table,
)

from torchbrdf.errors import DataError
from torchbrdf.measured import describe


@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize("make", [speos, speos_binary])
def test_speos_gives_shapes_and_how_much_is_reflected(kind, make, tmp_path):
    measured = opened(tmp_path, make(kind=kind))
    good = measured.weight[0, :, 0] > 0
    ratio = measured.values[0, good, 0] / expected(measured.pairs)[good]
    torch.testing.assert_close(ratio, ratio[:1].expand_as(ratio), rtol=1e-6, atol=0)
    facts = describe(tmp_path / "made-up.dat")
    assert facts["scale"].endswith("so that light at 5 degrees has the reflectance of the file: 50 %")
    table, theta, phi = (speos_table(5, kind=0), *map(np.radians, (np.arange(0, 91, 10), np.arange(0, 361, 20))))
    whole = np.trapezoid(np.trapezoid(table * np.sin(theta)[:, None], theta, axis=0), phi)
    assert float(ratio[0]) == pytest.approx(0.5 / whole, rel=1e-5)


def test_text_and_binary_are_alike(tmp_path):
    text, binary = opened(tmp_path, speos()), opened(tmp_path, speos_binary(), "binary")
    torch.testing.assert_close(text.values, binary.values, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(text.pairs.wo, binary.pairs.wo)


def test_the_mirror_direction_may_be_on_the_other_side(tmp_path):
    def other(wi, wo):
        return isotropic(wi * [-1, -1, 1], wo)

    for make in (speos, speos_binary, speos_spectral):
        here, there = (opened(tmp_path, make(f=f), f"{f.__name__}.dat") for f in (isotropic, other))
        said = describe(tmp_path / "other.dat")["angles"]
        assert "is at phi = 180, where values are" in said and said.endswith("--read mirror=0 says otherwise")
        good = there.weight[0, :, 0] > 0
        ratio = there.values[0, good, 1] / expected(there.pairs)[good]
        if make is not speos_spectral:  # of which each table has a scale of its own
            torch.testing.assert_close(ratio, ratio[:1].expand_as(ratio), rtol=1e-5, atol=0)
        assert ratio.max() < 3 * ratio.min()
        told = opened(tmp_path, make(f=isotropic), "told", mirror="180")
        torch.testing.assert_close(told.pairs.wi, here.pairs.wi * torch.tensor([-1, -1, 1]))
        assert describe(tmp_path / "isotropic.dat")["angles"].startswith(
            "degrees; the mirror direction is at phi = 0, as"
        )


def lambertian(wi, wo):
    return 0 * wo[..., 2] + 7


def test_a_lambertian_reflects_what_the_file_says(tmp_path):
    """Whatever its values are, and within what ten degrees let a sum say."""
    for text in (speos(f=lambertian), speos_spectral(shares=(50, 50, 50), f=lambertian)):
        values = opened(tmp_path, text).values
        assert values[values > 0].mean().item() == pytest.approx(0.5 / math.pi, rel=0.03)


def test_spectra_are_colours(tmp_path):
    red = opened(tmp_path, speos(f=lambertian, spectrum=((350, 10), (850, 60)))).values.amax((0, 1))
    assert red[0] > red[1] > red[2] > 0
    same = opened(tmp_path, speos_spectral(f=lambertian))
    assert (same.values[..., 0] > same.values[..., 2]).any() and "CIE 1931" in describe(tmp_path / "made-up.dat")[
        "colours"
    ]


def test_angles_of_the_grain(tmp_path):
    """A whole turn is none; others turn light and viewer."""
    once, twice = opened(tmp_path, speos()), opened(tmp_path, speos(turns=(0, 360)), "twice")
    assert torch.equal(once.values, twice.values)
    turned = opened(tmp_path, speos(turns=(0, 90)), "turned")
    half = len(once.pairs)
    assert len(turned.pairs) == 2 * half
    wi = turned.pairs.wi[0, half:]
    torch.testing.assert_close(wi[:, 1], once.pairs.wi[0, :, 0].abs())
    torch.testing.assert_close(
        (wi * turned.pairs.wo[0, half:]).sum(-1), (once.pairs.wi * once.pairs.wo)[0].sum(-1), rtol=0, atol=1e-9
    )


def test_comments_and_descriptions_may_be_empty_or_long(tmp_path):
    text = speos()
    wanted = opened(tmp_path, text).values
    for other in ("\n0\n\n", "comment\n11\na\nbc\nd 1 2 3\n"):
        assert torch.equal(opened(tmp_path, text.replace("comment\n7\nmade up\n", other)).values, wanted)


def test_only_the_reflection_is_read(tmp_path):
    both = opened(tmp_path, speos(parts=(1, 1)))
    torch.testing.assert_close(both.values, opened(tmp_path, speos(), "one").values)
    assert describe(tmp_path / "made-up.dat")["parts"] == "reflection and transmission; the reflection is read"


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (speos(parts=(0, 1)), "expected a reflection, found only a transmission"),
        (speos(parts=(0, 0)), "expected a reflection, found none"),
        (speos_spectral(parts=(0, 1)), "expected a reflection, found only a transmission"),
        ("OPTIS - Scattering surface file v1.0\n", "expected a measured BSDF of Speos"),
        (speos_spectral().replace("\n0\n", "\n1\n", 1), "expected a .brdf in text"),
        (speos().replace("\n0\n", "\n2\n", 1), "line 2: expected the mode 0 of text or 1, found"),
        (speos()[:-300], "numbers, theta and values, found the end"),
        (speos().replace("10 19", "11 19", 1), "expected 20 numbers, theta and values, found 2"),
        (speos().replace("10 19", "-1 19", 1), "expected counts of theta and phi"),
        (speos().replace("10 19", "10 99999", 1), "expected counts of theta and phi"),
        (speos().replace("5\t30\t60", "5\t30\t30", 1), "expected growing angles of the light"),
        (speos().replace("5\t30\t60", "5\t30\t99", 1), "expected growing angles of the light"),
        (speos().replace("\n20\t", "\nx\t", 1), "expected 20 numbers, theta and values, found 'x"),
        (speos(spectrum=((550, -5), (600, 5))), "expected reflectances from 0 % on"),
        (speos(spectrum=((650, 5), (600, 5))), "expected growing wavelengths"),
        (speos(f=lambda wi, wo: 0 * wo[..., 2]), "expected tables that reflect something, found 0"),
        (speos_spectral(f=lambda wi, wo: 0 * wo[..., 2]), "expected a table that reflects something"),
        (speos_binary()[:-800], "expected"),
        (speos_binary()[:200] + b"\xff" * 8 + speos_binary()[208:], "expected"),
    ],
)
def test_bad_files_of_speos_are_refused(data, says, tmp_path):
    with pytest.raises(DataError) as caught:
        opened(tmp_path, data)
    assert says in str(caught.value) and "made-up.dat" in str(caught.value)
