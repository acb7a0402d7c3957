"""UTIA's tables: where values are, what lies between and beyond, what is said and refused."""

import math
import pickle

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import brushed, utia, utia_directions

from torchbrdf.errors import DataError
from torchbrdf.measured import describe, load
from torchbrdf.pairs import Pairs

COLOR = torch.tensor([1.0, 0.5, 0.25], dtype=torch.float64)


def written(folder, table, name="m001_made-up.bin"):
    path = folder / name
    path.write_bytes(np.ascontiguousarray(table, "<f8").tobytes())
    return path


def tilted(degrees, azimuth):
    theta, phi = math.radians(degrees), math.radians(azimuth)
    return torch.tensor([[math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]]).double()


def test_a_file_has_its_published_size(tmp_path):
    """6 x 48 x 6 x 48 pairs of directions, three channels of doubles."""
    assert written(tmp_path, utia()).stat().st_size == 1_990_656 == 8 * 3 * 6 * 48 * 6 * 48


def test_values_are_where_they_were_measured(tmp_path):
    measured = load(written(tmp_path, utia()), dtype=torch.float64)
    assert measured.source.format == "utia" and measured.is_anisotropic and not measured.source.is_reciprocal
    assert measured.names == ["m001_made-up"] and measured.values.shape == (1, 82_944, 3)
    wi, wo = (torch.from_numpy(one.reshape(1, -1, 3)) for one in utia_directions())
    wanted = torch.from_numpy(brushed(wi.numpy(), wo.numpy()))[..., None] * COLOR
    torch.testing.assert_close(measured.values, wanted)
    torch.testing.assert_close(measured.at(Pairs.from_directions(wi, wo)), wanted)
    nearest = measured.at(Pairs.from_directions(wi, wo), "nearest")
    torch.testing.assert_close(nearest, wanted)
    assert (measured.weight == 1).all()


def test_between_and_beyond(tmp_path):
    """Linear in each angle, all around, and as at 75 degrees beyond."""
    measured = load(written(tmp_path, utia()), dtype=torch.float64)

    def at(one, other):
        return measured.at(Pairs.from_directions(tilted(*one), tilted(*other)))[0, 0]

    light = (30, 45)
    for low, high, half in (((45, 7.5), (60, 7.5), (52.5, 7.5)), ((45, 352.5), (45, 0), (45, 356.25))):
        torch.testing.assert_close(at(light, half), (at(light, low) + at(light, high)) / 2)
        torch.testing.assert_close(at(half, light), (at(low, light) + at(high, light)) / 2)
    torch.testing.assert_close(at((85, 20), light), at((75, 20), light))
    torch.testing.assert_close(at(light, (89, -100)), at(light, (75, 260)))
    assert (at(light, (95, 0)) == 0).all()
    # Turned by 90 degrees it is another material, by 180 the same.
    there, turned, back = (at((15, a), (60, a + 10)) for a in (0, 90, 180))
    assert (there / turned).max() > 1.3 or (turned / there).max() > 1.3
    torch.testing.assert_close(there, back)


def test_holes_take_the_nearest_valid_value(tmp_path):
    table = utia()
    table[1, 2, 47, 3, 5] = np.nan
    table[:, 4:, :, 4:, :] = 1e30
    table[0, 0, 0, 0, 0] = -0.01
    measured = load(written(tmp_path, table), dtype=torch.float64)
    assert (measured.weight == 0).sum() == 1 + 4 * 48 * 48
    asked = Pairs.from_directions(hemisphere(1, 500).double(), hemisphere(1, 500, seed=1).double())
    found = measured.lookup(asked)
    assert found.values.isfinite().all() and 0 < found.filled[0] < 200 and found.values.max() < 2
    facts = describe(written(tmp_path, table))
    assert facts["invalid share"] > 0.02 and 0 < facts["negative share"] < 0.01


def test_what_files_do_not_say(tmp_path):
    path = written(tmp_path, utia())
    plain = load(path, dtype=torch.float64).values
    factor = load(path, settings={"quantity": "reflectance_factor"}, dtype=torch.float64)
    torch.testing.assert_close(factor.values * math.pi, plain)
    cosine = load(path, settings={"quantity": "brdf_cosine"}, dtype=torch.float64)
    torch.testing.assert_close(cosine.values * cosine.pairs.cos_o[..., None], plain)
    srgb = load(path, settings={"encoding": "srgb"}, dtype=torch.float64)
    encoded = torch.where(srgb.values <= 0.0031308, 12.92 * srgb.values, 1.055 * srgb.values ** (1 / 2.4) - 0.055)
    torch.testing.assert_close(encoded, plain, rtol=1e-4, atol=1e-6)
    third = load(path, settings={"encoding": "srgb_140"}, dtype=torch.float64)
    torch.testing.assert_close(third.values, plain / 140 / 12.92 * 100)
    facts = describe(path, {"encoding": "srgb"})
    assert facts["encoding"] == "srgb (the file does not say)" and facts["quantity"] == "brdf (the file does not say)"
    assert facts["anisotropic"] == "48 azimuths of the light" and facts["reciprocity error"].startswith("0")
    assert 0.1 * math.pi < facts["white furnace: albedo at 0 degrees"] < 1
    again = pickle.loads(pickle.dumps(srgb))
    assert torch.equal(again.values, srgb.values) and len(pickle.dumps(srgb)) < 20_000


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda data: data[:-8], "expected a measured BRDF"),
        (lambda data: data.byteswap(), "expected a measured BRDF"),
        (lambda data: data * np.nan, "expected values up to 1e+08 / sr, found none"),
        (lambda data: np.frombuffer(b"1.5 " * (len(data) * 2)), "expected a measured BRDF"),
    ],
)
def test_bad_files_are_refused(change, says, tmp_path):
    path = written(tmp_path, change(utia().reshape(-1)))
    with pytest.raises(DataError) as caught:
        load(path)
    assert says in str(caught.value) and path.name in str(caught.value)
