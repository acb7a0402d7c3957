"""Layouts of files as programs other than a format's own write them: the values that they were made of are read."""

import json
import re

import numpy as np
import pytest
import torch
from helpers.listed_files import bird as bird_file
from helpers.listed_files import zemax
from helpers.table_files import (
    definition,
    directions,
    expected,
    grained,
    isotropic,
    klems,
    klems_block,
    lighttools,
    opened,
    speos,
    speos_spectral,
    tensor_tree,
    tree,
    tree_directions,
    window_xml,
)

from torchbrdf.errors import DataError
from torchbrdf.measured import describe
from torchbrdf.measured.find import format_of

KLEMS = klems()


def holds(measured, f=isotropic, scale=1.0):
    """Whether the valid values of a file are those of a known BRDF."""
    good = measured.weight[0, :, 0] > 0
    wanted = scale * expected(measured.pairs, f)[good].double()
    torch.testing.assert_close(measured.values[0, good, 1], wanted, rtol=1e-4, atol=1e-5)
    return True


# XML of WINDOW and Radiance


def absorbed(layer):
    """What WINDOW writes of each layer of a system: a block that neither reflects nor transmits."""
    return (
        f"<WavelengthData><LayerNumber>{layer}</LayerNumber><Wavelength>Visible</Wavelength><WavelengthDataBlock>"
        "<WavelengthDataDirection>Absorptance Front</WavelengthDataDirection><ScatteringData>0.1, 0.2</ScatteringData>"
        "</WavelengthDataBlock></WavelengthData>"
    )


def of_layer(layer, scale):
    """A reflection of one layer of a system."""
    text = window_xml([klems_block(scale=scale)]).replace("System", layer)
    return text[text.index("<WavelengthData>") : text.index("</Layer>")]


def by_middles(basis, middles, counts):
    """A definition of a basis without bounds."""
    rings = "".join(
        f"<AngleBasisBlock><Theta>{theta}</Theta><nPhis>{count}</nPhis></AngleBasisBlock>"
        for theta, count in zip(middles, counts, strict=True)
    )
    return f"<AngleBasis><AngleBasisName>{basis}</AngleBasisName>{rings}</AngleBasis>"


QUARTER = by_middles("LBNL/Klems Quarter", (0, 18, 36.5, 56, 78), (1, 8, 12, 12, 8))


@pytest.mark.parametrize(
    "text",
    [
        "Recover using: genBSDF -recover folder\n" + KLEMS,
        re.sub(r"<(/?)([A-Z])", r"<\1ns0:\2", KLEMS).replace("xmlns=", "xmlns:ns0="),
        KLEMS.replace("\n", " "),
        KLEMS.split("\n", 1)[1],
        KLEMS.replace("<WindowElement ", "<!-- not as a TensorTree4 -->\n<WindowElement ", 1),
        KLEMS.replace(">Columns<", ">\n\tcolumns\n<").replace("Reflection Back", " reflection  back "),
        KLEMS.replace("</Layer>", absorbed(1) + absorbed(2) + "</Layer>"),
        KLEMS.replace("</Layer>", of_layer("1", 3.0) + "</Layer>"),
        KLEMS.replace("</IncidentDataStructure>", "</IncidentDataStructure>" + QUARTER),
        klems("two rings").replace(definition("two rings"), by_middles("two rings", (15, 60), (4, 6))),
        klems("two rings").replace("<LowerTheta>0<", "<LowerTheta>-30<"),
        re.sub(r"<(Column|Row)AngleBasis>.*?</\1AngleBasis>", "", klems("two rings")).replace("Columns", "Column"),
    ],
    ids=range(12),
)
def test_matrices_of_programs(text, tmp_path):
    assert holds(opened(tmp_path, text), grained)


def test_text_in_front_of_xml_is_said(tmp_path):
    opened(tmp_path, "Recover using: genBSDF\n" + KLEMS)
    assert describe(tmp_path / "made-up.dat")["mended"] == (
        "text in front of the XML passed over: 'Recover using: genBSDF'"
    )


def test_elements_that_wrap_bsdf_cut_are_mended(tmp_path):
    """That of 2015 wrote the source of all bands but the visible one without its first character."""
    bands = {"CIE-X": 1.2, "Visible": 1.0, "CIE-Z": 0.6}
    whole = window_xml([klems_block(band=band, scale=scale) for band, scale in bands.items()])
    source = "</Wavelength>\n\t\tSourceSpectrum>CIE Illuminant D65 1nm.ssp</SourceSpectrum>\n"
    cut = opened(tmp_path, whole.replace("</Wavelength>", source))
    assert describe(tmp_path / "made-up.dat")["mended"] == "3 elements SourceSpectrum that begin without '<'"
    assert torch.equal(
        cut.values, opened(tmp_path, whole.replace("</Wavelength>", source.replace("S", "<S", 1))).values
    )
    assert (cut.values[..., 0] > cut.values[..., 2]).all() and "mended" not in describe(tmp_path / "made-up.dat")


def test_a_basis_without_bounds_of_its_own_azimuths_is_refused(tmp_path):
    text = klems("two rings").replace(definition("two rings"), by_middles("two rings", (15, 60), ("", "")))
    with pytest.raises(
        DataError, match="expected a ring from 0 degrees on and its count of patches, found '0\\.0 30\\.0 '"
    ):
        opened(tmp_path, text)


@pytest.mark.parametrize(("unit", "times"), [("Nanometer", 1), ("nanometers", 1), ("Micrometer", 1000)])
def test_matrices_of_wavelengths_are_bands(unit, times, tmp_path):
    scales = {650: 1.5, 450: 0.5, 550: 1.0}
    text = window_xml([klems_block(band=f"at{wave / times}", scale=scale) for wave, scale in scales.items()])
    text = re.sub(r'unit="Integral">at', f'unit="{unit}">', text)
    kept = opened(tmp_path, text, bands="keep")
    assert kept.wavelengths == (450, 550, 650) and holds(kept, grained)
    torch.testing.assert_close(kept.values[..., 2], 3 * kept.values[..., 0], rtol=1e-6, atol=1e-9)
    assert describe(tmp_path / "made-up.dat")["band"] == "450 nm, 550 nm, 650 nm"
    both = text.replace("</Layer>", of_layer("System", 2.0) + "</Layer>")
    assert holds(opened(tmp_path, both), grained, 2.0)
    assert opened(tmp_path, both, band="spectral", bands="keep").wavelengths == (450, 550, 650)
    with pytest.raises(DataError, match="expected the band spectral, found 'visible'"):
        opened(tmp_path, KLEMS, band="spectral")
    with pytest.raises(DataError, match="Wavelength: expected a name, or one in nm, found '0'"):
        opened(tmp_path, window_xml([klems_block(band="0")]))


def test_a_tree_that_was_not_pruned(tmp_path):
    """One node with all cells, a number a line; of rank 3 the half that is not used is 0."""
    for rank, f in ((3, isotropic), (4, grained)):
        index = np.stack(np.unravel_index(np.arange(8**rank), (8,) * rank), -1)
        values = f(*tree_directions((index + 0.5) / 8))
        if rank == 3:
            values[index[:, 0] >= 4] = 0
        data = "{\n" + "".join(f"\t{one:.6e}\n" for one in values) + "}\n"
        assert holds(opened(tmp_path, tensor_tree(rank, data=data)), f)


def colored(u, v, structure="TensorTree3"):
    """Text of a tree with chromaticities."""
    basis = "<AngleBasis>LBNL/Shirley-Chiu</AngleBasis>"
    bands = {"Visible": tree(3), "CIE-u": u, "CIE-v": v}
    return window_xml([("Reflection Back", band, basis, data) for band, data in bands.items()], structure)


def test_trees_have_colours_in_trees_of_their_own(tmp_path):
    """Of equal energy u' = 4 / 19 and v' = 9 / 19; halves of the viewer's azimuths may be another one."""
    white = opened(tmp_path, colored("{0.21052631578947367}", "{0.47368421052631576}"))
    assert holds(white)
    torch.testing.assert_close(white.values[..., 0], white.values[..., 2], rtol=1e-4, atol=1e-4)
    halves = "{" + "".join(f"{{{0.3 if k & 2 else 4 / 19:.9g}}}" for k in range(8)) + "}"
    red = opened(tmp_path, colored(halves, "{0.47368421052631576}"))
    ratio = red.values[0, :, 0] / red.values[0, :, 2]
    # The light is at -x: the viewer's +x is the second axis.
    torch.testing.assert_close((ratio > 1.1), red.pairs.wo[0, :, 0] > 0)
    said = describe(tmp_path / "made-up.dat")
    assert said["band"] == "visible, cie-u, cie-v" and said["chromaticities"].startswith("of the middle of each cell")
    with pytest.raises(DataError, match="expected values up to"):
        opened(tmp_path, colored("{0.3}", "{0}"))


# FRED's tables


def fred(lights=((10, 0), (40, 0)), azimuths=range(0, 181, 20), polar=range(0, 81, 10), f=isotropic):
    """Text of a table."""
    lines = ["type bsdf_data", "format angles=deg bsdf=value scale=1"]
    for light, turn in lights:
        lines.append(f"{light}\t{turn}")
        for theta in polar:
            for phi in azimuths if theta else (180,):
                wi = directions(np.radians(light), np.radians(turn) + np.pi)
                value = f(wi, directions(np.radians(theta), np.radians(phi)))
                lines.append(f"{theta}\t{phi}\t{value:.9f}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        fred(azimuths=range(0, 360, 20)),
        fred(lights=((0, 0), (45, 0)), polar=(45,), azimuths=(0,))
        + fred(((12, 0), (15, 0)), polar=(0,)).split("\n", 2)[2],
        fred(lights=((10, 90), (40, 90)), azimuths=range(0, 360, 20)),
        fred(azimuths=(0,), polar=range(-80, 81, 10)),
        fred().replace("\t", ","),
        fred().replace("\t", ", "),
        fred().replace("=", " = "),
        fred().upper(),
    ],
    ids=range(8),
)
def test_tables_of_fred(text, tmp_path):
    assert holds(opened(tmp_path, text))


def test_tables_of_fred_have_a_grain(tmp_path):
    assert holds(opened(tmp_path, fred(((30, 20), (60, 20)), range(0, 360, 20), f=grained)), grained)


# Speos


def shape_of(measured):
    """The ratio of valid values to those of the known BRDF, which a file scales."""
    good = measured.weight[0, :, 0] > 0
    return measured.values[0, good, 1] / expected(measured.pairs)[good]


def test_the_layout_of_a_converter_to_speos(tmp_path):
    """Empty description of the spectrum, trailing tabs, a last line."""
    text = speos(kind=1)
    wanted = shape_of(opened(tmp_path, text))
    made = text.replace("comment\n7\nmade up\n", "Comment\n23\nMeasurement description\n").replace(
        "its spectrum\n", "\n"
    )
    found = shape_of(opened(tmp_path, made + "End of file\n"))
    torch.testing.assert_close(found, wanted)
    torch.testing.assert_close(found, found[:1].expand_as(found), rtol=1e-6, atol=0)


def test_angles_of_the_light_in_any_order(tmp_path):
    for make in (speos, speos_spectral):
        ordered, mixed = opened(tmp_path, make()), opened(tmp_path, make(lights=(30, 5, 60)), "mixed")
        torch.testing.assert_close(mixed.values.sum(), ordered.values.sum())
        torch.testing.assert_close(mixed.values.max(), ordered.values.max())
        place = int(mixed.values[0, :, 1].argmax())
        torch.testing.assert_close(mixed.pairs.wi[0, place], ordered.pairs.wi[0, int(ordered.values[0, :, 1].argmax())])


def test_wavelengths_at_which_nothing_is_reflected(tmp_path):
    """Of such a one tables may be all 0."""
    text = speos_spectral(shares=(0, 50, 80))
    assert not opened(tmp_path, text, bands="keep").values[..., 0].any()
    rows = text.split("\n")
    at = rows.index("0", 7)
    rows[at + 3 : at + 13] = [re.sub(r"\t[^\t]+", "\t0", row) for row in rows[at + 3 : at + 13]]
    assert torch.equal(opened(tmp_path, "\n".join(rows)).values, opened(tmp_path, text, "plain").values)


@pytest.mark.parametrize(
    "lines", ["Scattering surface\n0\n\n", "comment\n0\n", "File extracted from\n5\n-----\n", "\n11\na\nbc\nd 1 2 3\n"]
)
def test_descriptions_of_speos(lines, tmp_path):
    text = speos_spectral()
    wanted = opened(tmp_path, text).values
    assert torch.equal(opened(tmp_path, text.replace("comment\n0\n\n", lines)).values, wanted)


# LightTools and Zemax

LIGHT_TOOLS, ZEMAX = lighttools(), zemax()


@pytest.mark.parametrize(
    "text",
    [
        LIGHT_TOOLS.replace(" ", "\t"),
        LIGHT_TOOLS.replace(" ", "   "),
        re.sub(r"(Scatter\w+ \d+)\n", r"\1\t\n", LIGHT_TOOLS),
        re.sub(r"(Scatter(?:Azimuth|Radial) \d+)\n", r"\1 ", LIGHT_TOOLS),
        re.sub(r"(?m)^[\d.e+-]+(?: [\d.e+-]+)+$", lambda row: row[0].replace(" ", "\n"), LIGHT_TOOLS),
        LIGHT_TOOLS.replace("AOI 20", "AOI 20 # degrees").replace("TIS 0.5", "TIS 0.5\n# of all"),
        LIGHT_TOOLS.replace("AOI 20", "AOI 20 deg").replace("Wavelength 550", "Wavelength 550 nm"),
        LIGHT_TOOLS.replace("AOI 20\n", "AOI 20\nPolarization None\n"),
        re.sub(r"(POI|Wavelength|Side) .*\n", "", LIGHT_TOOLS),
        re.sub(r"ScatterType .*\n", "", LIGHT_TOOLS).replace("DataBegin", "ScatterType BRDF\nDataBegin"),
        LIGHT_TOOLS.replace("# made up", "Version 2.0\nSource Measured"),
    ],
    ids=range(11),
)
def test_tables_of_lighttools(text, tmp_path):
    assert format_of(_written(tmp_path, text)) == "lighttools"
    assert holds(opened(tmp_path, text))


def test_words_of_lighttools_that_are_not_known_are_said(tmp_path):
    opened(tmp_path, LIGHT_TOOLS.replace("AOI 20\n", "AOI 20\nPolarization None\n"))
    assert describe(tmp_path / "made-up.dat")["passed over"] == "'polarization'"


def _written(folder, text):
    path = folder / "asked.dat"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        ZEMAX.replace("\n\n", "\n"),
        ZEMAX.replace("\t", "  "),
        re.sub(r"(?m)$", "\t", ZEMAX),
        ZEMAX.replace("SampleRotation\t1\n0\n", ""),
        re.sub(r"(AngleOfIncidence\t2)\n", r"\1\t", ZEMAX),
        ZEMAX.replace("AngleOfIncidence", "# the light\nAngleOfIncidence").replace(
            "10\t40", "# of it\n10\t40 # degrees"
        ),
        re.sub(r"(?m)^[\d.e+-]+(?:\t[\d.e+-]+)+$", lambda row: row[0].replace("\t", "\n"), ZEMAX),
        zemax(symmetry="ASymmetrical4D", azimuths=tuple(range(0, 360, 20))),
    ],
    ids=range(8),
)
def test_tables_of_zemax(text, tmp_path):
    assert holds(opened(tmp_path, text))


@pytest.mark.parametrize(("name", "count", "said"), [("SampleRotation", 1, 90), ("AngleOfIncidence", 2, 1)])
def test_counts_of_zemax_that_lie_are_said(name, count, said, tmp_path):
    assert holds(opened(tmp_path, ZEMAX.replace(f"{name}\t{count}", f"{name}\t{said}")))
    assert describe(tmp_path / "made-up.dat")[name] == f"the file says {said}, and lists {count}; these were believed"


def test_angles_of_zemax_that_are_missing_are_refused(tmp_path):
    with pytest.raises(DataError, match="AngleOfIncidence: expected 2 angles, found none"):
        opened(tmp_path, ZEMAX.replace("10\t40\n", ""))
    with pytest.raises(DataError, match="expected 10 rows of values, found 20"):
        opened(tmp_path, ZEMAX.replace("10\t40\n", "10\n"))


# Others


def test_a_variable_of_bird_may_be_called_value(tmp_path):
    document = json.loads(bird_file())
    wanted = opened(tmp_path, json.dumps(document)).values
    document["data"]["BRDF"]["value"] = document["data"]["BRDF"].pop("values")
    assert torch.equal(opened(tmp_path, json.dumps(document)).values, wanted)
    del document["data"]["BRDF"]["value"]
    with pytest.raises(DataError, match="BRDF: expected values, found none"):
        opened(tmp_path, json.dumps(document))


def test_a_function_of_alta_is_no_data(tmp_path):
    text = "#ALTA FUNC HEADER\n#CMD fit\n#DIM 1 1\n#PARAM_IN COS_TH\n#ALTA HEADER END\n\n#FUNC rational\n0 0.1\n1 0.2\n"
    with pytest.raises(DataError, match="found a function that ALTA fitted, and no data"):
        opened(tmp_path, text)


@pytest.mark.parametrize(("names", "row"), [("X,Y,Z", "0.47525,0.5,0.5445"), ("Z,Y,X", "0.5445,0.5,0.47525")])
def test_astm_has_tristimulus_values(names, row, tmp_path):
    """Of half of the white of BT.709."""
    head = f"LAB_NAME made up\nVARS theta_i,phi_i,theta_s,phi_s,{names}\n"
    values = opened(tmp_path, head + f"0.5,0,0.4,3.1,{row}\n0.5,0,0.6,3.1,{row}\n").values
    torch.testing.assert_close(values, torch.full_like(values, 0.5), rtol=1e-3, atol=1e-3)
    assert describe(tmp_path / "made-up.dat")["tristimulus values"] == "made linear RGB (BT.709)"
