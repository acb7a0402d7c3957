"""Mitsuba 3: an XML file whose root is one `<bsdf>`, and the same as a dict.

W. Jakob et al., Mitsuba 3 renderer, 2022, https://mitsuba-renderer.org.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from torchbrdf.export.api import material_of, write
from torchbrdf.export.base import EXPORTERS, Brdf, Exported, Exporter, Material, numbers
from torchbrdf.files import write_text
from torchbrdf.lobes import LOBES, FitRecord, Lambert, Lobe

Bsdf = dict[str, Any]
"""A BSDF as `mitsuba.load_dict` takes it."""

# Of the format of the file.
VERSION = "3.0.0"
TABLE = ".bsdf"


def _diffuse(lobe: Lobe) -> Bsdf:
    return {"type": "diffuse", "reflectance": _rgb(lobe.albedo)}


def _rgb(value: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": numbers(value)}


# The lobes that Mitsuba has in the same form, by their registered names.
PLUGINS: dict[str, Callable[[Any], Bsdf]] = {"lambert": _diffuse}


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
    plugin = plugin_of(material.brdf)
    if plugin is not None:
        return plugin
    table = write(EXPORTERS["rgl"](), material, folder or Path())
    return {"type": "measured", "filename": str(table.files[0].absolute())}


def plugin_of(brdf: Brdf) -> Bsdf | None:
    """The BSDF of Mitsuba that is the same function; None if there is none."""
    if not isinstance(brdf, Lobe):
        return None
    components = [one for one in brdf.components() if not _is_black(one)]
    name = LOBES.name_of(type(components[0])) if len(components) == 1 else None
    if not components:
        return _diffuse(Lambert(albedo=0.0))
    return PLUGINS[name](components[0]) if name in PLUGINS else None


def _is_black(lobe: Lobe) -> bool:
    """Whether a lobe has the albedo 0, as a diffuse term beside a metal often has."""
    albedo = type(lobe).albedo_spec()
    return albedo is not None and not bool(getattr(lobe, albedo.name).any())


@EXPORTERS.register("mitsuba")
class Mitsuba(Exporter):
    """A `<bsdf>` that `mitsuba.load_file` gives as a BSDF: a plugin where Mitsuba has the model, else a table."""

    suffix = ".xml"
    beside = (TABLE,)

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the table, if there has to be one, and the XML file that names it."""
        path = material.path(folder, self.suffix)
        plugin = plugin_of(material.brdf)
        if plugin is not None:
            write_text(path, to_xml(plugin, material.name))
            return Exported([path], True, [f"exact: Mitsuba's {plugin['type']}"], material.brdf)
        table = EXPORTERS["rgl"]().write(material, folder)
        write_text(path, to_xml({"type": "measured", "filename": table.files[0].name}, material.name))
        return Exported([path, *table.files], False, table.notes, table.shown)


def to_xml(plugin: Bsdf, name: str) -> str:
    """A BSDF as the text of an XML file."""
    root = _element(plugin, {"version": VERSION, "type": plugin["type"], "id": name})
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _element(plugin: Bsdf, attributes: dict[str, str]) -> ElementTree.Element:
    made = ElementTree.Element("bsdf", attributes)
    for name, value in plugin.items():
        if isinstance(value, dict) and value["type"] == "rgb":
            made.append(ElementTree.Element("rgb", name=name, value=", ".join(map(repr, value["value"]))))
        elif isinstance(value, dict):
            made.append(_element(value, {"type": value["type"], "name": name}))
        elif name != "type":
            kind = {bool: "boolean", float: "float", str: "string"}[type(value)]
            made.append(
                ElementTree.Element(kind, name=name, value=str(value).lower() if kind == "boolean" else str(value))
            )
    return made
