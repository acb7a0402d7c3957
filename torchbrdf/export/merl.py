"""Whatever reads MERL's tables, such as Disney's BRDF Explorer: any BRDF as a table."""

from pathlib import Path

from torchbrdf.export.base import EXPORTERS, Exported, Material
from torchbrdf.export.tables import TableExporter, copied
from torchbrdf.measured import Measured, Merl, load, merl_values, write_merl


@EXPORTERS.register("merl")
class MerlTable(TableExporter):
    """A `.binary` of 90 x 90 x 180 bins; a measurement of MERL's as it is."""

    no_grain = "MERL's bins have no azimuth of the half vector"
    suffix = ".binary"
    own = Merl

    def write_file(self, material: Material, path: Path) -> Exported:
        """Write the table."""
        brdf = material.brdf
        if isinstance(brdf, Measured) and self.is_own(brdf):
            return copied(path, brdf)
        values = merl_values(brdf)
        negative = ((values < 0).any(-1).sum() / values.isfinite().all(-1).sum()).item()
        write_merl(path, values.clamp_(0))
        notes = [f"a MERL table: 90 x 90 x 180 bins, {path.stat().st_size / 1e6:.1f} MB"]
        if negative:
            notes.append(f"negative channels, in {negative:.2%} of the bins, are 0: MERL tables have none")
        return Exported([path], False, notes, load(path))
