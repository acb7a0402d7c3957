"""Values in any number of bands: of tensors, and of files whose bands are kept."""

import pickle

import pytest
import torch
from helpers.directions import hemisphere
from helpers.listed_files import astm, bird, columns, cornell

from torchbrdf import fit
from torchbrdf.color import luminance
from torchbrdf.errors import DataError, ShapeError, UsageError
from torchbrdf.export import export
from torchbrdf.export.api import material_of
from torchbrdf.lobes import make_model
from torchbrdf.measured import Measured, describe, load, load_all
from torchbrdf.measured.bands import luminance_shares
from torchbrdf.measured.tables import values_at
from torchbrdf.pairs import Pairs
from torchbrdf.render import RenderedLoss, Scene, render, sphere


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
        ([0.4, 0.5, 0.6], "expected numbers that grow, in nm"),
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


TEXTS = {
    "astm": (astm, (465.0, 525.0, 630.0)),
    "bird": (bird, (500.0, 600.0)),
    "columns": (lambda: columns().replace("phi,r,g,b", "phi,630nm,525nm,465"), (465.0, 525.0, 630.0)),
    "cornell": (cornell, (400, 500, 600, 700)),
}


@pytest.mark.parametrize("name", TEXTS)
def test_bands_of_files_are_kept(name, tmp_path):
    text, lengths = TEXTS[name]
    path = tmp_path / "made-up.dat"
    path.write_text(text())
    kept, rgb = load(path, dtype=torch.float64, bands="keep"), load(path, dtype=torch.float64)
    assert kept.wavelengths == lengths and kept.channels == len(lengths) and not kept.is_rgb
    assert rgb.is_rgb and rgb.wavelengths is None
    torch.testing.assert_close(kept.to_rgb().values, rgb.values, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(kept.to_rgb("E").values, load(path, torch.float64, settings={"illuminant": "E"}).values)
    assert kept.to_rgb().is_scattered and kept.to_rgb().source.format == name
    assert describe(path, {"bands": "keep"})["colours"].startswith(f"none: {len(lengths)} bands")
    again = pickle.loads(pickle.dumps(kept))
    assert torch.equal(again.values, kept.values) and again.wavelengths == kept.wavelengths


def test_files_of_other_bands_are_groups_of_their_own(tmp_path):
    for name, text in (("a", astm()), ("b", cornell()), ("c", cornell().replace("600 700", "600 710"))):
        (tmp_path / name).write_text(text)
    assert [group.names for group in load_all(tmp_path)] == [["a"], ["b", "c"]]
    assert [group.names for group in load_all(tmp_path, bands="keep")] == [["a"], ["b"], ["c"]]
    with pytest.raises(DataError, match=r"c: expected 4 bands of 400, 500, 600, 700 nm, as .*b has, found 4 bands"):
        load([tmp_path / "b", tmp_path / "c"], bands="keep")
    with pytest.raises(UsageError, match="unknown bands 'all'; expected one of keep, rgb"):
        load(tmp_path / "a", bands="all")


def test_pictures_and_tables_want_rgb(tmp_path):
    bands = Measured.from_samples(pairs_of(40), torch.ones(1, 40, 5), wavelengths=range(400, 900, 100))
    scene = Scene(sphere(2), size=8, nodes=8, light_samples=4)
    lobe = make_model("ward", 1, channels=5)
    for refused in (
        lambda: render(bands, scene),
        lambda: render(lobe, scene),
        lambda: RenderedLoss(scene).problem(bands),
        lambda: fit(make_model("ward", 1), bands, RenderedLoss(scene)),
        lambda: values_at(bands, pairs_of(3)),
        lambda: export(bands, "mitsuba", tmp_path),
        lambda: material_of(lobe),
    ):
        with pytest.raises(DataError, match=r"expected linear RGB, found .*5 (bands from 400 to 800 nm|channels)"):
            refused()
    assert render(bands.to_rgb(), scene).isfinite().all()
    with pytest.raises(ShapeError, match=r"luminance: expected linear RGB \(..., 3\), found \(2, 31\)"):
        luminance(torch.ones(2, 31))
    unknown = Measured.from_samples(pairs_of(40), torch.ones(1, 40, 5))
    with pytest.raises(DataError, match="expected wavelengths, to make colours of, found 5 bands whose wavelengths"):
        unknown.to_rgb()
    assert unknown.luminance_shares == (0.2,) * 5


def test_luminance_follows_from_wavelengths():
    shares = luminance_shares(range(400, 710, 10))
    assert sum(shares) == pytest.approx(1) and 400 + 10 * shares.index(max(shares)) in (550, 560)
    assert min(shares) >= 0
    grey = Measured.from_samples(pairs_of(40), torch.ones(1, 40, 31), wavelengths=range(400, 710, 10))
    assert sum(grey.luminance_shares) == pytest.approx(1)
