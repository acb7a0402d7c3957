"""XML of WINDOW and Radiance: matrices over patches, and tensor trees."""

import math

import pytest
import torch
from helpers.table_files import (
    at,
    expected,
    grained,
    klems,
    klems_block,
    opened,
    tensor_tree,
    tree,
    window_xml,
    written,
)

from torchbrdf.cli import main
from torchbrdf.errors import DataError, UsageError
from torchbrdf.measured import describe, load
from torchbrdf.pairs import Pairs


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
    assert facts["side"].startswith(
        "front; the file has 'transmission front, reflection front, reflection back'; --read"
    )
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
    assert "nir; passed over: 'solar'" in said and "back; the file has 'reflection back'" in said
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
