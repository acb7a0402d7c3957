"""Out to renderers: a fitted or measured BRDF as a material that other programs read. A program a file."""

from torchbrdf.export.api import export
from torchbrdf.export.base import EXPORTERS, Exported, Exporter, Material
from torchbrdf.export.comparison import picture_differences

__all__ = ["EXPORTERS", "Exported", "Exporter", "Material", "export", "picture_differences"]
