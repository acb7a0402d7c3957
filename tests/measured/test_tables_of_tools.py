"""Formats of lighting and rendering tools: what their tables hold, how values lie between, and what is refused."""

import gzip
import math
import pickle
import struct

import numpy as np
import pytest
import torch
from helpers.table_files import (
    fourier,
    grained,
    isotropic,
    klems,
    klems_block,
    lighttools,
    mbsdf,
    speos,
    speos_binary,
    speos_spectral,
    speos_table,
    tensor_tree,
    tree,
    window_xml,
)

from torchbrdf.cli import main
from torchbrdf.errors import DataError, UsageError
from torchbrdf.measured import describe, load
from torchbrdf.pairs import Pairs

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


def written(folder, data, name="made-up.dat"):
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def opened(folder, data, name="made-up.dat", **settings):
    return load(written(folder, data, name), dtype=torch.float64, settings=settings or None)


def at(measured, interpolation="linear", step=0):
    """Pairs above the horizon, and values at them: the samples, or others nearby, `(N, 3)`."""
    pairs = measured.pairs
    if step:
        source = torch.Generator().manual_seed(0)
        moved = [one + step * torch.randn(one.shape, generator=source, dtype=one.dtype) for one in (pairs.wi, pairs.wo)]
        pairs = Pairs.from_directions(*(torch.nn.functional.normalize(one, dim=-1) for one in moved))
    high = (torch.minimum(pairs.cos_i, pairs.cos_o)[0] > 0.1).nonzero()[:, 0]
    pairs = pairs.select(samples=high)
    return pairs, measured.at(pairs, interpolation)[0]


def expected(pairs, f=isotropic):
    return torch.from_numpy(f(pairs.wi[0].numpy(), pairs.wo[0].numpy()))


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


# NVIDIA's measured BSDFs


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


# WINDOW's matrices


@pytest.mark.parametrize("basis", ["LBNL/Klems Full", "LBNL/Klems Half", "LBNL/Klems Quarter", "two rings"])
def test_patches_of_all_bases(basis, tmp_path):
    measured = opened(tmp_path, klems(basis))
    assert measured.is_anisotropic
    torch.testing.assert_close(measured.values[0, :, 0], expected(measured.pairs, grained), rtol=1e-7, atol=1e-9)


def test_values_between_patches(tmp_path):
    measured = opened(tmp_path, klems("LBNL/Klems Full"))
    pairs, found = at(measured, step=0.02)
    error = (found[:, 0] - expected(pairs, grained)).abs()
    assert error.mean() < 0.02
    _, patch = at(measured, "nearest", step=0.02)
    assert (patch[:, 0] - expected(pairs, grained)).abs().mean() > error.mean()
    flat = opened(tmp_path, klems(scale=0.0).replace(" 0,", " 0.25,").replace("\n0,", "\n0.25,"))
    torch.testing.assert_close(flat.at(pairs), torch.full_like(found, 0.25)[None])


def test_the_front_is_seen_from_there(tmp_path):
    """What is the file's +y is -y for who looks at the front: so that the frame is right-handed."""
    turned = opened(tmp_path, klems(direction="Reflection Front"))
    mirrored = turned.pairs.wi * torch.tensor([1, -1, 1]), turned.pairs.wo * torch.tensor([1, -1, 1])
    wanted = expected(Pairs.from_directions(*mirrored), grained)
    torch.testing.assert_close(turned.values[0, :, 0], wanted, rtol=1e-7, atol=1e-9)
    torch.testing.assert_close(turned.at(turned.pairs), turned.values)


def test_rows_and_columns(tmp_path):
    """A BRDF that is not reciprocal tells light from viewer."""
    text = klems()
    values = text.split("<ScatteringData>")[1].split("</ScatteringData>")[0]
    first = values.split(",")[1]
    odd = text.replace(values, values.replace(first, " 77", 1), 1)  # light of patch 1, viewer of patch 0
    by_column = opened(tmp_path, odd)
    row = int(by_column.values[0, :, 0].argmax())
    assert by_column.pairs.cos_o[0, row] == 1 and by_column.pairs.cos_i[0, row] < 1
    by_row = opened(tmp_path, odd.replace("Columns", "Rows"))
    row = int(by_row.values[0, :, 0].argmax())
    assert by_row.pairs.cos_i[0, row] == 1 and by_row.pairs.cos_o[0, row] < 1
    assert torch.equal(opened(tmp_path, klems(by_row=True)).values, opened(tmp_path, text).values)


def test_sides_and_bands_are_told(tmp_path):
    blocks = [
        klems_block(direction="Transmission Front"),
        klems_block(direction="Reflection Front", band="Solar", scale=2),
        klems_block(direction="Reflection Front", band="Visible"),
        klems_block(direction="Reflection Back", band="Solar", scale=3),
    ]
    path = written(tmp_path, window_xml(blocks))
    facts = describe(path)
    assert facts["side"].startswith("front; the file has transmission front, reflection front, reflection back; --read")
    assert facts["band"] == "visible; passed over: 'solar'" and "the direction was believed" in facts["kind"]
    level = {}
    for settings in ({}, {"band": "solar"}, {"side": "back"}, {"side": "front", "band": "visible"}):
        level[*settings.values()] = load(path, settings=settings).values.max().item()
    first = level[()]
    assert level == pytest.approx({(): first, ("solar",): 2 * first, ("back",): 3 * first, ("front", "visible"): first})
    with pytest.raises(DataError, match="reflection back: expected the band visible, found 'solar'"):
        load(path, settings={"side": "back", "band": "visible"})
    with pytest.raises(UsageError, match="unknown side 'left'"):
        load(path, settings={"side": "left"})
    with pytest.raises(DataError, match="expected reflection back, found"):
        opened(tmp_path, klems(direction="Reflection Front"), side="back")


def test_tristimulus_values_become_colours(tmp_path):
    parts = {"CIE-X": 1.0, "Visible": 1.0, "CIE-Z": 1.0}
    white = opened(tmp_path, window_xml([klems_block(band=band, scale=one) for band, one in parts.items()]))
    plain = opened(tmp_path, klems())
    torch.testing.assert_close(white.values, plain.values, rtol=1e-3, atol=1e-3)
    red = opened(
        tmp_path, window_xml([klems_block(band=b, scale=s) for b, s in zip(parts, (1.2, 1, 0.6), strict=True)])
    )
    assert (red.values[..., 0] > red.values[..., 2]).all()


def test_the_command_is_told_and_says_what_was_taken(tmp_path, capsys):
    path = str(written(tmp_path, window_xml([klems_block(band="Solar"), klems_block(band="NIR")])))
    assert main(["info", path, "--read", "band=nir"]) == 0
    said = capsys.readouterr().out
    assert "nir; passed over: 'solar'" in said and "back; the file has reflection back" in said
    assert main(["info", path, "--read", "band=uv"]) == 2
    assert "unknown band 'uv'" in capsys.readouterr().err


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (klems(direction="Transmission Front"), "expected a reflection, found only 'transmission front'"),
        (klems().replace("<WindowElement", BOMB + "<WindowElement", 1), "expected XML without a document type"),
        (klems().replace("Columns", "Diagonals"), "expected Columns, Rows or a TensorTree, found 'Diagonals'"),
        (klems().replace(",</Scat", ", 1, 2</Scat"), "expected 41 x 41 numbers, found 1683"),
        (klems().replace("<ScatteringData>", "<ScatteringData>0.1x "), "expected numbers, found '0.1x'"),
        (klems().replace("<ScatteringData>", "<ScatteringData>1_0 "), "expected numbers, found '1_0'"),
        (klems().replace("LBNL/Klems Quarter", "mine"), "ColumnAngleBasis: expected one of"),
        (klems()[:-40], "found XML that is damaged"),
        (klems().replace("Layer>", "Lair>"), "with data of one Layer, found 0"),
        (window_xml([klems_block(), klems_block()]), "expected one reflection back of the band visible, found several"),
        (window_xml([]), "found 0"),
        (klems(band="Infrared"), "expected the band one of visible, solar, nir, found 'infrared'"),
        (klems("two rings").replace("<UpperTheta>90", "<UpperTheta>99"), "expected a ring from 30 degrees on"),
        (klems("two rings").replace("<nPhis>6", "<nPhis>6.5"), "expected a ring from 30 degrees on"),
        (klems("two rings").replace("<nPhis>6", "<nPhis>99999"), "expected a ring from 30 degrees on"),
        (klems().replace("<Optical>", "<a>" * 99), "expected elements up to 64 within each other"),
        (tensor_tree(rank=3).replace("TensorTree3", "TensorTree5"), "expected TensorTree3 or TensorTree4"),
        (tensor_tree(rank=3).replace("TensorTree3", "TensorTree4"), "expected "),
        (tensor_tree(rank=3).replace("Shirley", "Curly"), "AngleBasis: expected LBNL/Shirley-Chiu"),
        (tensor_tree(data="{1 2 3}"), "expected as many numbers as a cube of rank 3 has, found 3"),
        (tensor_tree(data="{{1}{2}}"), "expected 8 nodes in a node, or numbers, found 2"),
        (tensor_tree(data="{1} 2"), "expected numbers within a node without others, found '2'"),
        (tensor_tree(data="{1}{2}"), "expected one tree of up to 16 levels, found more"),
        (tensor_tree(data="{{1}{2}{3}{4}{5}{6}{7}{8}{9}}"), "expected 8 nodes in a node, found more"),
        (tensor_tree(data="{1 {2}}"), "expected nodes or numbers within a node, found both"),
        (tensor_tree(data="{{1}{2}{3}{4}{5}{6}{7}{8}"), "expected a tree in braces, found none, or one that is cut"),
        (tensor_tree(data="1"), "expected numbers within a node"),
        (tensor_tree(data="}"), "expected an opened node, found '}'"),
        (tensor_tree(data="{" * 50), "expected one tree of up to 16 levels, found more"),
        (tensor_tree(data="{x}"), "expected numbers, found 'x'"),
        (tensor_tree(data="{nan}"), "expected values up to"),
        (tensor_tree(direction="Transmission Back"), "expected a reflection, found only 'transmission back'"),
    ],
)
def test_bad_xml_is_refused(text, says, tmp_path):
    with pytest.raises(DataError) as caught:
        opened(tmp_path, text)
    assert says in str(caught.value) and "made-up.dat" in str(caught.value) and len(str(caught.value)) <= 300


# Radiance's tensor trees


@pytest.mark.parametrize("direction", ["Reflection Back", "Reflection Front"])
def test_trees_of_four_coordinates(direction, tmp_path):
    measured = opened(tmp_path, tensor_tree(4, direction))
    assert measured.is_anisotropic
    flip = torch.tensor([1, 1 if direction.endswith("Back") else -1, 1])
    own = Pairs.from_directions(measured.pairs.wi * flip, measured.pairs.wo * flip)
    torch.testing.assert_close(measured.values[0, :, 0], expected(own, grained), rtol=1e-6, atol=1e-8)
    assert describe(tmp_path / "made-up.dat")["tree"].startswith("rank 4, 7936 cells of 1/16 to 1/8")
    assert float(describe(tmp_path / "made-up.dat")["reciprocity error"].split()[0]) < 1


def test_cells_are_constant_and_the_finest_counts(tmp_path):
    """Of a tree of one cell, and of one whose eighths differ."""
    one = opened(tmp_path, tensor_tree(data="{0.25}"))
    assert torch.equal(one.at(at(one)[0]), torch.full((1, 1, 3), 0.25, dtype=torch.float64))
    eighths = opened(tmp_path, tensor_tree(data="{" + "".join(f"{{{n}}}" for n in range(8)) + "}"))
    # The first axis above 0.5 is not used; the viewer's +x is the second axis, +y the third.
    wi = torch.tensor([[-0.6, 0.0, 0.8]], dtype=torch.float64)
    for x, y, value in ((0.3, 0.2, 6), (0.3, -0.2, 2), (-0.3, 0.2, 4), (-0.3, -0.2, 0)):
        wo = torch.tensor([[x, y, math.sqrt(1 - x * x - y * y)]], dtype=torch.float64)
        assert eighths.at(Pairs.from_directions(wi[None], wo[None])).unique().tolist() == [value]
        turn = torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]], dtype=torch.float64)  # isotropic: both turned
        assert eighths.at(Pairs.from_directions((wi @ turn)[None], (wo @ turn)[None])).unique().tolist() == [value]
    assert len(eighths.pairs) == 4 and tree(3) == tree(3)


# pbrt's Fourier BSDFs


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


@pytest.mark.parametrize(
    "data", [mbsdf(), klems("LBNL/Klems Full"), tensor_tree(4), fourier(cosines=60), speos_binary(), lighttools()]
)
def test_what_would_be_too_large_in_memory(data, tmp_path, monkeypatch):
    path = written(tmp_path, data)
    monkeypatch.setenv("TORCHBRDF_MAX_BYTES", str(max(2000, path.stat().st_size // (8 if len(data) > 60_000 else 1))))
    with pytest.raises(DataError, match="TORCHBRDF_MAX_BYTES raises the limit"):
        load(path)


# Speos


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
        (speos().replace("5\t30\t60", "5\t60\t30", 1), "expected growing angles of the light"),
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


# LightTools


def test_sides_and_planes_of_incidence(tmp_path):
    front, back = lighttools(), lighttools(side="Back")
    both = front.replace("DataEnd\n", back.partition("DataBegin\n")[2])
    measured = opened(tmp_path, both)
    assert describe(tmp_path / "made-up.dat")["side"] == "front; --read side=front, side=back"
    assert torch.equal(opened(tmp_path, both, side="back").values, measured.values)
    planes = front.replace("DataEnd\n", lighttools(poi=30).partition("DataBegin\n")[2])
    with pytest.raises(DataError, match="POI: expected one plane of incidence, unless --read light_azimuth=poi"):
        opened(tmp_path, planes)
    turned = opened(tmp_path, planes, light_azimuth="poi")
    tilted = turned.pairs.cos_i[0] < 0.999
    azimuths = torch.atan2(turned.pairs.wi[0, tilted, 1], turned.pairs.wi[0, tilted, 0]).rad2deg().round().unique()
    assert azimuths.tolist() == [30, 90]


def test_wavelengths_and_tristimulus_values(tmp_path):
    plain = opened(tmp_path, lighttools())
    for more in ({"waves": (650, 450, 550)}, {"content": "XYZ"}):
        torch.testing.assert_close(opened(tmp_path, lighttools(**more)).values, plain.values, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (lighttools(kind="BTDF"), "expected a BRDF, found BTDF of the front"),
        (lighttools().replace("Asymmetric", "Round"), "expected a known Symmetry"),
        (lighttools().replace("DataBegin", ""), "and DataBegin, found"),
        (lighttools().replace("DataEnd", ""), "expected DataEnd behind whole blocks"),
        (lighttools().replace("AOI 20", "AOI 200"), "AOI: expected 0 to 90, found '200'"),
        (lighttools().replace("AOI 20", "AOI 0"), "found a second one for 0 degrees"),
        (lighttools().replace("AOI 20\n", ""), "expected a block for each angle of the light, found none"),
        (lighttools().replace("ScatterRadial 9", "ScatterRadial 8"), "expected 8 numbers, found 9"),
        (lighttools().replace("ScatterRadial 9", "ScatterRadial 0"), "expected a count of angles, found '0'"),
        (lighttools().replace("ScatterRadial 9\n0 10", "ScatterRadial 9\n0 99"), "expected growing angles up to 90"),
        (lighttools()[:-200], "expected"),
        (lighttools(waves=(550, 550)), "found a second one"),
        (lighttools(waves=(550, "x")), "expected ones in nm that differ"),
        (lighttools(content="XYZ").replace("TrisX", "TrisW"), "expected TrisX, TrisY, TrisZ"),
        (lighttools().replace("Side Front", "Side Left"), "expected Side Front or Back"),
    ],
)
def test_bad_files_of_lighttools_are_refused(text, says, tmp_path):
    with pytest.raises(DataError) as caught:
        opened(tmp_path, text)
    assert says in str(caught.value) and "made-up.dat" in str(caught.value)


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
