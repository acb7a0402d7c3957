"""Spectral files of RGL's database: their bands, and their colours beside an RGB file of the same material."""

import pickle

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere
from helpers.measured_files import synthetic_bsdf, tensor_file

from torchbrdf.color import luminance
from torchbrdf.errors import DataError
from torchbrdf.export import export
from torchbrdf.lobes import GGX, Lambert, Sum
from torchbrdf.measured import describe, load, load_all
from torchbrdf.pairs import Pairs

with np.printoptions():  # which it changes for the whole process
    colour = pytest.importorskip("colour")

WAVELENGTHS = np.arange(360.0, 1001.0, 10)


def spectral(seed=0):
    """Fields of a spectral file: each node has a smooth spectrum of its own; and the same in bands, `(T, W, R, R)`."""
    fields = synthetic_bsdf(seed)
    del fields["rgb"]
    rng = np.random.default_rng(seed)
    middle, width, level = (rng.uniform(*ends, (5, 1, 8, 8)) for ends in ((420, 680), (40, 120), (0.1, 1)))
    place = (WAVELENGTHS[:, None, None] - middle) / width
    spectra = 0.05 + level * np.exp(-(place**2))
    return fields | {"wavelengths": WAVELENGTHS.astype("f4"), "spectra": spectra[None].astype("f4")}


def by_tables(spectra):
    """Linear RGB under D65 by the tables of CIE 1931, `(1, T, 3, R, R)`."""
    grid = np.arange(380.0, 781.0, 5)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"][grid]
    light = colour.SDS_ILLUMINANTS["D65"][grid]
    seen = observer * light[:, None]
    xyz = seen / seen[:, 1].sum()
    fine = np.stack([np.interp(grid, WAVELENGTHS, unit) for unit in np.eye(len(WAVELENGTHS))])
    matrix = colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB
    return np.einsum("ptcuv,cg,gk,jk->ptjuv", spectra, fine, xyz, matrix)


@pytest.fixture
def files(tmp_path):
    fields = spectral()
    rgb = {name: value for name, value in fields.items() if name not in ("spectra", "wavelengths")}
    rgb["rgb"] = by_tables(fields["spectra"]).astype("f4")
    (tmp_path / "paint_spec.bsdf").write_bytes(tensor_file(fields))
    (tmp_path / "paint_rgb.bsdf").write_bytes(tensor_file(rgb))
    return tmp_path / "paint_spec.bsdf", tmp_path / "paint_rgb.bsdf"


def test_spectra_have_the_luminance_of_their_rgb_sibling(files):
    """Within 2 %, at what was measured and between."""
    spectrum, rgb = (load(path, dtype=torch.float64) for path in files)
    assert spectrum.names == ["paint"] == rgb.names and spectrum.is_rgb
    pairs = Pairs.from_directions(hemisphere(1, 500), hemisphere(1, 500, seed=1))
    for one, other in ((spectrum.values, rgb.values), (spectrum.at(pairs), rgb.at(pairs))):
        light, wanted = luminance(one), luminance(other)
        assert (light - wanted).abs().max() < 0.02 * wanted.abs().max()
        good = wanted > 1e-3 * wanted.max()
        assert ((light - wanted).abs() / wanted)[good].max() < 0.02


def test_bands_can_be_kept(files):
    kept, plain = load(files[0], dtype=torch.float64, bands="keep"), load(files[0], dtype=torch.float64)
    assert kept.wavelengths == tuple(WAVELENGTHS.tolist()) and kept.channels == len(WAVELENGTHS)
    torch.testing.assert_close(kept.to_rgb().values, plain.values, rtol=1e-6, atol=1e-9)
    pairs = Pairs.from_directions(hemisphere(1, 50), hemisphere(1, 50, seed=1))
    torch.testing.assert_close(kept.to_rgb().at(pairs), plain.at(pairs), rtol=1e-6, atol=1e-9)
    again = pickle.loads(pickle.dumps(kept))
    assert again.wavelengths == kept.wavelengths and torch.equal(again.values, kept.values)
    assert load(files[1], bands="keep").is_rgb


def test_what_info_says(files):
    assert describe(files[0])["colours"] == "linear RGB (BT.709) by the CIE 1931 observer under illuminant D65"
    assert describe(files[0], {"bands": "keep"})["colours"] == "none: 65 bands from 360 to 1000 nm, as they are"
    assert describe(files[1])["colours"] == "RGB as the file has it"


def test_both_files_of_a_material(files):
    folder = files[0].parent
    assert [group.channels for group in load_all(folder, bands="keep")] == [3, 65]
    assert len(load(folder)) == 2
    with pytest.raises(DataError, match=r"expected linear RGB, as .* found 65 bands from 360 to 1000 nm; read it"):
        load(folder, bands="keep")


def test_the_spectra_that_are_exported_are_read(tmp_path):
    """Those of pbrt's material, whose luminance is that of the model."""
    model = Sum(Lambert(albedo=[0.5, 0.2, 0.1]), GGX(specular=[0.1, 0.2, 0.3], roughness=0.3, f0=0.5))
    export(model, "pbrt", tmp_path, name="paint")
    (path,) = tmp_path.glob("*.bsdf")
    pairs = Pairs.from_directions(hemisphere(1, 300), hemisphere(1, 300, seed=1))
    pairs = pairs.select(samples=(torch.minimum(pairs.cos_i, pairs.cos_o)[0] > 0.2).nonzero()[:, 0])
    wanted = luminance(model(pairs.to(dtype=torch.float32)).detach()).double()
    found = luminance(load(path, dtype=torch.float64).at(pairs))
    assert ((found - wanted).abs() / wanted).median() < 0.02
