"""A table of named columns: what everything reads that reads text."""

from pathlib import Path

import numpy as np

from torchbrdf.export.base import EXPORTERS, Exported, Material
from torchbrdf.export.listing import listing
from torchbrdf.export.tables import TableExporter, copied
from torchbrdf.files import write_text
from torchbrdf.measured import Columns, Measured, load

# Numbers of more digits would say more than single precision holds.
DIGITS = 9
ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")


@EXPORTERS.register("csv")
class CsvTable(TableExporter):
    """A `.csv` with the angles of light and viewer in degrees, and columns `r`, `g`, `b` or bands such as `465nm`."""

    suffix = ".csv"
    own = Columns
    keeps_bands = True

    def write_file(self, material: Material, path: Path) -> Exported:
        """Write the table."""
        brdf = material.brdf
        if isinstance(brdf, Measured) and self.is_own(brdf):
            return copied(path, brdf)
        found = listing(brdf)
        angles = found.angles
        # Angles that are all so small are taken for radians by whoever reads them.
        if np.degrees(angles[:, [0, 2]]).max() > 4:
            angles = np.degrees(angles)
        text = rows_text([*ANGLES, *found.columns(("r", "g", "b"), "f")], np.hstack([angles, found.values]))
        write_text(path, (f"# {found.grain}\n" if found.grain else "") + text)
        return Exported([path], found.is_own, [found.note], load(path))


def rows_text(names: list[str], rows: np.ndarray) -> str:
    """A line of names, and a line for each row of numbers."""
    lines = [",".join(names), *(",".join(f"{number:.{DIGITS}g}" for number in row) for row in rows.tolist())]
    return "\n".join(lines) + "\n"
