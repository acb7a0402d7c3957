"""Out to renderers: a fitted or measured BRDF as a material that other programs read. A program a file."""

from torchbrdf.export.api import export
from torchbrdf.export.base import EXPORTERS, Exported, Exporter, Material
from torchbrdf.export.comparison import picture_differences
from torchbrdf.export.convert import Converted, convert

__all__ = [
    "EXPORTERS",
    "Converted",
    "Exported",
    "Exporter",
    "Material",
    "convert",
    "export",
    "picture_differences",
]
