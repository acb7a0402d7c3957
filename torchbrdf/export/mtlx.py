"""MaterialX: a document with an OpenPBR surface.

Academy Software Foundation, MaterialX 1.39, https://materialx.org; OpenPBR Surface 1.1, 2024,
https://academysoftwarefoundation.github.io/OpenPBR.
"""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from torchbrdf.export.base import EXPORTERS, Exported, Exporter, Material
from torchbrdf.export.shading import COLOUR, UNIT, Limits, Target, Values, numbers_of
from torchbrdf.lobes import EON, GGX, Lambert

VERSION = "1.39"
# Linear, with the primaries of Rec. 709.
COLOUR_SPACE = "lin_rec709"
# Of OpenPBR's parameters those of opaque reflection, by their names in MaterialX, and what they may be.
INPUTS: dict[str, Limits] = {
    "base_weight": UNIT,
    "base_color": COLOUR,
    "base_diffuse_roughness": UNIT,
    "base_metalness": UNIT,
    "specular_weight": Limits(0.0, 1e6),
    "specular_color": COLOUR,
    "specular_roughness": UNIT,
    "specular_ior": Limits(0.0, 1e6),
    "coat_weight": UNIT,
    "coat_color": COLOUR,
    "coat_roughness": UNIT,
    "coat_ior": Limits(0.0, 1e6),
    "coat_darkening": UNIT,
    "fuzz_weight": UNIT,
    "fuzz_color": COLOUR,
    "fuzz_roughness": UNIT,
}


def diffuse(lobe: Lambert | EON) -> Values:
    """OpenPBR's diffuse base, without a reflection above it: Lambert's, or with a roughness EON."""
    roughness = lobe.roughness.item() if isinstance(lobe, EON) else 0.0
    return {
        "base_color": numbers_of(lobe.albedo),
        "base_diffuse_roughness": roughness,
        "base_metalness": 0.0,
        "specular_weight": 0.0,
    }


def ggx(lobe: GGX) -> Values | None:
    """OpenPBR's metal, if no colour has to stand before Schlick's Fresnel."""
    specular, f0 = lobe.specular.tolist(), lobe.f0.item()
    if max(specular) != min(specular):
        return None
    return _metal([f0] * 3, [1.0] * 3, specular[0], lobe.roughness.item())


def conductor(lobe: Any) -> Values:
    """OpenPBR's metal, whose Fresnel has a tint at 82 degrees."""
    return _metal(lobe.f0.tolist(), lobe.f82.tolist(), lobe.weight.item(), lobe.roughness.item())


def _metal(f0: list[float], tint: list[float], weight: float, alpha: float) -> Values:
    return {
        "base_color": f0,
        "base_metalness": 1.0,
        "specular_weight": weight,
        "specular_color": tint,
        "specular_roughness": alpha**0.5,
    }


def inputs_of(lobe: Any) -> Values:
    """The lobe has OpenPBR's own parameters."""
    return {name: numbers_of(getattr(lobe, name)) for name in lobe.parameter_specs}


OPENPBR = Target(
    title="OpenPBR's surface",
    limits=INPUTS,
    model="openpbr",
    translated=inputs_of,
    differs="",
    simple={"lambert": diffuse, "eon": diffuse, "ggx": ggx, "ggx_f82": conductor},
    name="mtlx",
)


@EXPORTERS.register("mtlx")
class MaterialX(Exporter):
    """A `.mtlx` document with one material, an `open_pbr_surface`."""

    suffix = ".mtlx"

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the document."""
        shading = OPENPBR.shading(material)
        return shading.write(material.path(folder, self.suffix), document(shading.values, material.name))


def document(values: Values, name: str) -> str:
    """The text of a MaterialX document.

    Args:
        values: Inputs of `open_pbr_surface` by name; what is not among them has its default there.
        name: Of the material.

    Example:
        >>> print(document({"base_metalness": 1.0}, "nickel").splitlines()[3].strip())
        <input name="base_metalness" type="float" value="1.0" />
    """
    node = node_name(name)
    root = ElementTree.Element("materialx", version=VERSION, colorspace=COLOUR_SPACE)
    surface = ElementTree.SubElement(root, "open_pbr_surface", name=f"{node}_surface", type="surfaceshader")
    for key, value in values.items():
        kind = "color3" if isinstance(value, list) else "float"
        text = ", ".join(map(repr, value)) if isinstance(value, list) else repr(value)
        ElementTree.SubElement(surface, "input", name=key, type=kind, value=text)
    material = ElementTree.SubElement(root, "surfacematerial", name=node, type="material", doc=name)
    ElementTree.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"{node}_surface")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def node_name(name: str) -> str:
    """A name as MaterialX allows one: ASCII letters, digits and underscores, a letter first.

    Example:
        >>> node_name("gold-metallic-paint2"), node_name("2 x blue")
        ('gold_metallic_paint2', 'material_2_x_blue')
    """
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if plain[0].isalpha() else f"material_{plain}"
