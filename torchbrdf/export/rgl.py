"""Mitsuba 3, and whatever else reads RGL's files: any BRDF as a table, a file of RGL's format."""

import shutil
from pathlib import Path

from torchbrdf.export.base import EXPORTERS, Exported, Exporter, Material
from torchbrdf.files import replacing
from torchbrdf.measured import Measured, Rgl, load
from torchbrdf.measured.rgl_table import ANGLES, SIZE, write_rgl


@EXPORTERS.register("rgl")
class RglTable(Exporter):
    """A `.bsdf` for Mitsuba's material `measured`; a measurement of RGL's as it is."""

    suffix = ".bsdf"

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the table."""
        path, brdf = material.path(folder, self.suffix), material.brdf
        if isinstance(brdf, Measured) and isinstance(brdf.source, Rgl):
            with replacing(path) as part:
                shutil.copyfile(brdf.source.paths[brdf.materials[0]], part)
            return Exported([path], True, ["exact: the measurement's own file"], brdf)
        write_rgl(path, brdf, description=material.name)
        megabytes = path.stat().st_size / 1e6
        note = f"a table: {ANGLES} theta_i x {SIZE} x {SIZE} half vectors, RGB, {megabytes:.1f} MB"
        return Exported([path], False, [note], load(path))
