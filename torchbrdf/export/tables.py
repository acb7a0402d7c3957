"""What exporters of tables have in common."""

import shutil
from abc import abstractmethod
from pathlib import Path

from torchbrdf.export.base import Brdf, Exported, Exporter, Material
from torchbrdf.files import replacing
from torchbrdf.measured import Measured
from torchbrdf.measured.tables import measured_up_to

NEARLY_ALL = 85.0
"""Degrees from the normal up to which data say enough for every picture."""


class TableExporter(Exporter):
    """Base of those that write what a measurement is, values at directions: files that `torchbrdf.load` reads again."""

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the table."""
        return self.write_file(material, material.path(folder, self.suffix))

    @abstractmethod
    def write_file(self, material: Material, path: Path) -> Exported:
        """Write a material as one file, whole or not at all.

        Args:
            material: As of `write`.
            path: Of the file.
        """


def copied(path: Path, measured: Measured) -> Exported:
    """A measurement's own file as it is."""
    with replacing(path) as part:
        shutil.copyfile(measured.source.paths[measured.materials[0]], part)
    return Exported([path], True, ["exact: the measurement's own file"], measured)


def reach(brdf: Brdf) -> list[str]:
    """A note on what was not measured, if that is a part of pictures."""
    found = measured_up_to(brdf)
    return [] if found.both >= NEARLY_ALL else [f"measured {found.words('up to')}; beyond, values are extrapolated"]
