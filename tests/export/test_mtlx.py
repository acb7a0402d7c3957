"""Materials as MaterialX."""

from pathlib import Path
from typing import Any

import pytest

from torchbrdf.export import export
from torchbrdf.export.mtlx import INPUTS, document, node_name
from torchbrdf.lobes import EON, GGX, Lambert, OpenPBR, Sum

EVERYTHING = {name: [0.25, 0.5, 0.75] if limits.size == 3 else 0.5 for name, limits in INPUTS.items()}


def read(path: Path) -> Any:
    """The document of a file with the standard library, as the package reads them; it must be valid."""
    mx = pytest.importorskip("MaterialX", reason="needs the package materialx")
    made = mx.createDocument()
    mx.readFromXmlFile(made, str(path))
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    made.setDataLibrary(library)
    valid, said = made.validate()
    assert valid, said
    return made


def surface(made: Any) -> Any:
    """The surface that the only material of a document shows."""
    (material,) = made.getMaterialNodes()
    (input_,) = material.getInputs()
    return input_.getConnectedNode()


def test_every_input_is_one_of_the_standard_library(tmp_path: Path) -> None:
    path = tmp_path / "x.mtlx"
    path.write_text(document(EVERYTHING, "x"))
    made = read(path)
    node = surface(made)
    declared = node.getNodeDef()
    assert declared.getName() == "ND_open_pbr_surface_surfaceshader"
    assert {one.getName() for one in node.getInputs()} == set(EVERYTHING)
    for one in node.getInputs():
        assert declared.getInput(one.getName()).getType() == one.getType(), one.getName()
        value, expected = one.getValue(), EVERYTHING[one.getName()]
        assert (list(value) if isinstance(expected, list) else value) == expected
    assert made.getColorSpace() == "lin_rec709"


def test_the_limits_are_those_of_the_standard_library(tmp_path: Path) -> None:
    (tmp_path / "x.mtlx").write_text(document({}, "x"))
    made = read(tmp_path / "x.mtlx")
    declared = surface(made).getNodeDef()
    for name, limits in INPUTS.items():
        one = declared.getInput(name)
        assert set(one.getAttribute("uimin").split(",")) <= {str(limits.lower), f"{limits.lower:g}"}, name
        assert one.getAttribute("uimax") in ("", "1.0", "1,1,1")
        assert (limits.upper == 1) == bool(one.getAttribute("uimax")), name


def test_a_wrong_input_is_not_valid(tmp_path: Path) -> None:
    mx = pytest.importorskip("MaterialX", reason="needs the package materialx")
    (tmp_path / "x.mtlx").write_text(document({"shininess": 0.5}, "x"))
    with pytest.raises((AssertionError, mx.Exception)):
        read(tmp_path / "x.mtlx")


@pytest.mark.parametrize(
    ("brdf", "expected"),
    [
        (
            Sum(Lambert(albedo=[0.5, 0.25, 0.125]), GGX(specular=0.0)),
            {"base_color": [0.5, 0.25, 0.125], "base_diffuse_roughness": 0, "specular_weight": 0},
        ),
        (
            EON(albedo=[0.5, 0.25, 0.125], roughness=0.5),
            {"base_color": [0.5, 0.25, 0.125], "base_diffuse_roughness": 0.5, "specular_weight": 0},
        ),
        (
            GGX(specular=0.5, roughness=0.25, f0=0.75),
            {"base_color": [0.75] * 3, "base_metalness": 1, "specular_weight": 0.5, "specular_roughness": 0.5},
        ),
    ],
)
def test_what_is_exact(brdf: Any, expected: dict[str, Any], tmp_path: Path) -> None:
    done = export(brdf, "mtlx", tmp_path, name="2 x blue \u00e4 <&>")
    assert done.exact and done.notes == ["exact: OpenPBR's surface"]
    made = read(done.files[0])  # its elements do not keep it
    node = surface(made)
    for name, value in expected.items():
        found = node.getInputValue(name)
        assert (list(found) if isinstance(value, list) else found) == pytest.approx(value, abs=1e-6), name


def test_names_are_those_of_materialx() -> None:
    mx = pytest.importorskip("MaterialX", reason="needs the package materialx")
    for name in ("nickel", "gold-paint 2", "2", "_", "\u00e4\u00f6", "x" * 200, "a.b:c"):
        assert mx.isValidName(node_name(name)) and node_name(name).isascii() and node_name(name)[0].isalpha()


def test_the_lobe_s_parameters_are_written_as_they_are(tmp_path: Path) -> None:
    values: dict[str, Any] = {name: EVERYTHING[name] for name in OpenPBR.parameter_specs}
    values |= {"specular_color": [0.625, 0.75, 0.875], "specular_ior": 1.25, "coat_ior": 1.75}
    done = export(OpenPBR(**values), "mtlx", tmp_path)
    assert done.exact and done.notes == ["exact: OpenPBR's surface"]
    made = read(done.files[0])
    node = surface(made)
    for name, value in values.items():
        found = node.getInputValue(name)
        assert (list(found) if isinstance(value, list) else found) == value, name
