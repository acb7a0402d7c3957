"""An exporter."""

from pathlib import Path

from torchbrdf.export import Exported, Exporter, Material
from torchbrdf.files import write_text


class MyExporter(Exporter):
    """The BRDF as Python shows it."""

    suffix = ".mine"

    def write(self, material: Material, folder: Path) -> Exported:
        """Write it."""
        path = material.path(folder, self.suffix)
        write_text(path, repr(material.brdf))
        return Exported([path], True, ["exact: as text"], material.brdf)
