"""Formats of lighting and rendering tools: what all of their tables have in common, and real files."""

import pickle

import pytest
import torch
from helpers.table_files import (
    expected,
    fourier,
    klems,
    lighttools,
    mbsdf,
    opened,
    speos,
    speos_binary,
    tensor_tree,
    written,
)

from torchbrdf.errors import DataError
from torchbrdf.measured import describe, load

ISOTROPIC = {
    "mbsdf": mbsdf,
    "tensor_tree": tensor_tree,
    "lighttools": lighttools,
}
ALL = {
    **ISOTROPIC,
    "klems": klems,
    "fourier": fourier,
    "speos": speos,
}


@pytest.mark.parametrize("name", ISOTROPIC)
def test_values_are_where_they_were_measured(name, tmp_path):
    """The mirror direction, and so the lobe, is where the format has it."""
    measured = opened(tmp_path, ISOTROPIC[name]())
    assert measured.source.format == name and not measured.is_anisotropic
    good = measured.weight[0, :, 0] > 0
    assert good.sum() > 60
    torch.testing.assert_close(measured.values[0, good, 1], expected(measured.pairs)[good], rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("name", ["mbsdf", "tensor_tree", "klems"])
@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
def test_tables_give_their_samples_back(name, interpolation, tmp_path):
    measured = opened(tmp_path, ALL[name]())
    good = measured.weight[0, :, 0] > 0
    found = measured.at(measured.pairs, interpolation)[0, good]
    torch.testing.assert_close(found, measured.values[0, good])
    assert not measured.is_scattered


@pytest.mark.parametrize("name", ALL)
def test_files_are_materials(name, tmp_path):
    measured = opened(tmp_path, ALL[name]())
    assert measured.source.format == name
    again = pickle.loads(pickle.dumps(measured))
    assert torch.equal(again.values, measured.values) and len(pickle.dumps(measured)) < 20_000
    assert measured.has_45_0.all() and 0 < measured.diffuse_45_0().min() <= 1
    facts = describe(tmp_path / "made-up.dat")
    assert facts["format"] == name and "angles" in facts and "colours" in facts and "quantity" in facts
    assert facts.get("white furnace: albedo at 0 degrees", 1) > 0
    two = load([tmp_path / "made-up.dat", written(tmp_path, ALL[name](), "again")], dtype=torch.float32)
    pairs = measured.pairs.to(dtype=torch.float32).select(samples=torch.arange(40))
    found = two.at(pairs)
    assert found.dtype == torch.float32 and torch.equal(found[0], found[1])
    torch.testing.assert_close(found[0].double(), measured.at(pairs.to(dtype=torch.float64))[0], rtol=2e-3, atol=1e-3)


@pytest.mark.parametrize("name", ["klems", "tensor_tree", "speos", "lighttools"])
@pytest.mark.parametrize("change", ["crlf", "bom"])
def test_text_of_other_systems(name, change, tmp_path):
    text = ALL[name]()
    changed = {"crlf": text.replace("\n", "\r\n"), "bom": "\ufeff" + text}[change]
    assert torch.equal(opened(tmp_path, changed, "changed").values, opened(tmp_path, text).values)


@pytest.mark.parametrize(
    ("data", "format_name"),
    [
        (mbsdf(), "mbsdf"),
        (fourier(), "fourier"),
        (speos_binary(), "speos"),
        (klems(), "klems"),
        (lighttools(), "lighttools"),
    ],
)
def test_the_suffix_does_not_matter(data, format_name, tmp_path):
    for name in ("x.bsdf", "x.binary", "x.json", "x"):
        assert opened(tmp_path, data, name).source.format == format_name


@pytest.mark.parametrize(
    "data", [mbsdf(), klems("LBNL/Klems Full"), tensor_tree(4), fourier(cosines=60), speos_binary(), lighttools()]
)
def test_what_would_be_too_large_in_memory(data, tmp_path, monkeypatch):
    path = written(tmp_path, data)
    monkeypatch.setenv("TORCHBRDF_MAX_BYTES", str(max(2000, path.stat().st_size // (8 if len(data) > 60_000 else 1))))
    with pytest.raises(DataError, match="TORCHBRDF_MAX_BYTES raises the limit"):
        load(path)


REAL = {
    "mbsdf/test_rgb_theta_2_phi_3.mbsdf": (12, 35),
    "klems/ec60.xml": (21025, 39.1),
    "tensor_tree/sawtooth.xml": (21025, 29.3),
    "fourier/paint.bsdf.gz": (65025, 315),
    "speos/R_test.anisotropicbsdf": (15960, 2.63),
}


@pytest.mark.parametrize("name", REAL)
def test_real_files(name, data):
    path = data / "formats" / name
    if not path.exists():
        pytest.skip(f"needs measured data: no {name}")
    samples, highest = REAL[name]
    measured = load(path, dtype=torch.float64)
    assert measured.values.shape[1] == samples and measured.values.max().item() == pytest.approx(highest, rel=0.01)


def test_real_files_that_only_transmit(data):
    path = data / "formats" / "klems" / "2011-SA1-Small-CommaSeparated.XML"
    if not path.exists():
        pytest.skip("needs measured data: no file that only transmits")
    with pytest.raises(DataError, match="expected a reflection, found only 'transmission front, transmission back'"):
        load(path)


def test_the_frame_of_a_real_file_makes_it_reciprocal(data):
    """Traced rays through a saw-toothed sheet: with another frame exchanged directions would differ by 13 %."""
    path = data / "formats" / "tensor_tree" / "sawtooth.xml"
    if not path.exists():
        pytest.skip("needs measured data: no sawtooth.xml")
    assert float(describe(path)["reciprocity error"].split()[0]) < 2
