"""Mitsuba 3, and whatever else reads RGL's files: any BRDF as a table, a file of RGL's format."""

from pathlib import Path

from torchbrdf.export.base import EXPORTERS, Brdf, Exported, Material
from torchbrdf.export.tables import TableExporter, copied
from torchbrdf.measured import Measured, Rgl, load, write_rgl
from torchbrdf.measured.rgl_table import ANGLES, SIZE


@EXPORTERS.register("rgl")
class RglTable(TableExporter):
    """A `.bsdf` for Mitsuba's material `measured`; a measurement of RGL's as it is."""

    no_grain = "the table has one azimuth of the light"
    suffix = ".bsdf"
    own = Rgl

    def is_own(self, brdf: Brdf) -> bool:
        """Whether it is a file of RGL's without holes."""
        if not (isinstance(brdf, Measured) and isinstance(brdf.source, Rgl)):
            return False
        return super().is_own(brdf) and brdf.source.is_whole(brdf.materials[0])

    def write_file(self, material: Material, path: Path) -> Exported:
        """Write the table."""
        brdf = material.brdf
        if isinstance(brdf, Measured) and self.is_own(brdf):
            return copied(path, brdf)
        write_rgl(path, brdf, description=material.name)
        size = path.stat().st_size / 1e6
        note = f"a table of RGL's format: {ANGLES} theta_i x {SIZE} x {SIZE} half vectors, RGB, {size:.1f} MB"
        return Exported([path], False, [note], load(path))
