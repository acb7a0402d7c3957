"""MaterialX: a document with an OpenPBR surface.

Academy Software Foundation, MaterialX 1.39, https://materialx.org; OpenPBR Surface 1.1, 2024,
https://academysoftwarefoundation.github.io/OpenPBR.
"""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from torchbrdf.export.base import EXPORTERS, Exported, Exporter, Material, has_grain
from torchbrdf.export.shading import COLOUR, UNIT, Limits, Target, Values, numbers_of
from torchbrdf.lobes import EON, GGX, GGXAnisotropic, Lambert

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
ANISOTROPY = "specular_roughness_anisotropy"
# An input that is a vector: here the azimuth of the wide direction from the mesh's tangent, radians.
TANGENT = "geometry_tangent"


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


def ggx_with_grain(lobe: GGXAnisotropic) -> Values | None:
    """The same with the grain of GGX."""
    straight = ggx(GGX(specular=lobe.specular.detach(), roughness=0.5, f0=lobe.f0.detach()))
    if straight is None:
        return None
    return straight | grain(lobe.roughness_x.item(), lobe.roughness_y.item(), lobe.rotation.item())


def grain(along: float, across: float, rotation: float) -> Values:
    """OpenPBR's roughness, anisotropy and direction of a grain, of alpha along and across its x axis.

    The wide direction has alpha_t = roughness^2 sqrt(2 / (1 + (1 - anisotropy)^2)), the other one
    alpha_b = (1 - anisotropy) alpha_t: OpenPBR 1.1, "Microfacet model".
    """
    narrow, wide = min(along, across), max(along, across)
    turn = rotation if along > across else rotation + math.pi / 2
    return {
        "specular_roughness": ((wide**2 + narrow**2) / 2) ** 0.25,
        ANISOTROPY: 1 - narrow / wide,
        TANGENT: turn % math.pi,
    }


def inputs_with_grain(lobe: Any) -> Values:
    """The lobe has OpenPBR's own parameters, but for those of the grain."""
    along, across = lobe.specular_roughness_x.item() ** 2, lobe.specular_roughness_y.item() ** 2
    others = {name: numbers_of(getattr(lobe, name)) for name in lobe.parameter_specs if name in INPUTS}
    return others | grain(along, across, lobe.rotation.item())


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

WITH_GRAIN = replace(
    OPENPBR,
    limits={**INPUTS, ANISOTROPY: UNIT, TANGENT: Limits(0.0, math.pi)},
    model="openpbr_anisotropic",
    translated=inputs_with_grain,
    simple={**OPENPBR.simple, "ggx_anisotropic": ggx_with_grain},
)


@EXPORTERS.register("mtlx")
class MaterialX(Exporter):
    """A `.mtlx` document with one material, an `open_pbr_surface`."""

    suffix = ".mtlx"

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the document."""
        shading = (WITH_GRAIN if has_grain(material) else OPENPBR).shading(material)
        return shading.write(material.path(folder, self.suffix), document(shading.values, material.name))


def document(values: Values, name: str) -> str:
    """The text of a MaterialX document.

    Args:
        values: Inputs of `open_pbr_surface` by name; what is not among them has its default there. `TANGENT` is the
            angle in radians by which the mesh's tangent is turned.
        name: Of the material.

    Example:
        >>> print(document({"base_metalness": 1.0}, "nickel").splitlines()[3].strip())
        <input name="base_metalness" type="float" value="1.0" />
    """
    node = node_name(name)
    root = ElementTree.Element("materialx", version=VERSION, colorspace=COLOUR_SPACE)
    values = dict(values)
    turn = values.pop(TANGENT, None)
    if turn is not None and values.get(ANISOTROPY):
        _turned_tangent(root, node, float(turn))  # type: ignore[arg-type]
    surface = ElementTree.SubElement(root, "open_pbr_surface", name=f"{node}_surface", type="surfaceshader")
    for key, value in values.items():
        kind = "color3" if isinstance(value, list) else "float"
        text = ", ".join(map(repr, value)) if isinstance(value, list) else repr(value)
        ElementTree.SubElement(surface, "input", name=key, type=kind, value=text)
    if root.find(f"*[@name='{node}_tangent']") is not None:
        ElementTree.SubElement(surface, "input", name=TANGENT, type="vector3", nodename=f"{node}_tangent")
    material = ElementTree.SubElement(root, "surfacematerial", name=node, type="material", doc=name)
    ElementTree.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"{node}_surface")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _turned_tangent(root: ElementTree.Element, node: str, turn: float) -> None:
    """Nodes for cos(turn) tangent + sin(turn) bitangent: of `rotate3d` it is open to which side it turns."""
    parts = []
    for direction, share in (("tangent", math.cos(turn)), ("bitangent", math.sin(turn))):
        own = ElementTree.SubElement(root, direction, name=f"{node}_own_{direction}", type="vector3")
        ElementTree.SubElement(own, "input", name="space", type="string", value="world")
        part = ElementTree.SubElement(root, "multiply", name=f"{node}_along_{direction}", type="vector3")
        ElementTree.SubElement(part, "input", name="in1", type="vector3", nodename=f"{node}_own_{direction}")
        ElementTree.SubElement(part, "input", name="in2", type="float", value=repr(float(f"{share:.7g}")))
        parts.append(f"{node}_along_{direction}")
    total = ElementTree.SubElement(root, "add", name=f"{node}_tangent", type="vector3")
    for name, part_name in zip(("in1", "in2"), parts, strict=True):
        ElementTree.SubElement(total, "input", name=name, type="vector3", nodename=part_name)


def node_name(name: str) -> str:
    """A name as MaterialX allows one: ASCII letters, digits and underscores, a letter first.

    Example:
        >>> node_name("gold-metallic-paint2"), node_name("2 x blue")
        ('gold_metallic_paint2', 'material_2_x_blue')
    """
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if plain[0].isalpha() else f"material_{plain}"
