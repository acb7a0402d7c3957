"""Mitsuba 3: an XML file whose root is one `<bsdf>`, and the same as a dict.

W. Jakob et al., Mitsuba 3 renderer, 2022, https://mitsuba-renderer.org.
"""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import torch
from torch import Tensor

from torchbrdf.export.api import material_of, write
from torchbrdf.export.base import EXPORTERS, Brdf, Exported, Exporter, Material, numbers
from torchbrdf.export.grain import along_the_tangent, quarters
from torchbrdf.export.shading import visible
from torchbrdf.files import write_text
from torchbrdf.lobes import LOBES, FitRecord, Lambert, Lobe
from torchbrdf.measured import Measured
from torchbrdf.measured.plausibility import RECIPROCITY_TOLERANCE, nonreciprocity
from torchbrdf.names import file_stem

Bsdf = dict[str, Any]
"""A BSDF as `mitsuba.load_dict` takes it."""

# Of the format of the file.
VERSION = "3.0.0"
TABLE = ".bsdf"
# What Mitsuba takes for the beginning of a parameter's name, in any value.
PARAMETER = "$"
# Of a lobe in a blend, whose colour is as much brighter.
LEAST_WEIGHT = 0.001


# Parameters of Mitsuba's plugins that have other names here.
NAMES = {"albedo": "reflectance", "roughness": "alpha", "specular": "specular_reflectance"}
WITH_GRAIN = {**NAMES, "roughness_x": "alpha_u", "roughness_y": "alpha_v"}
# What is fitted to other lobes with a grain.
NEAREST_GRAIN = "lambert+roughconductor_anisotropic"
# Colours of Mitsuba's that are one number here.
GREY = ("specular_reflectance",)
# The lobes that Mitsuba has in the same form, by their registered names: a plugin with settings, its parameter that
# scales it, if there is one, and how its other parameters are called.
PLUGINS: dict[str, tuple[Bsdf, str | None, dict[str, str]]] = {
    "lambert": ({"type": "diffuse"}, "albedo", NAMES),
    "roughconductor": ({"type": "roughconductor", "distribution": "ggx"}, "specular", NAMES),
    "roughconductor_anisotropic": ({"type": "roughconductor", "distribution": "ggx"}, "specular", WITH_GRAIN),
    "principled": ({"type": "principled"}, None, {}),
    "roughplastic": (
        {"type": "roughplastic", "distribution": "ggx", "ext_ior": 1.0},
        None,
        {**NAMES, "base_color": "diffuse_reflectance", "ior": "int_ior"},
    ),
}


def mitsuba_dict(brdf: Brdf | FitRecord | str | os.PathLike[str], folder: str | os.PathLike[str] | None = None) -> Bsdf:
    """A material for `mitsuba.load_dict`, without its XML.

    Args:
        brdf: As for `export`.
        folder: Where a table is written, if Mitsuba does not have the model; by default the folder that we are in.

    Returns:
        The dict of a BSDF; one that reads a table has the full path of it.

    Example:
        >>> from torchbrdf.export.mitsuba import mitsuba_dict
        >>> from torchbrdf.lobes import Lambert
        >>> mitsuba_dict(Lambert(albedo=[0.5, 0.25, 0.125]))
        {'type': 'diffuse', 'reflectance': {'type': 'rgb', 'value': [0.5, 0.25, 0.125]}}
    """
    material = material_of(brdf)
    plugin = plugin_of(_near(material)[0])
    if plugin is not None:
        return plugin
    table = write(EXPORTERS["rgl"](), material, folder or Path())
    return {"type": "measured", "filename": str(table.files[0].absolute())}


def plugin_of(brdf: Brdf) -> Bsdf | None:
    """The BSDF of Mitsuba that is the same function; None if there is none.

    A sum is a blend, whose weights add up to 1: each lobe is as much brighter as its weight is below 1.
    """
    if not isinstance(brdf, Lobe):
        return None
    parts = visible(brdf) or [Lambert(albedo=0.0)]
    if not _has(parts) or any(quarters(part) is None for part in parts):
        return None
    if len(parts) == 1:
        return _plugin(parts[0], 1.0)
    scales = [_scale(part) for part in parts]
    if None in scales:
        return None
    return _blend(parts, [max(numbers(getattr(part, str(scale)))) for part, scale in zip(parts, scales, strict=True)])


def _blend(lobes: Sequence[Lobe], heights: Sequence[float], share: float = 1.0) -> Bsdf:
    """A blend of the first lobe and of the blend of the others; share: the weight of all of them in the whole."""
    first, *others = lobes
    if not others:
        return _plugin(first, 1 / share)
    weight = min(max(sum(heights[1:]) / sum(heights), LEAST_WEIGHT), 1 - LEAST_WEIGHT)
    (weight,) = numbers(torch.tensor([weight], dtype=torch.float64, device="cpu"))
    return {
        "type": "blendbsdf",
        "weight": weight,
        "bsdf_0": _plugin(first, 1 / (share * (1 - weight))),
        "bsdf_1": _blend(others, heights[1:], share * weight),
    }


def _plugin(lobe: Lobe, factor: float) -> Bsdf:
    """The plugin of a lobe, whose colour is multiplied by a factor."""
    settings, scale, names = PLUGINS[str(LOBES.name_of(type(lobe)))]
    made = dict(settings)
    for own in lobe.parameter_specs:
        value: Tensor = getattr(lobe, own).detach().double() * (factor if own == scale else 1.0)
        found = numbers(value)
        if own == "rotation":
            continue
        name = names.get(own, own)
        made[name] = _color(found * (3 // len(found))) if len(found) == 3 or name in GREY else found[0]
    if quarters(lobe) == 1:
        made["alpha_u"], made["alpha_v"] = made["alpha_v"], made["alpha_u"]
    return made


def _near(material: Material) -> tuple[Brdf, list[str]]:
    """What Mitsuba has of a model with a grain, and what was changed for it; all else as it is."""
    brdf = material.brdf
    if not isinstance(brdf, Lobe) or not brdf.is_anisotropic:
        return brdf, []
    return along_the_tangent(material, brdf, _has, NEAREST_GRAIN, "mitsuba")


def _has(parts: list[Lobe]) -> bool:
    """Whether Mitsuba has all lobes, wherever their grains lie."""
    return all(LOBES.name_of(type(part)) in PLUGINS for part in parts)


def _color(channels: list[float]) -> Bsdf:
    """A colour; one above 1 only goes with a plugin that does not check it."""
    color = {"type": "rgb", "value": channels}
    return color if max(channels) <= 1 else {"type": "srgb", "color": color, "unbounded": True}


def _scale(lobe: Lobe) -> str | None:
    return PLUGINS[str(LOBES.name_of(type(lobe)))][1]


@EXPORTERS.register("mitsuba")
class Mitsuba(Exporter):
    """A `<bsdf>` that `mitsuba.load_file` gives as a BSDF: a plugin where Mitsuba has the model, else a table."""

    suffix = ".xml"
    beside = (TABLE,)

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the table, if there has to be one, and the XML file that names it."""
        path = material.path(folder, self.suffix)
        shown, changed = _near(material)
        plugin = plugin_of(shown)
        if plugin is not None:
            write_text(path, to_xml(plugin, material.name))
            exact = not changed
            notes = [f"exact: Mitsuba's {_types(plugin)}"] if exact else [*changed, f"Mitsuba's {_types(plugin)}"]
            return Exported([path], exact, notes, material.brdf if exact else shown)
        table = EXPORTERS["rgl"]().write(
            Material(file_stem(material.name.replace(PARAMETER, "?")), material.brdf), folder
        )
        write_text(path, to_xml({"type": "measured", "filename": table.files[0].name}, material.name))
        turned = _turned(material.brdf) if table.exact else []
        return Exported([path, *table.files], table.exact and not turned, [*table.notes, *turned], table.shown)


def _turned(brdf: Brdf) -> list[str]:
    """A note on a measurement that Mitsuba shows with light and viewer exchanged, if that is to be seen."""
    if not isinstance(brdf, Measured):
        return []
    apart = nonreciprocity(brdf)[0].item()
    if apart <= RECIPROCITY_TOLERANCE:
        return []
    return [f"Mitsuba exchanges light and viewer: values there differ by {100 * apart:.2g} %, as it is not reciprocal"]


def _types(plugin: Bsdf) -> str:
    """The types of a plugin, and of those that it blends."""
    nested = [_types(plugin[name]) for name in ("bsdf_0", "bsdf_1") if name in plugin]
    return " + ".join(nested) if nested else str(plugin["type"])


def to_xml(plugin: Bsdf, name: str) -> str:
    """A BSDF as the text of an XML file."""
    root = ElementTree.Element("bsdf", version=VERSION, type=plugin["type"], id=name.replace(PARAMETER, "_"))
    root.extend(_elements(plugin))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _elements(plugin: Bsdf) -> Iterator[ElementTree.Element]:
    """What stands inside the element of a plugin."""
    for name, value in plugin.items():
        if name == "type":
            continue
        if isinstance(value, dict) and value["type"] == "rgb":
            yield ElementTree.Element("rgb", name=name, value=", ".join(map(repr, value["value"])))
        elif isinstance(value, dict):
            kind = "texture" if value["type"] == "srgb" else "bsdf"
            made = ElementTree.Element(kind, type=value["type"], name=name)
            made.extend(_elements(value))
            yield made
        else:
            kind = {bool: "boolean", float: "float", str: "string"}[type(value)]
            yield ElementTree.Element(kind, name=name, value=str(value).lower() if kind == "boolean" else str(value))
